//! `ego_stop_at_stop_line` on a lane of 60 m with a stop line from 58 to 58.5 m.

use crate::road::{Road, ego, object, samples};
use planagent_score::metrics::{MetricCategory, MetricResult, ego_stop_at_stop_line};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneKind, LaneMap, ObjectKind, TrackedObject};

/// From the center of the ego to its front edge, meters.
const FRONT: f64 = 2.588;
/// From the end of the front edge to the side of the lane, where the first edge of the line's
/// polygon runs, meters.
const ASIDE: f64 = 2.0 - 1.1485;

fn lane() -> LaneMap {
    let mut road = Road::default();
    let a = road.dense(LaneKind::Lane, (0.0, 0.0), (60.0, 0.0), Some(12.0));
    let b = road.connector((60.0, 0.0), (80.0, 0.0));
    road.link(a, b);
    road.stop_line(58.0, b);
    road.build()
}

/// Samples of an ego whose front edge is at these places with these speeds.
fn judge(map: &LaneMap, fronts: &[(f64, f64)], objects: &[TrackedObject]) -> Option<MetricResult> {
    let state = |(k, &(x, speed)): (usize, &(f64, f64))| ego(k as i64, x - FRONT, 0.0, 0.0, speed);
    let states: Vec<EgoState> = fronts.iter().enumerate().map(state).collect();
    ego_stop_at_stop_line(map, &samples(&states, objects))
}

fn values(result: &MetricResult) -> Vec<f64> {
    result.statistics.iter().map(|s| s.value).collect()
}

#[test]
fn the_speed_at_the_sample_nearest_to_the_line_decides() {
    let map = lane();
    // Only the samples with the front on the line count. The distance is that from the first edge
    // of its polygon, here the one along the right side of the lane: 0.8515 m for each of them, and
    // the first of the nearest decides.
    let result = judge(
        &map,
        &[(57.5, 3.0), (58.1, 0.05), (58.4, 2.0), (59.0, 4.0)],
        &[],
    )
    .unwrap();
    let found = values(&result);
    assert_eq!(found[..2], [1.0, 1.0]);
    assert!(
        (found[2] - ASIDE).abs() < 1e-9 && (found[3] - 0.05).abs() < 1e-12,
        "{found:?}"
    );
    assert_eq!(
        (result.category, result.score),
        (MetricCategory::ScenarioDependent, None)
    );
    let series = result.time_series.unwrap();
    assert_eq!(
        (series.values, series.time_stamps),
        (vec![0.05, 2.0], vec![100_000, 200_000])
    );
    let through = judge(&map, &[(58.1, 5.0), (58.4, 5.0)], &[]).unwrap();
    assert_eq!(values(&through)[..2], [0.0, 1.0]);
}

#[test]
fn behind_a_leader_and_off_the_line_there_is_nothing_to_judge() {
    let map = lane();
    assert_eq!(
        judge(&map, &[(40.0, 5.0), (57.9, 1.0), (58.6, 1.0)], &[]),
        None
    );
    let car = |x: f64, y: f64| {
        object(
            1,
            ObjectKind::Vehicle,
            Pose::new(x, y, 0.0),
            (4.0, 2.0),
            0.0,
        )
    };
    // The path of the lane ends at its last vertex but one, 59.5 m: from 59.5 to 63.5 the car just
    // touches it.
    assert_eq!(judge(&map, &[(58.2, 0.0)], &[car(61.5, 0.0)]), None);
    assert!(judge(&map, &[(58.2, 0.0)], &[car(61.6, 0.0)]).is_some());
    assert!(
        judge(&map, &[(58.2, 0.0)], &[car(58.0, 2.2)]).is_some(),
        "beside"
    );
}

#[test]
fn the_nearest_line_must_cross_the_lane_of_the_ego() {
    let mut road = Road::default();
    let a = road.dense(LaneKind::Lane, (0.0, 0.0), (60.0, 0.0), Some(12.0));
    let b = road.dense(LaneKind::Lane, (0.0, 12.0), (60.0, 12.0), Some(12.0));
    road.stop_line(58.0, a);
    // A second line, of the other lane, but drawn nearer to where the front is at 30 m.
    let other = road.stop_line(30.0, b);
    let polygon = crate::road::rectangle((30.0, 30.5), (10.0, 14.0));
    road.parts.stop_lines[other.index()].polygon = polygon;
    let map = road.build();
    assert_eq!(judge(&map, &[(30.2, 0.0)], &[]), None);
    assert!(judge(&map, &[(58.2, 0.0)], &[]).is_some());
}
