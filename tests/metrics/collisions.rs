//! Collisions and times to collision on a hand-made road with two lanes (centered at y = 0 and y =
//! 4, each 4 m wide).

use crate::road::{Road, cruise, object, rectangle, samples, straight, two_lanes};
use planagent_score::metrics::{
    Collision, CollisionType, DrivenLanes, TTC_HORIZON_S, find_collisions,
    no_ego_at_fault_collisions, time_to_collision, time_to_collision_within_bound,
};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneMap, ObjectKind, TrackedObject};

const CAR: (f64, f64) = (4.0, 2.0);

fn car(token: u32, x: f64, y: f64, speed: f64) -> TrackedObject {
    object(token, ObjectKind::Vehicle, Pose::new(x, y, 0.0), CAR, speed)
}

fn collisions(
    map: &LaneMap,
    states: &[EgoState],
    objects: &[TrackedObject],
) -> (Vec<Collision>, f64) {
    let found = find_collisions(
        &samples(states, objects),
        &DrivenLanes::from_states(map, states),
    );
    let score = no_ego_at_fault_collisions(&found).score.unwrap();
    (found, score)
}

#[test]
fn a_lateral_collision_is_at_fault_only_between_lanes() {
    let map = two_lanes();
    // In its lane, brushed by a moving car of the next lane: not at fault. Ego's left side is at
    // y + 1.1485.
    let (inside, score) = collisions(&map, &cruise(10, 0.0, 0.5, 5.0), &[car(1, 0.0, 2.6, 6.0)]);
    assert_eq!(inside[0].collision_type, CollisionType::ActiveLateral);
    assert!(!inside[0].at_fault && (score - 1.0).abs() < 1e-12);
    // Astride the line at y = 2, the same touch is.
    let (astride, score) = collisions(&map, &cruise(10, 0.0, 1.5, 5.0), &[car(1, 0.0, 3.6, 6.0)]);
    assert_eq!(astride[0].collision_type, CollisionType::ActiveLateral);
    assert!(astride[0].at_fault && score.abs() < 1e-12);
}

#[test]
fn each_track_counts_once_at_its_first_touch() {
    let map = straight();
    // The ego's front is 2.588 m ahead of its center; a car standing at x = 20 has its rear at 18:
    // first overlap at center 15.5.
    let (found, score) = collisions(&map, &cruise(60, 0.0, 0.0, 5.0), &[car(7, 20.0, 0.0, 0.0)]);
    assert_eq!(found.len(), 1);
    assert_eq!(
        (found[0].sample, found[0].collision_type),
        (31, CollisionType::StoppedTrack)
    );
    assert!((found[0].delta_v - 2.5).abs() < 1e-12 && score.abs() < 1e-12);
}

#[test]
fn groups_multiply() {
    let map = straight();
    let cone = |token, x: f64| {
        object(
            token,
            ObjectKind::TrafficCone,
            Pose::new(x, 0.0, 0.0),
            (0.4, 0.4),
            0.0,
        )
    };
    let drive = cruise(60, 0.0, 0.0, 5.0);
    let score = |objects: &[TrackedObject]| collisions(&map, &drive, objects).1;
    assert!((score(&[]) - 1.0).abs() < 1e-12);
    assert!((score(&[cone(1, 10.0)]) - 0.5).abs() < 1e-12);
    assert!(score(&[cone(1, 10.0), cone(2, 15.0)]).abs() < 1e-12);
    let walker = object(
        3,
        ObjectKind::Pedestrian,
        Pose::new(10.0, 0.0, 1.5),
        (0.6, 0.6),
        1.0,
    );
    assert!(score(&[walker]).abs() < 1e-12);
    // A car that runs into the ego's rear is not its fault.
    assert!((score(&[car(4, -4.0, 0.0, 9.0)]) - 1.0).abs() < 1e-12);
}

fn least_ttc(map: &LaneMap, states: &[EgoState], objects: &[TrackedObject]) -> f64 {
    let samples = samples(states, objects);
    let lanes = DrivenLanes::from_states(map, states);
    let found = find_collisions(&samples, &lanes);
    let ttc = time_to_collision(map, &samples, &lanes, &found, TTC_HORIZON_S);
    ttc.into_iter().fold(f64::INFINITY, f64::min)
}

#[test]
fn time_to_collision_counts_tenths_of_seconds_below_three() {
    let map = straight();
    let at_start = cruise(1, 0.0, 0.0, 10.0);
    // Gap = x − 2 − 2.588 m; at 10 m/s it closes in gap/10 s, rounded up to the next tenth.
    assert!((least_ttc(&map, &at_start, &[car(1, 14.0, 0.0, 0.0)]) - 1.0).abs() < 1e-9);
    assert!((least_ttc(&map, &at_start, &[car(1, 13.5, 0.0, 0.0)]) - 0.9).abs() < 1e-9);
    // 28.9 m: reached at 2.9 s. 29.1 m would be 3.0 s, which the horizon excludes.
    assert!((least_ttc(&map, &at_start, &[car(1, 4.588 + 28.9, 0.0, 0.0)]) - 2.9).abs() < 1e-9);
    assert!(least_ttc(&map, &at_start, &[car(1, 4.588 + 29.1, 0.0, 0.0)]).is_infinite());
    // A slow car ahead: the difference of speeds counts, 4.5 m at 5 m/s.
    assert!((least_ttc(&map, &at_start, &[car(1, 9.08, 0.0, 5.0)]) - 0.9).abs() < 1e-9);
}

#[test]
fn those_beside_count_between_lanes_and_in_intersections_only() {
    let cutting = |y: f64| object(1, ObjectKind::Vehicle, Pose::new(3.0, y, -1.2), CAR, 6.0);
    let map = two_lanes();
    // 5 m to the left and 4.5 m ahead of the rear axle: about 50° off, neither ahead nor behind.
    assert!(least_ttc(&map, &cruise(1, 0.0, 0.0, 5.0), &[cutting(5.0)]).is_infinite());
    assert!(least_ttc(&map, &cruise(1, 0.0, 1.5, 5.0), &[cutting(6.5)]).is_finite());
    let mut crossing = Road::default();
    crossing.connector((-50.0, 0.0), (50.0, 0.0));
    crossing
        .parts
        .intersections
        .push(rectangle((-50.0, 50.0), (-10.0, 10.0)));
    assert!(
        least_ttc(
            &crossing.build(),
            &cruise(1, 0.0, 0.0, 5.0),
            &[cutting(5.0)]
        )
        .is_finite()
    );
}

#[test]
fn a_stopped_ego_hits_no_one_and_a_hit_track_is_left_out_afterwards() {
    let map = straight();
    assert!(least_ttc(&map, &cruise(1, 0.0, 0.0, 0.004), &[car(1, 5.0, 0.0, 0.0)]).is_infinite());
    // Struck from behind at once (not at fault): the track no longer counts.
    assert!(least_ttc(&map, &cruise(5, 0.0, 0.0, 5.0), &[car(1, -4.0, 0.0, 9.0)]).is_infinite());
    // Touching a standing car is at fault: 0 at that sample.
    assert!(least_ttc(&map, &cruise(5, 0.0, 0.0, 5.0), &[car(1, 4.0, 0.0, 0.0)]).abs() < 1e-12);
}

#[test]
fn those_behind_never_count_and_those_within_thirty_degrees_always_do() {
    let map = two_lanes();
    let astride = cruise(1, 0.0, 1.5, 5.0);
    // A faster car close behind, even while the ego is between lanes: 15 m back at 20 m/s would be
    // 0.7 s.
    assert!(least_ttc(&map, &astride, &[car(1, -15.0, 1.5, 20.0)]).is_infinite());
    // 150° off the heading, seen from the rear axle at −1.461: a center 10 m back counts from 5.774
    // m to the side on.
    let behind = |y: f64| {
        object(
            1,
            ObjectKind::Vehicle,
            Pose::new(-11.461, 1.5 + y, -0.5),
            CAR,
            15.0,
        )
    };
    assert!(least_ttc(&map, &astride, &[behind(5.7)]).is_infinite());
    assert!(least_ttc(&map, &astride, &[behind(5.85)]).is_finite());
    // 30° off: 10 m ahead of the rear axle less than 5.774 m to the side, in one lane as well.
    let crossing = |y: f64| object(1, ObjectKind::Vehicle, Pose::new(8.539, y, -1.2), CAR, 4.0);
    let within = cruise(1, 0.0, 0.0, 5.0);
    assert!(least_ttc(&map, &within, &[crossing(5.7)]).is_finite());
    assert!(least_ttc(&map, &within, &[crossing(5.85)]).is_infinite());
}

#[test]
fn a_tenth_of_a_second_decides_the_bound() {
    let map = straight();
    let score = |gap: f64| {
        let states = cruise(1, 0.0, 0.0, 10.0);
        let samples = samples(&states, &[car(1, 4.588 + gap, 0.0, 0.0)]);
        let ttc = time_to_collision(
            &map,
            &samples,
            &DrivenLanes::from_states(&map, &states),
            &[],
            TTC_HORIZON_S,
        );
        time_to_collision_within_bound(&states, ttc, TTC_HORIZON_S).score
    };
    assert_eq!(score(9.1), Some(1.0), "1.0 s");
    assert_eq!(score(8.9), Some(0.0), "0.9 s");
}
