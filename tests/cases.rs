//! The paper's two cases: what PDM-Closed does in them, and what the agent's planner code can do.

use crate::agent::{drive, scenario, settings_with};
use planagent_agent::planner::PdmClosed;
use planagent_agent::reasoning::Round;
use planagent_agent::simulation::{Challenge, SimulationLog, simulate};
use planagent_scenario::Scenario;
use planagent_world::{EgoState, ObjectKind, SignalStatus};

const ROUNDABOUT: &str = "generated/case_roundabout/0";
const RED_LIGHT: &str = "generated/case_red_light/0";

fn by_rules(scenario: &Scenario) -> SimulationLog {
    simulate(scenario, &mut PdmClosed::new(), Challenge::NonReactive).unwrap()
}

/// A drive in which the n-th planning call gives the n-th code.
fn by_code(codes: &[&'static str], id: &str) -> SimulationLog {
    let settings = settings_with(|settings| settings.reflection.enabled = false);
    drive(codes, &[Round::Code], settings, id).1
}

fn last(log: &SimulationLog) -> &EgoState {
    &log.samples.last().unwrap().ego
}

/// Meters driven.
fn driven(log: &SimulationLog) -> f64 {
    log.samples
        .windows(2)
        .map(|pair| pair[0].ego.rear_axle.distance(&pair[1].ego.rear_axle))
        .sum()
}

fn passes(log: &SimulationLog, scenario: &Scenario, metric: &str) -> bool {
    let evaluation = log.evaluate(scenario).unwrap();
    evaluation
        .metric(metric)
        .and_then(|metric| metric.score)
        .is_some_and(|score| score >= 1.0)
}

/// Distance from the ego's front bumper to the nearest vehicle that stands before it in its lane,
/// meters.
fn gap_ahead(log: &SimulationLog) -> f64 {
    let sample = log.samples.last().unwrap();
    let (center, own) = (sample.ego.center(), sample.ego.footprint());
    let ahead = sample.objects.iter().filter(|object| {
        let local = center.to_local(object.shape.center.position());
        object.kind == ObjectKind::Vehicle && local.x > 0.0 && local.y.abs() < 1.5
    });
    ahead
        .map(|object| own.distance(&object.shape))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn at_the_roundabout_the_rules_wait_for_good_and_a_lane_change_leads_past() {
    let scenario = scenario(ROUNDABOUT);
    let rules = by_rules(&scenario);
    assert!(
        last(&rules).speed() < 0.3 && gap_ahead(&rules) < 8.0,
        "{} m/s, {} m",
        last(&rules).speed(),
        gap_ahead(&rules)
    );
    let left = "Generate_IDM_Planner(c=left_lane, la=None, v0=7, acc=1.5, dec=3)";
    let on = "Generate_IDM_Planner(c=ego_lane, la=None, v0=7, acc=1.5, dec=3)";
    let agent = by_code(&[left, left, left, on, on, on, on, on], ROUNDABOUT);
    assert!(
        driven(&agent) > driven(&rules) + 20.0,
        "{} m, {} m",
        driven(&agent),
        driven(&rules)
    );
    assert!(passes(&agent, &scenario, "no_ego_at_fault_collisions"));
    assert!(passes(&agent, &scenario, "drivable_area_compliance"));
}

/// How far the front bumper is beyond the line of the first light on the ego's way, meters.
fn beyond_line(log: &SimulationLog, scenario: &Scenario) -> f64 {
    let ego = last(log);
    let front = ego
        .footprint()
        .center
        .translated(ego.footprint().length / 2.0, 0.0)
        .position();
    let governed = scenario
        .route
        .lanes(&scenario.map)
        .into_iter()
        .filter(|&lane| scenario.map[lane].has_traffic_lights);
    let lines = governed.map(|lane| scenario.map[lane].centerline.pose_at(0.0).to_local(front));
    lines
        .filter(|local| local.y.abs() < 1.8)
        .map(|local| local.x)
        .fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn at_the_red_light_the_rules_stop_beyond_the_line_and_braking_for_yellow_stops_before_it() {
    let scenario = scenario(RED_LIGHT);
    let yellow = |k: usize| {
        scenario
            .frame(k)
            .unwrap()
            .lights
            .iter()
            .any(|(_, status)| status == SignalStatus::Yellow)
    };
    assert!(
        !yellow(0) && yellow(20),
        "the light turns yellow between the first and the second planning call"
    );
    let rules = by_rules(&scenario);
    assert!(last(&rules).speed() < 0.3, "{} m/s", last(&rules).speed());
    let over = beyond_line(&rules, &scenario);
    assert!(over > 1.0, "PDM-Closed's front is {over} m beyond the line");
    let cruise = "Generate_IDM_Planner(c=ego_lane, la=None, v0=13, acc=1.5, dec=3)";
    let slow = "Generate_IDM_Planner(c=ego_lane, la=None, v0=6, acc=1, dec=3)";
    let agent = by_code(
        &[cruise, slow, slow, slow, slow, slow, slow, slow],
        RED_LIGHT,
    );
    assert!(last(&agent).speed() < 0.3, "{} m/s", last(&agent).speed());
    let before = -beyond_line(&agent, &scenario);
    assert!(
        (0.0..6.0).contains(&before),
        "the agent's front is {before} m before the line"
    );
}
