//! Variety: the share of scenarios with certain features.

use super::CORPUS;
use crate::Scenario;
use planagent_world::{LaneKind, ObjectKind};

fn share(holds: impl Fn(&Scenario) -> bool) -> f64 {
    CORPUS
        .iter()
        .filter(|generated| holds(&generated.scenario))
        .count() as f64
        / CORPUS.len() as f64
}

fn sees(scenario: &Scenario, kind: ObjectKind) -> bool {
    scenario
        .frames
        .iter()
        .any(|frame| frame.objects.iter().any(|object| object.kind == kind))
}

/// Lanes beside each other where the ego starts.
fn own_lanes(scenario: &Scenario) -> usize {
    let ego = scenario.frames[scenario.start].ego.center().position();
    let lane = scenario.map.lanes_of_kind_at(ego, LaneKind::Lane);
    lane.first().map_or(0, |&lane| {
        scenario.map[scenario.map[lane].roadblock].lanes.len()
    })
}

#[test]
fn scenarios_are_varied() {
    let within = |name: &str, share: f64, low: f64, high: f64| {
        assert!(
            share >= low && share <= high,
            "{name}: {share} is not within {low} and {high}"
        );
    };
    within(
        "lights",
        share(|s| s.frames.iter().any(|f| f.lights.iter().next().is_some())),
        0.3,
        0.8,
    );
    within(
        "crosswalks",
        share(|s| !s.map.crosswalks().is_empty()),
        0.4,
        0.97,
    );
    within(
        "pedestrians",
        share(|s| sees(s, ObjectKind::Pedestrian)),
        0.4,
        0.98,
    );
    within(
        "bicycles",
        share(|s| sees(s, ObjectKind::Bicycle)),
        0.08,
        0.7,
    );
    within(
        "cones",
        share(|s| sees(s, ObjectKind::TrafficCone)),
        0.03,
        0.5,
    );
    within(
        "barriers",
        share(|s| sees(s, ObjectKind::Barrier)),
        0.003,
        0.3,
    );
    for lanes in 1..=3 {
        within("own lanes", share(|s| own_lanes(s) == lanes), 0.1, 0.6);
    }
    within("own lanes", share(|s| own_lanes(s) == 4), 0.01, 0.3);
    let limits: std::collections::BTreeSet<u64> = CORPUS
        .iter()
        .flat_map(|g| {
            g.scenario
                .map
                .lanes()
                .iter()
                .filter_map(|lane| lane.speed_limit)
        })
        .map(f64::to_bits)
        .collect();
    assert!(limits.len() >= 6);
    let bends = share(|s| {
        let headings: Vec<f64> = s.expert().map(|ego| ego.rear_axle.heading).collect();
        headings
            .iter()
            .any(|h| planagent_world::geometry::wrap_angle(h - headings[0]).abs() > 0.3)
    });
    within("bends and turns", bends, 0.15, 0.8);
}

#[test]
fn few_draws_are_discarded() {
    let discarded: usize = CORPUS
        .iter()
        .map(|generated| generated.discarded.len())
        .sum();
    assert!(
        discarded < CORPUS.len(),
        "{discarded} of {}",
        CORPUS.len() + discarded
    );
}
