//! The agent with calls that last in simulated time, and behind a gate.

use crate::agent::{drive, scenario, settings_with};
use planagent_agent::planner::{Decision, Latency, PdmClosed, PlanAgentSettings, Planner};
use planagent_agent::reasoning::Round;
use planagent_agent::simulation::{Challenge, simulate};
use std::time::Duration;

const SCENE: &str = "generated/high_magnitude_speed/1";
const EIGHT: &str = "Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1, dec=3)";

fn after(milliseconds: u64) -> PlanAgentSettings {
    let latency = Latency::Fixed(Duration::from_millis(milliseconds));
    settings_with(|settings| {
        (settings.agent.latency, settings.reflection.enabled) = (latency, false);
    })
}

#[test]
fn a_plan_becomes_active_when_the_time_of_its_call_has_passed() {
    let (agent, log, asked) = drive(&[EIGHT], &[Round::Code], after(2500), SCENE);
    let calls: Vec<_> = agent
        .calls()
        .iter()
        .map(|call| (call.iteration, call.active_from))
        .collect();
    // While the model is busy it cannot be asked again: the next call is the first one due after
    // that.
    assert_eq!(
        calls,
        [
            (0, Some(25)),
            (40, Some(65)),
            (80, Some(105)),
            (120, Some(145))
        ]
    );
    assert_eq!(asked.len(), 4);
    let speed = |iteration: usize| log.samples[iteration].ego.speed();
    assert!(
        speed(0) > 10.0 && (speed(25) - speed(0)).abs() < 1.0,
        "{} {}",
        speed(0),
        speed(25)
    );
    assert!((speed(140) - 8.0).abs() < 0.5, "{}", speed(140));
    let (_, again, _) = drive(&[EIGHT], &[Round::Code], after(2500), SCENE);
    assert_eq!(
        (again.samples, again.trajectories),
        (log.samples, log.trajectories)
    );
}

#[test]
fn a_latency_of_zero_is_no_latency() {
    let (_, at_once, _) = drive(&[EIGHT], &[Round::Code], after(0), SCENE);
    let mut none = after(0);
    none.agent.latency = Latency::None;
    let (agent, log, _) = drive(&[EIGHT], &[Round::Code], none, SCENE);
    assert_eq!(at_once.samples, log.samples);
    assert!(agent.calls().iter().all(|call| call.active_from.is_none()));
}

#[test]
fn a_late_lane_change_begins_where_the_ego_is() {
    let scene = "generated/changing_lane/2";
    let answers = [
        "Generate_IDM_Planner(c=left_lane, la=None, v0=9, acc=1, dec=3)",
        EIGHT,
    ];
    let (agent, log, _) = drive(&answers, &[Round::Code], after(3000), scene);
    assert_eq!(agent.calls()[0].active_from, Some(30));
    let jump = log
        .trajectories
        .iter()
        .zip(&log.samples)
        .map(|(trajectory, sample)| {
            let next = trajectory.states()[1].rear_axle;
            (sample.ego.rear_axle.to_local(next.position()).y).abs()
        });
    assert!(jump.fold(0.0, f64::max) < 0.5, "no trajectory leaps aside");
}

#[test]
fn behind_a_gate_pdm_closed_is_executed_where_it_is_predicted_to_score() {
    let gated = |gate| settings_with(|settings| settings.agent.gate = Some(gate));
    let (agent, log, asked) = drive(&[EIGHT], &[Round::Code], gated(0.5), SCENE);
    assert!(asked.is_empty(), "the model was asked: {asked:?}");
    assert_eq!(agent.calls().len(), 8);
    assert!(
        agent
            .calls()
            .iter()
            .all(|call| matches!(call.decision, Decision::Gated(score) if score >= 0.5))
    );
    let rules = simulate(
        &scenario(SCENE),
        &mut PdmClosed::new(),
        Challenge::NonReactive,
    )
    .unwrap();
    let [mine, theirs] = [&log, &rules].map(|log| log.samples.last().unwrap().ego.rear_axle);
    assert!(mine.distance(&theirs) < 1.0, "{mine:?} {theirs:?}");
    let (agent, _, asked) = drive(&[EIGHT], &[Round::Code], gated(1.1), SCENE);
    assert!(
        asked.len() >= 8 && agent.calls().iter().all(|call| !call.is_gated()),
        "no score passes this gate"
    );
}
