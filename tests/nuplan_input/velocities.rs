//! Agents without a velocity: NULL in the log.

use super::fixture::DataSet;
use planagent_agent::planner::IdmPlanner;
use planagent_agent::simulation::{Challenge, simulate};
use planagent_scenario::Scenario;
use planagent_scenario::nuplan::open;
use planagent_world::TrackedObject;

/// Largest difference between a velocity from positions and the log's, m/s: an acceleration of 2
/// m/s² over a step and a half.
const TOLERANCE: f64 = 0.4;

fn agents(scenario: &Scenario) -> Vec<TrackedObject> {
    let objects = scenario
        .frames
        .iter()
        .flat_map(|frame| frame.objects.iter().copied());
    objects.filter(|object| object.kind.is_agent()).collect()
}

#[test]
fn velocities_that_a_log_lacks_are_derived_from_positions_and_counted() {
    let whole = agents(&DataSet::new().open().unwrap());
    assert!(whole.iter().any(|agent| agent.speed() > 5.0));
    for (sql, share) in [
        ("vx = NULL, vy = NULL", 1.0),
        ("vy = NULL WHERE rowid % 3 = 0", 0.33),
    ] {
        let set = DataSet::log_with(&format!("UPDATE lidar_box SET {sql}"));
        let maps = set.maps();
        let scenario = open(&maps, &set.found().unwrap()).unwrap();
        let derived = agents(&scenario);
        assert_eq!(derived.len(), whole.len());
        for (own, logged) in derived.iter().zip(&whole) {
            assert_eq!((own.token, own.shape), (logged.token, logged.shape));
            let error = (own.velocity - logged.velocity).norm();
            assert!(error < TOLERANCE, "{own:?} {logged:?}");
        }
        let mut notes = maps.take_notes();
        notes.retain(|note| note.contains("velocity"));
        let [note] = notes.as_slice() else {
            panic!("{notes:?}")
        };
        let count: f64 = note.split(' ').find_map(|word| word.parse().ok()).unwrap();
        assert!(
            note.contains(".db: ") && note.contains("derived from their positions"),
            "{note}"
        );
        assert!(
            (count / whole.len() as f64 - share).abs() < 0.05,
            "{note} of {}",
            whole.len()
        );
    }
}

#[test]
fn agents_without_a_velocity_are_driven_and_judged() {
    let set = DataSet::log_with("UPDATE lidar_box SET vx = NULL, vy = NULL");
    let (scenario, whole) = (set.open().unwrap(), DataSet::new().open().unwrap());
    for challenge in [Challenge::NonReactive, Challenge::Reactive] {
        let score = |scenario| {
            let log = simulate(scenario, &mut IdmPlanner::new(), challenge).unwrap();
            log.evaluate(scenario).unwrap().score.value
        };
        let (own, logged) = (score(&scenario), score(&whole));
        assert!(
            (own - logged).abs() < 0.05,
            "{challenge}: {own} and {logged}"
        );
    }
}
