//! Which lanes a driven path used, and whether the corners of the ego agree.

use crate::road::{Road, cruise, ego, two_lanes};
use planagent_score::metrics::{
    CornerAgreement, DrivenLanes, driven_route, ego_lane_change, find_lane_changes, lanes_at,
};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneId};
use std::collections::BTreeSet;

fn shared(ids: &[LaneId]) -> CornerAgreement {
    CornerAgreement::Shared(ids.iter().copied().collect::<BTreeSet<_>>())
}

#[test]
fn between_a_lane_and_the_next_the_corners_still_agree() {
    let mut road = Road::default();
    let (a, b) = (
        road.lane((0.0, 0.0), (50.0, 0.0)),
        road.connector((50.0, 0.0), (100.0, 0.0)),
    );
    road.link(a, b);
    let map = road.build();
    let states = cruise(3, 48.9, 0.0, 10.0);
    let lanes = DrivenLanes::from_states(&map, &states);
    assert_eq!(lanes.corners[0], [vec![b], vec![a], vec![a], vec![b]]);
    assert!((0..3).all(|i| lanes.in_common(i)), "{:?}", lanes.agreement);
}

#[test]
fn unrelated_lanes_split_and_open_land_is_outside() {
    let map = two_lanes();
    let agreement = |y: f64| {
        DrivenLanes::from_states(&map, &cruise(1, 0.0, y, 5.0))
            .agreement
            .remove(0)
    };
    assert_eq!(agreement(0.0), shared(&[LaneId(0)]));
    assert_eq!(agreement(4.0), shared(&[LaneId(1)]));
    assert_eq!(agreement(2.0), CornerAgreement::Split);
    assert_eq!(agreement(-2.0), CornerAgreement::Split);
    assert_eq!(agreement(40.0), CornerAgreement::Outside);
}

/// Drives from y to y along x at 10 m/s, a tenth of the way a step.
fn drift(from: f64, to: f64, steps: usize) -> Vec<EgoState> {
    (0..=steps)
        .map(|k| {
            ego(
                k as i64,
                k as f64,
                from + (to - from) * k as f64 / steps as f64,
                0.0,
                10.0,
            )
        })
        .collect()
}

#[test]
fn a_lane_change_lasts_while_the_corners_disagree() {
    let map = two_lanes();
    // The left side crosses y = 2 when the center passes 0.8515, the right side when it passes
    // 3.1485: steps of 0.1 m.
    let states = drift(0.0, 4.0, 40);
    let lanes = DrivenLanes::from_states(&map, &states);
    let changes = find_lane_changes(&map, &states, &lanes.agreement);
    assert_eq!(changes.len(), 1);
    assert!(changes[0].success);
    assert_eq!(
        (changes[0].start_us, changes[0].duration_us),
        (900_000, 2_300_000)
    );
    let result = ego_lane_change(&map, &states, &lanes);
    assert_eq!(result.statistic("number_of_ego_lane_change"), Some(1.0));
    assert_eq!(
        result.statistic("ratio_of_failed_ego_lane_change"),
        Some(0.0)
    );

    // Back into the first lane, or never done: failed.
    let mut aborted = drift(0.0, 2.0, 20);
    aborted.extend(drift(2.0, 0.0, 20).into_iter().map(|mut s| {
        s.time_us += 2_100_000;
        s
    }));
    let lanes = DrivenLanes::from_states(&map, &aborted);
    assert!(!find_lane_changes(&map, &aborted, &lanes.agreement)[0].success);
    let open = drift(0.0, 2.0, 20);
    let lanes = DrivenLanes::from_states(&map, &open);
    assert!(!find_lane_changes(&map, &open, &lanes.agreement)[0].success);
    assert_eq!(
        ego_lane_change(&map, &open, &lanes).statistic("ego_lane_change_fail_rate_below_threshold"),
        Some(0.0)
    );
}

#[test]
fn ambiguous_connectors_are_resolved_by_where_the_path_ends_up() {
    let mut road = Road::default();
    let a = road.lane((0.0, 0.0), (50.0, 0.0));
    // Two connectors over the same ground: one straight on, one towards another exit.
    let (straight, other) = (
        road.connector((50.0, 0.0), (80.0, 0.0)),
        road.connector((50.0, 1.0), (80.0, 1.0)),
    );
    let (b, c) = (
        road.lane((80.0, 0.0), (150.0, 0.0)),
        road.lane((80.0, 20.0), (150.0, 20.0)),
    );
    for (from, to) in [(a, straight), (a, other), (straight, b), (other, c)] {
        road.link(from, to);
    }
    let map = road.build();
    let poses: Vec<Pose> = (0..100)
        .map(|k| Pose::new(40.0 + f64::from(k), 0.0, 0.0))
        .collect();
    let route = driven_route(&map, &poses);
    assert!(
        route[..10].iter().all(|lanes| lanes == &[a]),
        "{:?}",
        &route[..12]
    );
    assert!(route[40..].iter().all(|lanes| lanes == &[b]));
    // Both hold every sample between; the last is narrowed by the lane after it, and each earlier
    // one by its successor.
    assert!(
        route[10..40].iter().all(|lanes| lanes == &[straight]),
        "{:?}",
        &route[10..40]
    );
}

#[test]
fn beside_its_connector_a_path_is_held_to_it_while_within_five_meters() {
    let mut road = Road::default();
    let (one, two) = (
        road.connector((0.0, 0.0), (100.0, 0.0)),
        road.connector((0.0, 8.0), (100.0, 8.0)),
    );
    let map = road.build();
    let route = |ys: [f64; 4]| driven_route(&map, &ys.map(|y| Pose::new(50.0, y, 0.0)));
    assert_eq!(route([0.0, 0.0, 0.0, 6.5])[3], [one]);
    assert_eq!(route([0.0, 0.0, 0.0, 7.5])[3], [two]);
    // The rule starts with the third sample.
    assert_eq!(route([0.0, 6.5, 6.5, 6.5])[1], [two]);
}

#[test]
fn where_lanes_overlap_the_best_by_heading_and_distance_counts() {
    let mut road = Road::default();
    let (east, north) = (
        road.lane((-50.0, 0.0), (50.0, 0.0)),
        road.lane((0.0, -50.0), (0.0, 50.0)),
    );
    let map = road.build();
    let at = |heading: f64| {
        let pose = Pose::new(0.5, 0.5, heading);
        lanes_at(&map, pose.position(), pose)
    };
    assert_eq!(at(0.1), [east]);
    assert_eq!(at(1.5), [north]);
    // A car on the crossing lanes is in common lanes all the way.
    let states = cruise(50, -20.0, 0.3, 10.0);
    let lanes = DrivenLanes::from_states(&map, &states);
    assert!((0..50).all(|i| lanes.in_common(i)));
    assert!(lanes.center.iter().all(|l| l == &[east]));
}

#[test]
fn at_the_second_sample_what_one_corner_finds_binds_the_corners_after_it() {
    let mut road = Road::default();
    let a = road.connector((0.0, 0.0), (50.0, 0.0));
    // Ahead of it two that overlap: the right front corner (y = −1.15) is in both, the left one in
    // `b` alone.
    let (b, c) = (
        road.connector((50.0, 0.0), (100.0, 0.0)),
        road.connector((50.0, -2.0), (100.0, -2.0)),
    );
    let map = road.build();
    let front_right = |xs: &[f64]| {
        let states: Vec<EgoState> = xs
            .iter()
            .enumerate()
            .map(|(k, &x)| ego(k as i64, x, 0.0, 0.0, 10.0))
            .collect();
        let mut corners = DrivenLanes::from_states(&map, &states).corners;
        let [fl, rl, rr, fr] = corners.pop().unwrap();
        assert_eq!((fl, rl, rr), (vec![b], vec![a], vec![a]));
        fr
    };
    // The front is 2.588 m before the center: over the joint at 48.5, not at 45.
    assert_eq!(front_right(&[45.0, 48.5]), [b]);
    assert_eq!(front_right(&[45.0, 45.0, 48.5]), [b, c]);
}

#[test]
fn connectors_that_end_nowhere_lose_all_their_samples() {
    let mut road = Road::default();
    let a = road.lane((0.0, 0.0), (50.0, 0.0));
    let (one, two) = (
        road.connector((50.0, 0.0), (80.0, 0.0)),
        road.connector((50.0, 1.0), (80.0, 1.0)),
    );
    road.link(a, one);
    road.link(a, two);
    let map = road.build();
    let poses: Vec<Pose> = (0..60)
        .map(|k| Pose::new(40.0 + f64::from(k), 0.0, 0.0))
        .collect();
    let route = driven_route(&map, &poses);
    // Off the map after 80 m. An empty sample counts as a part of the two connectors before it and
    // empties them, and so on backwards; a single lane is not touched.
    assert!(route[..10].iter().all(|lanes| lanes == &[a]));
    assert!(route[10..].iter().all(Vec::is_empty), "{:?}", &route[10..]);
    // On a single connector there is nothing to resolve.
    let beside: Vec<Pose> = (0..60)
        .map(|k| Pose::new(40.0 + f64::from(k), 2.5, 0.0))
        .collect();
    assert!(
        driven_route(&map, &beside)[12..39]
            .iter()
            .all(|lanes| lanes == &[two])
    );
}

#[test]
fn a_lane_change_that_leaves_the_road_fails_and_one_into_the_next_lane_of_the_same_road_is_none() {
    let map = two_lanes();
    // Off to the right: the corners disagree from −0.9 on (the right side passes −2) and are all
    // outside from −3.2 on.
    let states = drift(0.0, -8.0, 80);
    let lanes = DrivenLanes::from_states(&map, &states);
    let changes = find_lane_changes(&map, &states, &lanes.agreement);
    assert_eq!(changes.len(), 1);
    assert!(!changes[0].success);
    assert_eq!(
        (changes[0].start_us, changes[0].duration_us),
        (900_000, 2_300_000)
    );
    // A failure alone: a rate of 1 is above 0.3.
    let result = ego_lane_change(&map, &states, &lanes);
    assert_eq!(
        result.statistic("ratio_of_failed_ego_lane_change"),
        Some(1.0)
    );
    assert_eq!(result.statistic("max_ego_lane_change_duration"), Some(2.3));

    // Over a gap of 2 m between a lane and its successor first the front corners and then the rear
    // ones are in no lane. Both times the ego ends in the lane it left or in one that follows it:
    // failed.
    let mut road = Road::default();
    let (a, b) = (
        road.lane((0.0, 0.0), (50.0, 0.0)),
        road.lane((52.0, 0.0), (150.0, 0.0)),
    );
    road.link(a, b);
    let map = road.build();
    let states = cruise(40, 40.0, 0.0, 10.0);
    let lanes = DrivenLanes::from_states(&map, &states);
    let changes = find_lane_changes(&map, &states, &lanes.agreement);
    assert_eq!(changes.len(), 2);
    assert!(
        changes
            .iter()
            .all(|change| !change.success && change.duration_us == 200_000),
        "{changes:?}"
    );
}
