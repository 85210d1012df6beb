//! Which vehicles become reactive agents, and where they start.

use super::{bystander, car, ego, long_lane, object};
use crate::road::Road;
use planagent_world::dynamics::IdmTraffic;
use planagent_world::geometry::Pose;
use planagent_world::{LaneKind, ObjectKind, STEP_S, TrafficLights};
use std::f64::consts::PI;
use std::sync::Arc;

#[test]
fn of_several_lanes_the_nearest_heading_counts_without_wrapping() {
    let mut road = Road::default();
    // West-bound, its heading −π (the direction −0.0 makes atan2 say so); and north-bound.
    let west = road.dense(LaneKind::Connector, (40.0, -1e-9), (-40.0, -2e-9), None);
    let north = road.dense(LaneKind::Connector, (0.0, -40.0), (0.0, 40.0), None);
    road.parts
        .intersections
        .push(crate::road::rectangle((-40.0, 40.0), (-40.0, 40.0)));
    let map = Arc::new(road.build());
    assert!(
        map[west].centerline.heading_at(0.0) < -3.1 && map[north].centerline.heading_at(0.0) > 1.57
    );
    let heading_of = |heading: f64| {
        let vehicle = [car(1, Pose::new(0.0, 0.0, heading), 0.0)];
        IdmTraffic::new(&map, &vehicle, &bystander()).objects()[0]
            .shape
            .center
            .heading
    };
    // Headed −3.0, the car fits the lane to the west (0.14 off). Headed 3.1, it fits it even
    // better, but −π and 3.1 are 6.24 apart as numbers, and π/2 only 1.53.
    assert!((heading_of(-3.0).abs() - PI).abs() < 1e-6);
    assert!((heading_of(3.1) - PI / 2.0).abs() < 1e-6);
}

#[test]
fn a_snapped_box_that_meets_anything_accepted_before_is_left_out() {
    let map = long_lane();
    let seen = |objects: &[planagent_world::TrackedObject], ego| {
        IdmTraffic::new(&map, objects, &ego)
            .objects()
            .iter()
            .map(|o| o.token.0)
            .collect::<Vec<_>>()
    };
    // 4.7 m apart: cars of 4.6 m pass each other. 1.5 m to the side they would, but both are
    // snapped to the lane.
    assert_eq!(
        seen(
            &[
                car(1, Pose::new(50.0, 0.0, 0.0), 0.0),
                car(2, Pose::new(54.7, 0.0, 0.0), 0.0)
            ],
            bystander()
        ),
        [1, 2]
    );
    assert_eq!(
        seen(
            &[
                car(1, Pose::new(50.0, -1.5, 0.0), 0.0),
                car(2, Pose::new(52.0, 1.5, 0.0), 0.0)
            ],
            bystander()
        ),
        [1]
    );
    // The first is left out because of a cone, so the second may stay.
    let cone = object(
        3,
        ObjectKind::TrafficCone,
        Pose::new(49.0, 0.0, 0.0),
        (0.4, 0.4),
        0.0,
    );
    assert_eq!(
        seen(
            &[
                car(1, Pose::new(50.0, 0.0, 0.0), 0.0),
                car(2, Pose::new(52.6, 0.0, 0.0), 0.0),
                cone
            ],
            bystander()
        ),
        [2, 3]
    );
    // A bicycle is in no list and blocks nobody; nor does it exist.
    let bicycle = object(
        4,
        ObjectKind::Bicycle,
        Pose::new(50.0, 0.0, 0.0),
        (1.8, 0.6),
        3.0,
    );
    assert_eq!(
        seen(
            &[bicycle, car(1, Pose::new(50.0, 0.0, 0.0), 0.0)],
            bystander()
        ),
        [1]
    );
    // The ego blocks.
    assert_eq!(
        seen(
            &[car(1, Pose::new(50.0, 0.0, 0.0), 0.0)],
            ego(Pose::new(53.0, 0.0, 0.0), 0.0)
        ),
        [0u32; 0]
    );
    // The same track twice is one agent.
    assert_eq!(
        seen(
            &[
                car(1, Pose::new(50.0, 0.0, 0.0), 0.0),
                car(1, Pose::new(80.0, 0.0, 0.0), 0.0)
            ],
            bystander()
        ),
        [1]
    );
}

#[test]
fn an_unknown_speed_is_that_of_the_ego() {
    let mut vehicle = car(1, Pose::new(50.0, 0.0, 0.0), 3.0);
    vehicle.velocity.y = f64::NAN;
    let traffic = IdmTraffic::new(
        &long_lane(),
        &[vehicle],
        &ego(Pose::new(50.0, 40.0, 0.0), 7.0),
    );
    assert!((traffic.objects()[0].speed() - 7.0).abs() < 1e-12);
}

#[test]
fn nobody_is_added_later() {
    let map = long_lane();
    let mut traffic = IdmTraffic::new(&map, &[], &bystander());
    traffic.step(
        &bystander(),
        &[car(1, Pose::new(50.0, 0.0, 0.0), 5.0)],
        &TrafficLights::default(),
        STEP_S,
    );
    assert!(traffic.objects().is_empty());
}

#[test]
fn the_size_stays_that_of_the_start() {
    let map = long_lane();
    let mut traffic = IdmTraffic::new(
        &map,
        &[car(1, Pose::new(50.0, 0.0, 0.0), 5.0)],
        &bystander(),
    );
    let longer = object(
        1,
        ObjectKind::Vehicle,
        Pose::new(50.5, 0.0, 0.0),
        (9.0, 2.5),
        5.0,
    );
    traffic.step(&bystander(), &[longer], &TrafficLights::default(), STEP_S);
    assert_eq!(
        (
            traffic.objects()[0].shape.length,
            traffic.objects()[0].shape.width
        ),
        super::CAR
    );
}
