//! Agents without a velocity: NULL in the log, NaN for the devkit.

use super::fixture::DataSet;
use planagent::internals::planner::IdmPlanner;
use planagent::internals::simulation::{Challenge, simulate};

#[test]
fn agents_without_a_velocity_are_driven_and_judged() {
    let set = DataSet::log_with("UPDATE lidar_box SET vx = NULL, vy = NULL");
    let scenario = set.open().unwrap();
    let objects = || scenario.frames.iter().flat_map(|frame| frame.objects.iter());
    assert!(objects().any(|object| object.kind.is_agent()));
    assert!(objects().all(|object| object.velocity.x.is_nan() == object.kind.is_agent()));
    for challenge in [Challenge::NonReactive, Challenge::Reactive] {
        let log = simulate(&scenario, &mut IdmPlanner::new(), challenge).unwrap();
        let score = log.evaluate(&scenario).unwrap().score;
        assert!(score.value.is_finite(), "{challenge}: {score:?}");
    }
}
