//! Drivable area, driving direction and speed limit on hand-made roads, each a number worked out by
//! hand.

use crate::road::{Road, cruise, ego, rectangle, straight};
use planagent_score::metrics::{
    DrivenLanes, MetricResult, corners_in_drivable_area, drivable_area_compliance,
    driving_direction_compliance, speed_limit_compliance,
};
use planagent_world::{EgoState, LaneKind, LaneMap};

/// Half the width of the ego, meters.
const HALF_WIDTH: f64 = 1.1485;

fn drivable(map: &LaneMap, y: f64) -> (f64, f64) {
    let states = cruise(5, 0.0, y, 5.0);
    let lanes = DrivenLanes::from_states(map, &states);
    let corners = corners_in_drivable_area(map, &states, &lanes);
    (
        drivable_area_compliance(map, &states, &lanes)
            .score
            .unwrap(),
        corners.statistics[0].value,
    )
}

#[test]
fn corners_may_leave_the_road_by_less_than_three_tenths() {
    let map = straight();
    // The road ends at y = 2.
    let outside_by = |d: f64| drivable(&map, 2.0 - HALF_WIDTH + d);
    assert_eq!(outside_by(-0.01), (1.0, 1.0));
    assert_eq!(outside_by(0.2), (1.0, 0.0));
    assert_eq!(outside_by(0.299), (1.0, 0.0));
    assert_eq!(outside_by(0.301), (0.0, 0.0));
}

#[test]
fn any_drivable_area_holds_a_corner_and_tolerates_beside_it() {
    let mut road = Road::default();
    road.lane((-100.0, 0.0), (400.0, 0.0));
    road.parts
        .generic_drivable
        .push(rectangle((-100.0, 400.0), (2.0, 3.0)));
    road.parts
        .carparks
        .push(rectangle((-100.0, 400.0), (10.0, 14.0)));
    let map = road.build();
    assert_eq!(drivable(&map, 2.9 - HALF_WIDTH), (1.0, 1.0));
    assert_eq!(drivable(&map, 3.2 - HALF_WIDTH), (1.0, 0.0));
    assert_eq!(drivable(&map, 3.4 - HALF_WIDTH), (0.0, 0.0));
    // Wholly in a car park, in no lane at all.
    assert_eq!(drivable(&map, 12.0), (1.0, 1.0));
}

fn direction(map: &LaneMap, states: &[EgoState]) -> MetricResult {
    driving_direction_compliance(map, states, &DrivenLanes::from_states(map, states).center)
}

#[test]
fn the_worst_second_against_the_lane_decides() {
    let map = straight();
    let backing = |speed: f64| {
        let result = direction(&map, &cruise(50, 100.0, 0.0, -speed));
        (result.score.unwrap(), result.statistics[1].value)
    };
    // Exactly 10 Hz: the window holds 11 steps, so 1.1 s of movement.
    for (speed, score) in [(1.8, 1.0), (1.9, 0.5), (5.4, 0.5), (5.5, 0.0)] {
        let (found, least) = backing(speed);
        assert!((found - score).abs() < 1e-12, "{speed}: {found}");
        assert!((least + 1.1 * speed).abs() < 1e-9, "{speed}: {least}");
    }
    // A mean step any longer than 0.1 s: only 10 steps.
    let mut slow = cruise(50, 100.0, 0.0, -1.9);
    for (k, state) in slow.iter_mut().enumerate() {
        state.time_us = 100_001 * k as i64;
    }
    let result = direction(&map, &slow);
    assert!((result.statistics[1].value + 1.9).abs() < 1e-9 && result.score == Some(1.0));
}

#[test]
fn forwards_and_off_the_lanes_nothing_counts() {
    let map = straight();
    assert!(
        direction(&map, &cruise(50, 0.0, 0.0, 10.0)).statistics[1]
            .value
            .abs()
            < 1e-12
    );
    assert_eq!(
        direction(&map, &cruise(50, 100.0, 300.0, -10.0)).score,
        Some(1.0)
    );
}

#[test]
fn after_each_change_of_lane_two_samples_count_nothing() {
    let mut road = Road::default();
    let (a, b) = (
        road.lane((0.0, 0.0), (50.0, 0.0)),
        road.lane((50.0, 0.0), (100.0, 0.0)),
    );
    road.link(a, b);
    let map = road.build();
    // Backing at 5 m/s from x = 52.25: samples 0…4 in b, from sample 5 (x = 49.75) on in a.
    let result = direction(&map, &cruise(12, 52.25, 0.0, -5.0));
    let sums = result.time_series.unwrap().values;
    // Steps of −0.5 m at samples 1…4 (sample 0 has none before it), 0 at 5 and 6, −0.5 from 7 on.
    let steps = [
        0.0, -0.5, -0.5, -0.5, -0.5, 0.0, 0.0, -0.5, -0.5, -0.5, -0.5, -0.5,
    ];
    for (i, sum) in sums.iter().enumerate() {
        let expected: f64 = steps[i.saturating_sub(10)..=i].iter().sum();
        assert!((sum - expected).abs() < 1e-9, "{i}: {sum} {expected}");
    }
}

#[test]
fn an_arc_length_of_exactly_zero_counts_as_a_missing_one() {
    let mut road = Road::default();
    road.lane((0.0, 0.0), (100.0, 0.0));
    // The lane's area begins before its line: there every point projects to its start.
    road.parts.lanes[0].polygon = rectangle((-20.0, 100.0), (-2.0, 2.0));
    let map = road.build();
    let states: Vec<EgoState> = [0.5, -0.5, 1.0]
        .iter()
        .enumerate()
        .map(|(k, &x)| ego(k as i64, x, 0.0, 0.0, 5.0))
        .collect();
    // From 0.5 back to the start is no movement of −0.5; from there on 1 m ahead is.
    assert_eq!(
        direction(&map, &states).time_series.unwrap().values,
        [0.0, 0.0, 1.0]
    );
}

fn speeding(map: &LaneMap, states: &[EgoState]) -> MetricResult {
    speed_limit_compliance(map, states, &DrivenLanes::from_states(map, states).center)
}

#[test]
fn overspeed_costs_its_share_of_two_and_a_quarter_meters_per_second() {
    let map = straight();
    // One above the limit of 15 m/s at all 149 samples: 1 − 149·0.1/(2.23·14.8).
    let result = speeding(&map, &cruise(149, 0.0, 0.0, 16.0));
    assert!((result.score.unwrap() - (1.0 - 14.9 / (2.23 * 14.8))).abs() < 1e-9);
    assert_eq!(result.statistics.len(), 5);
    assert!((result.statistics[3].value - 1.0).abs() < 1e-9);
    assert_eq!(
        speeding(&map, &cruise(149, 0.0, 0.0, 15.0)).score,
        Some(1.0)
    );
    assert_eq!(
        speeding(&map, &cruise(149, 0.0, 0.0, 20.0)).score,
        Some(0.0)
    );
}

#[test]
fn in_connectors_the_highest_neighbouring_limit_holds_if_all_have_one() {
    let build = |before: Option<f64>, after: Option<f64>, linked: bool| {
        let mut road = Road::default();
        let a = road.piece(LaneKind::Lane, (-100.0, 0.0), (0.0, 0.0), before);
        let c = road.connector((0.0, 0.0), (100.0, 0.0));
        let b = road.piece(LaneKind::Lane, (100.0, 0.0), (200.0, 0.0), after);
        if linked {
            road.link(a, c);
            road.link(c, b);
        }
        road.build()
    };
    let states = cruise(11, 20.0, 0.0, 12.0);
    let over = |map: &LaneMap| speeding(map, &states).time_series.unwrap().values[5];
    assert!((over(&build(Some(8.0), Some(11.0), true)) - 1.0).abs() < 1e-9);
    assert!(over(&build(Some(8.0), None, true)).abs() < 1e-12);
    assert!(over(&build(Some(8.0), Some(0.0), true)).abs() < 1e-12);
    assert!(over(&build(Some(8.0), Some(8.0), false)).abs() < 1e-12);
}

#[test]
fn a_violation_ends_at_the_first_sample_that_keeps_the_limit() {
    let map = straight();
    let mut states = cruise(21, 0.0, 0.0, 15.0);
    for k in [5, 6, 7] {
        states[k].velocity.x = 16.0;
    }
    states[20].velocity.x = 18.0;
    let result = speeding(&map, &states);
    assert_eq!(
        result.statistic("number_of_violations_of_speed_limit_compliance"),
        Some(2.0)
    );
    assert_eq!(
        result.statistic("max_violation_of_speed_limit_compliance"),
        Some(3.0)
    );
    assert_eq!(
        result.statistic("min_violation_of_speed_limit_compliance"),
        Some(1.0)
    );
    // The one at the last sample has no duration and leaves the mean: (1·0.3 + 3·0)/0.3.
    assert!(
        (result
            .statistic("mean_violation_of_speed_limit_compliance")
            .unwrap()
            - 1.0)
            .abs()
            < 1e-9
    );
}

#[test]
fn a_drive_without_violations_tells_only_that_it_has_none() {
    let result = speeding(&straight(), &cruise(21, 0.0, 0.0, 15.0));
    let told: Vec<(&str, f64)> = result
        .statistics
        .iter()
        .map(|s| (s.name.as_str(), s.value))
        .collect();
    assert_eq!(told, [("speed_limit_compliance", 1.0)]);
}
