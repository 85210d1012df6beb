//! Progress along the expert's route on a chain of three roadblocks: a lane (0–50 m), a connector
//! (50–60 m), a lane (60–200 m).

use crate::road::{Road, cruise};
use planagent_score::metrics::{
    RouteProgress, ego_is_making_progress, ego_progress_along_expert_route, progress_ratio,
};
use planagent_world::geometry::{Point, Pose};
use planagent_world::{EgoState, LaneMap};

fn chain() -> LaneMap {
    let mut road = Road::default();
    let a = road.lane((0.0, 0.0), (50.0, 0.0));
    let b = road.connector((50.0, 0.0), (60.0, 0.0));
    let c = road.lane((60.0, 0.0), (200.0, 0.0));
    road.link(a, b);
    road.link(b, c);
    road.build()
}

/// The route of an expert who drove from 10 to 159 m.
fn route(map: &LaneMap) -> RouteProgress<'_> {
    let poses: Vec<Pose> = cruise(150, 10.0, 0.0, 10.0)
        .iter()
        .map(EgoState::center)
        .collect();
    RouteProgress::along(map, &poses)
}

fn per_frame(points: &[(f64, f64)]) -> Vec<f64> {
    let map = chain();
    route(&map).per_frame(
        &points
            .iter()
            .map(|&(x, y)| Point::new(x, y))
            .collect::<Vec<_>>(),
    )
}

fn assert_steps(points: &[(f64, f64)], expected: &[f64]) {
    let found = per_frame(points);
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() < 1e-9, "{found:?} {expected:?}");
    }
}

#[test]
fn progress_goes_on_across_roadblocks() {
    assert_steps(
        &[
            (45.0, 0.0),
            (49.0, 0.5),
            (53.0, 0.0),
            (57.0, 0.0),
            (61.0, 0.0),
        ],
        &[0.0, 4.0, 4.0, 4.0, 4.0],
    );
}

#[test]
fn a_skipped_roadblock_counts_its_length() {
    // 2 m to the end of the first, 10 m of the connector, 2 m into the last.
    assert_steps(&[(48.0, 0.0), (62.0, 0.0)], &[0.0, 14.0]);
}

#[test]
fn off_the_route_nothing_counts_until_it_is_entered_again() {
    assert_steps(
        &[(20.0, 0.0), (22.0, 9.0), (30.0, 9.0), (36.0, 0.0)],
        &[0.0, 0.0, 0.0, 16.0],
    );
}

#[test]
fn driving_back_is_negative_and_roadblocks_left_behind_are_not_entered_again() {
    assert_steps(&[(20.0, 0.0), (17.0, 0.0), (15.0, 0.0)], &[0.0, -3.0, -2.0]);
    assert_steps(&[(48.0, 0.0), (52.0, 0.0), (48.0, 0.0)], &[0.0, 4.0, 0.0]);
}

#[test]
fn the_ratio_holds_both_distances_at_two_meters() {
    for (ego, expert, ratio) in [
        (41.04, 41.99, 41.04 / 41.99),
        (4.07, 25.83, 4.07 / 25.83),
        (-13.0, 10.0, 0.0),
        (-2.1, 100.0, 0.0),
        (-1.9, 40.0, 0.05),
        (0.0, 1.0, 1.0),
        (80.0, 60.0, 1.0),
    ] {
        assert!(
            (progress_ratio(ego, expert) - ratio).abs() < 1e-12,
            "{ego} {expert}"
        );
    }
}

#[test]
fn a_fifth_of_the_experts_way_is_progress() {
    assert_eq!(ego_is_making_progress(0.2).score, Some(1.0));
    assert_eq!(ego_is_making_progress(0.199).score, Some(0.0));
    let map = chain();
    let (expert, slow) = (cruise(150, 10.0, 0.0, 10.0), cruise(149, 10.0, 0.0, 2.5));
    let result = ego_progress_along_expert_route(&map, &slow, &expert);
    assert_eq!(result.statistics.len(), 3);
    assert!(
        (result
            .statistic("expert_total_progress_along_route")
            .unwrap()
            - 149.0)
            .abs()
            < 1e-9
    );
    assert!((result.statistic("ego_total_progress_along_route").unwrap() - 37.0).abs() < 1e-9);
    assert!((result.score.unwrap() - 37.0 / 149.0).abs() < 1e-12);
}

#[test]
fn of_several_skipped_roadblocks_each_counts_what_lies_between_its_neighbours() {
    let mut road = Road::default();
    let a = road.lane((0.0, 0.0), (50.0, 0.0));
    let b = road.connector((50.0, 0.0), (60.0, 0.0));
    // Its line begins 4 m before the end of the connector and ends 5 m after the start of the last
    // lane.
    let c = road.lane((56.0, 1.0), (85.0, 1.0));
    let d = road.lane((80.0, 0.0), (200.0, 0.0));
    for (from, to) in [(a, b), (b, c), (c, d)] {
        road.link(from, to);
    }
    let map = road.build();
    let expert: Vec<Pose> = cruise(150, 10.0, 0.0, 10.0)
        .iter()
        .map(EgoState::center)
        .collect();
    let route = RouteProgress::along(&map, &expert);
    let steps = route.per_frame(&[Point::new(48.0, 0.0), Point::new(90.0, 0.0)]);
    // 2 m in the first; skipped: 6 m of the connector, from the first's end to the start of the
    // third, and 20 m of the third, from the connector's end to the start of the last; in the last
    // 10 m from the first's end, which lies before its start.
    assert!(
        (steps[1] - (2.0 + 6.0 + 20.0 + 10.0)).abs() < 1e-9,
        "{steps:?}"
    );
}
