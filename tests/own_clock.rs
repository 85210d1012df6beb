//! The agent's clock runs in seconds: an agent plans at the same times at any step length of the
//! simulator.

use crate::agent::{Script, code_source, scenario, settings};
use planagent_agent::planner::{PlanAgent, Planner, PlannerInput, PlannerName};
use planagent_agent::reasoning::Round;
use planagent_world::{EgoState, History, SceneView, Trajectory};
use std::sync::{Arc, Mutex};

/// Times of the planning calls, and where the ego is after 6 s, in a simulator of one's own that
/// follows the trajectories exactly.
fn simulate_with(step_us: i64) -> (Vec<f64>, EgoState) {
    let scenario = scenario("generated/high_magnitude_speed/1");
    let frame = scenario.frame(0).unwrap();
    let (route, history) = (&scenario.route, History::default());
    let answers = vec!["Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1, dec=3)"];
    let source = code_source(
        Arc::new(Script {
            answers,
            asked: Mutex::default(),
        }),
        &[Round::Code],
    );
    let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings()).layered();
    let mut ego = frame.ego;
    let start_us = ego.time_us;
    for iteration in 0.. {
        if ego.time_us - start_us > 6_000_000 {
            break;
        }
        let scene = SceneView {
            ego: &ego,
            objects: &[],
            route,
            ..scenario.scene(frame, &history)
        };
        let trajectory: Trajectory = agent
            .compute_trajectory(&PlannerInput { iteration, scene })
            .unwrap();
        let next = trajectory.at(ego.time_us + step_us).unwrap();
        ego = EgoState::from_log(
            next.time_us,
            next.rear_axle,
            next.velocity,
            next.acceleration,
        );
    }
    (agent.calls().iter().map(|call| call.at_s).collect(), ego)
}

#[test]
fn an_agent_plans_every_two_seconds_at_any_step_length() {
    let egos = [50_000, 100_000, 200_000].map(|step_us| {
        let (times, ego) = simulate_with(step_us);
        assert_eq!(times, [0.0, 2.0, 4.0, 6.0], "steps of {step_us} µs");
        ego
    });
    let [fine, usual, coarse] = egos.map(|ego| ego.rear_axle);
    // The simulations end one step after 6 s, at up to 12 m/s.
    assert!(
        fine.distance(&usual) < 3.0 && coarse.distance(&usual) < 3.0,
        "{egos:?}"
    );
}
