//! How reactive agents move: routes, lights, leaders, removal.

use super::{bystander, car, ego, law, lights, long_lane, object};
use crate::road::Road;
use planagent_world::dynamics::IdmTraffic;
use planagent_world::geometry::{Point, Polyline, Pose};
use planagent_world::{
    EgoState, LaneId, LaneKind, LaneMap, ObjectKind, STEP_S, SignalStatus, TrackedObject,
    TrafficLights,
};
use std::f64::consts::PI;
use std::sync::Arc;

fn no_lights() -> TrafficLights {
    TrafficLights::default()
}

fn at(x: f64) -> Pose {
    Pose::new(x, 0.0, 0.0)
}

#[test]
fn an_agent_a_hundred_meters_away_stays_and_one_farther_goes_for_good() {
    let map = long_lane();
    let cars = [car(1, at(150.0), 0.0), car(2, at(150.1 + 4.7), 0.0)];
    let mut traffic = IdmTraffic::new(&map, &cars, &ego(Pose::new(54.75, 0.0, 0.0), 0.0));
    // The distance is that of the centers: 95.25 and 100.05 m. At the start nobody is too far.
    assert_eq!(traffic.agent_count(), 2);
    traffic.step(
        &ego(Pose::new(54.75, 0.0, 0.0), 0.0),
        &[],
        &no_lights(),
        STEP_S,
    );
    assert_eq!(
        traffic
            .objects()
            .iter()
            .map(|o| o.token.0)
            .collect::<Vec<_>>(),
        [1]
    );
    traffic.step(
        &ego(Pose::new(150.0, 40.0, 0.0), 0.0),
        &[],
        &no_lights(),
        STEP_S,
    );
    assert_eq!(traffic.agent_count(), 1);
    let mut traffic = IdmTraffic::new(&map, &cars[..1], &bystander());
    traffic.step(
        &ego(Pose::new(50.0, 0.0, 0.0), 0.0),
        &[],
        &no_lights(),
        STEP_S,
    );
    assert_eq!(traffic.agent_count(), 1, "100 m exactly");
}

/// After a step behind the ego: the speed of an agent at x = 30 that drove 8 m/s.
fn behind(ego: &EgoState) -> f64 {
    let mut traffic = IdmTraffic::new(&long_lane(), &[car(1, at(30.0), 8.0)], ego);
    traffic.step(ego, &[], &no_lights(), STEP_S);
    traffic.objects()[0].speed()
}

#[test]
fn the_speed_of_a_leader_is_projected_on_the_heading_of_the_agent() {
    // Gap: from 32.3 to the rear of an ego centered at 60 (2.588 m).
    let gap = 60.0 - 2.588 - 32.3;
    let same = behind(&ego(at(60.0), 5.0));
    assert!(
        (same - (8.0 + 0.1 * law(8.0, 12.0, gap, 5.0))).abs() < 1e-6,
        "{same}"
    );
    // Oncoming, it counts as driving backwards: −5 m/s.
    let oncoming = behind(&ego(Pose::new(60.0, 0.0, PI), 5.0));
    assert!(
        (oncoming - (8.0 + 0.1 * law(8.0, 12.0, gap, -5.0))).abs() < 1e-6,
        "{oncoming}"
    );
    // Across, it stands; its nearest side is half its width away.
    let across = behind(&ego(Pose::new(60.0, 0.0, PI / 2.0), 5.0));
    assert!(
        (across - (8.0 + 0.1 * law(8.0, 12.0, 60.0 - 1.1485 - 32.3, 0.0))).abs() < 1e-6,
        "{across}"
    );
}

#[test]
fn replayed_objects_stand_whatever_their_speed_and_are_those_of_the_next_iteration() {
    let walker = |x: f64| object(9, ObjectKind::Pedestrian, at(x), (0.6, 0.6), 2.0);
    let mut traffic = IdmTraffic::new(
        &long_lane(),
        &[car(1, at(30.0), 8.0), walker(90.0)],
        &bystander(),
    );
    traffic.step(&bystander(), &[walker(60.0)], &no_lights(), STEP_S);
    let speed = traffic.objects()[0].speed();
    assert!(
        (speed - (8.0 + 0.1 * law(8.0, 12.0, 59.7 - 32.3, 0.0))).abs() < 1e-6,
        "{speed}"
    );
    assert!((traffic.objects()[1].shape.center.x - 60.0).abs() < 1e-12);
}

#[test]
fn after_its_first_step_an_agent_measures_from_its_projected_footprint() {
    let cars = [car(1, at(80.0), 0.0), car(2, at(30.0), 8.0)];
    let mut traffic = IdmTraffic::new(&long_lane(), &cars, &bystander());
    // Somebody stands before the first car, so that it does not move.
    let wall = object(9, ObjectKind::Barrier, at(83.0), (0.4, 2.0), 0.0);
    traffic.step(&bystander(), &[wall], &no_lights(), STEP_S);
    let first = traffic.objects()[1].speed();
    assert!(
        (first - (8.0 + 0.1 * law(8.0, 12.0, 80.0 - 4.6 - 30.0, 0.0))).abs() < 1e-6,
        "{first}"
    );
    traffic.step(&bystander(), &[wall], &no_lights(), STEP_S);
    // Its center is at 30.8; its footprint reaches half its length and 1.5 s of driving ahead.
    let gap = (80.0 - 2.3) - (30.8 + 2.3 + 1.5 * first);
    let second = traffic.objects()[1].speed();
    assert!(
        (second - (first + 0.1 * law(first, 12.0, gap, 0.0))).abs() < 1e-6,
        "{second}"
    );
}

#[test]
fn the_step_is_as_long_as_it_is_told() {
    for dt in [0.05, 0.1, 0.12] {
        let mut traffic = IdmTraffic::new(&long_lane(), &[car(1, at(30.0), 8.0)], &bystander());
        traffic.step(&bystander(), &[], &no_lights(), dt);
        let moved = traffic.objects()[0];
        assert!((moved.shape.center.x - (30.0 + 8.0 * dt)).abs() < 1e-9);
        // Free: the end of the path, at the last vertex but one, is a standing obstacle half a
        // length early.
        let free = law(8.0, 12.0, 299.5 - 30.0 - 2.3, 0.0);
        assert!((moved.speed() - (8.0 + dt * free)).abs() < 1e-9);
    }
}

/// A lane of 60 m, then a connector of 20 m (with a light, if so) and a lane of 100 m.
fn crossing(light: bool) -> (Arc<LaneMap>, LaneId) {
    let mut road = Road::default();
    let a = road.dense(LaneKind::Lane, (0.0, 0.0), (60.0, 0.0), Some(12.0));
    let b = road.dense(LaneKind::Connector, (60.0, 0.0), (80.0, 0.0), None);
    let c = road.dense(LaneKind::Lane, (80.0, 0.0), (180.0, 0.0), Some(12.0));
    road.link(a, b);
    road.link(b, c);
    road.parts.lanes[b.index()].has_traffic_lights = light;
    road.stop_line(58.5, b);
    (Arc::new(road.build()), b)
}

#[test]
fn an_edge_with_lights_needs_green_and_one_without_only_no_red() {
    // From x = 30 a path of 20 + 12·1.5 = 38 m is wanted and 29.5 m are there: the route continues
    // if it may.
    let goes_on = |light: bool, status: Option<SignalStatus>| {
        let (map, connector) = crossing(light);
        let mut traffic = IdmTraffic::new(&map, &[car(1, at(30.0), 8.0)], &bystander());
        let shown = status.map_or_else(no_lights, |status| lights(connector, status));
        traffic.step(&bystander(), &[], &shown, STEP_S);
        let ends_at = |x: f64| {
            (traffic.objects()[0].speed() - (8.0 + 0.1 * law(8.0, 12.0, x - 32.3, 0.0))).abs()
                < 1e-9
        };
        let (stays, goes) = (ends_at(59.5), ends_at(79.5));
        assert!(
            stays != goes,
            "{light} {status:?}: {}",
            traffic.objects()[0].speed()
        );
        goes
    };
    assert!(goes_on(true, Some(SignalStatus::Green)));
    for status in [
        SignalStatus::Yellow,
        SignalStatus::Red,
        SignalStatus::Unknown,
    ] {
        assert!(!goes_on(true, Some(status)), "{status:?}");
    }
    assert!(
        !goes_on(true, None),
        "a light that shows nothing is not green"
    );
    for status in [
        None,
        Some(SignalStatus::Green),
        Some(SignalStatus::Yellow),
        Some(SignalStatus::Unknown),
    ] {
        assert!(goes_on(false, status), "{status:?}");
    }
    assert!(!goes_on(false, Some(SignalStatus::Red)));
}

#[test]
fn stop_lines_of_the_route_count_while_they_show_red() {
    let (map, connector) = crossing(true);
    let mut traffic = IdmTraffic::new(&map, &[car(1, at(30.0), 8.0)], &bystander());
    traffic.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Green),
        STEP_S,
    );
    let before = traffic.objects()[0].speed();
    traffic.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Red),
        STEP_S,
    );
    // The connector is in the route by now; its stop line begins at 58.5, the own footprint ends at
    // 30.8 + 2.3 + 1.5 s.
    let gap = 58.5 - (30.8 + 2.3 + 1.5 * before);
    let braking = traffic.objects()[0].speed();
    assert!(
        (braking - (before + 0.1 * law(before, 12.0, gap, 0.0))).abs() < 1e-6,
        "{braking}"
    );
    // Yellow holds nobody who is on the way already.
    let mut yellow = IdmTraffic::new(&map, &[car(1, at(30.0), 8.0)], &bystander());
    yellow.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Green),
        STEP_S,
    );
    yellow.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Yellow),
        STEP_S,
    );
    assert!(yellow.objects()[0].speed() > before);
}

#[test]
fn an_agent_at_the_very_end_of_its_path_waits_and_sets_out_from_the_pose_before() {
    let (map, connector) = crossing(true);
    // Centered at 59.6, beyond the last pose of its path (59.5; the vertex at 60 is dropped): it is
    // seen at that pose.
    let mut traffic = IdmTraffic::new(&map, &[car(1, at(59.6), 0.0)], &bystander());
    for _ in 0..5 {
        traffic.step(
            &bystander(),
            &[],
            &lights(connector, SignalStatus::Red),
            STEP_S,
        );
        assert!(
            (traffic.objects()[0].shape.center.x - 59.5).abs() < 1e-9
                && traffic.objects()[0].speed() < 1e-9
        );
    }
    traffic.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Green),
        STEP_S,
    );
    assert!(
        (traffic.objects()[0].shape.center.x - 59.0).abs() < 1e-9,
        "{}",
        traffic.objects()[0].shape.center.x
    );
    traffic.step(
        &bystander(),
        &[],
        &lights(connector, SignalStatus::Green),
        STEP_S,
    );
    assert!(traffic.objects()[0].speed() > 0.1);
}

#[test]
fn of_several_edges_the_straightest_is_taken() {
    let mut road = Road::default();
    let a = road.dense(LaneKind::Lane, (0.0, 0.0), (60.0, 0.0), None);
    let arc = |turn: f64| {
        let points = (0..=20).map(|i| {
            let s = f64::from(i);
            Point::new(
                60.0 + (turn * s).sin() / turn,
                (1.0 - (turn * s).cos()) / turn,
            )
        });
        Polyline::new(points).unwrap()
    };
    let left = road.along(LaneKind::Connector, arc(0.05), None);
    let ahead = road.along(LaneKind::Connector, arc(-0.01), None);
    let right = road.along(LaneKind::Connector, arc(-0.05), None);
    for next in [left, ahead, right] {
        road.link(a, next);
    }
    let map = Arc::new(road.build());
    let mut traffic = IdmTraffic::new(&map, &[car(1, at(40.0), 10.0)], &bystander());
    for _ in 0..35 {
        traffic.step(&bystander(), &[], &no_lights(), STEP_S);
    }
    let center = traffic.objects()[0].shape.center;
    let on_ahead = map[ahead].centerline.project(center.position());
    assert!(center.x > 61.0 && on_ahead.distance < 0.05, "{center:?}");
}

#[test]
fn a_vehicle_before_it_in_the_list_has_moved_already_and_one_after_has_not() {
    let speeds = |objects: &[TrackedObject]| {
        let mut traffic = IdmTraffic::new(&long_lane(), objects, &bystander());
        traffic.step(&bystander(), &[], &no_lights(), STEP_S);
        traffic
            .objects()
            .iter()
            .find(|o| o.token.0 == 2)
            .unwrap()
            .speed()
    };
    let (lead, follower) = (car(1, at(60.0), 8.0), car(2, at(30.0), 8.0));
    let lead_after = 8.0 + 0.1 * law(8.0, 12.0, 299.0 - 60.0 - 2.3, 0.0);
    let moved = 8.0 + 0.1 * law(8.0, 12.0, 60.8 - 2.3 - 32.3, lead_after);
    let still = 8.0 + 0.1 * law(8.0, 12.0, 60.0 - 2.3 - 32.3, 8.0);
    assert!((speeds(&[lead, follower]) - moved).abs() < 1e-6);
    assert!((speeds(&[follower, lead]) - still).abs() < 1e-6);
}
