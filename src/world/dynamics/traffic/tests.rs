use super::*;
use crate::dynamics::test_road::{Stretch, ego_at, object, straight_road};
use crate::{BASELINE_SPACING, LaneId, PACIFICA, STEP_S};
use proptest::prelude::*;

const SIGNAL: LaneId = LaneId(1);

fn crossing() -> Arc<LaneMap> {
    Arc::new(straight_road(
        &[
            Stretch::Lane(120.0),
            Stretch::Signal(20.0),
            Stretch::Lane(200.0),
        ],
        Some(12.0),
    ))
}

fn lights(status: SignalStatus) -> TrafficLights {
    [(SIGNAL, status)].into_iter().collect()
}

/// An ego that is on the road map's far side, out of everybody's way but within the radius.
fn bystander() -> EgoState {
    let ego = ego_at(0, 60.0, 0.0);
    EgoState {
        rear_axle: crate::geometry::Pose::new(60.0, 40.0, 0.0),
        ..ego
    }
}

fn vehicles(xs: &[f64], speed: f64) -> Vec<TrackedObject> {
    xs.iter()
        .enumerate()
        .map(|(i, &x)| object(i as u32, ObjectKind::Vehicle, x, 0.3, speed))
        .collect()
}

fn front(object: &TrackedObject) -> f64 {
    object.shape.center.x + object.shape.length / 2.0
}

#[test]
fn vehicles_on_lanes_are_snapped_and_others_are_not_agents() {
    let objects = [
        object(0, ObjectKind::Vehicle, 30.0, 0.4, 5.0),
        object(1, ObjectKind::Vehicle, 50.0, 9.0, 5.0),
        object(2, ObjectKind::Bicycle, 70.0, 0.0, 3.0),
        object(3, ObjectKind::Pedestrian, 80.0, 0.0, 1.0),
        object(4, ObjectKind::Vehicle, 33.0, 0.0, 5.0),
        object(5, ObjectKind::Vehicle, 80.5, 0.0, 5.0),
        object(6, ObjectKind::Vehicle, 130.0, 0.0, 5.0),
    ];
    let traffic = IdmTraffic::new(&crossing(), &objects, &bystander());
    let seen: Vec<(u32, ObjectKind)> = traffic
        .objects()
        .iter()
        .map(|o| (o.token.0, o.kind))
        .collect();
    // 1 is off the road, 2 a bicycle, 4 meets 0, 5 meets the pedestrian, 6 is in the intersection.
    assert_eq!(
        seen,
        [
            (0, ObjectKind::Vehicle),
            (6, ObjectKind::Vehicle),
            (3, ObjectKind::Pedestrian)
        ]
    );
    assert!(
        traffic.objects()[0].shape.center.y.abs() < 1e-12,
        "snapped to the centreline"
    );
}

#[test]
fn a_vehicle_that_meets_the_ego_is_left_out() {
    let ego = ego_at(0, 30.0, 0.0);
    assert_eq!(
        IdmTraffic::new(&crossing(), &vehicles(&[32.0, 60.0], 0.0), &ego).agent_count(),
        1
    );
}

#[test]
fn the_first_step_is_the_law_by_hand() {
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[30.0], 8.0), &bystander());
    traffic.step(&bystander(), &[], &lights(SignalStatus::Green), STEP_S);
    let moved = traffic.objects()[0];
    assert!(
        (moved.shape.center.x - 30.8).abs() < 1e-9,
        "moves with the old speed"
    );
    // 20 + 12·1.5 = 38 m of way are wanted and 89 are there, so the path ends at the lane's last
    // vertex but one.
    let gap = 120.0 - BASELINE_SPACING - 30.0 - 2.3;
    let desired: f64 = 1.0 + 8.0 * 1.5 + 8.0 * 8.0 / (2.0 * 2.0f64.sqrt());
    let acceleration = 1.0 - (8.0f64 / 12.0).powi(4) - (desired / gap).powi(2);
    assert!((moved.speed() - (8.0 + 0.1 * acceleration)).abs() < 1e-9);
}

#[test]
fn the_second_of_two_follows_the_first_by_hand() {
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[60.0, 30.0], 8.0), &bystander());
    traffic.step(&bystander(), &[], &lights(SignalStatus::Green), STEP_S);
    let (lead, follower) = (traffic.objects()[0], traffic.objects()[1]);
    // The leader has moved; the follower still claims its plain box of iteration 0.
    let gap = (60.8 - 2.3) - (30.0 + 2.3);
    let desired = 1.0 + 8.0 * 1.5 + 8.0 * (8.0 - lead.speed()) / (2.0 * 2.0f64.sqrt());
    let acceleration = 1.0 - (8.0f64 / 12.0).powi(4) - (desired / gap).powi(2);
    assert!((follower.speed() - (8.0 + 0.1 * acceleration)).abs() < 1e-6);
}

#[test]
fn limits_are_inherited_by_those_without() {
    let road = [
        Stretch::Lane(100.0),
        Stretch::Connector(60.0),
        Stretch::Lane(100.0),
    ];
    let map = Arc::new(straight_road(&road, Some(20.0)));
    let on_connector = object(0, ObjectKind::Vehicle, 110.0, 0.0, 10.0);
    let on_lane = object(1, ObjectKind::Vehicle, 30.0, 0.0, 10.0);
    let speed_after_a_step = |objects: &[TrackedObject]| {
        let mut traffic = IdmTraffic::new(&map, objects, &bystander());
        traffic.step(&bystander(), &[], &TrafficLights::default(), STEP_S);
        let objects = traffic.objects();
        objects
            .iter()
            .find(|o| o.token.0 == 0)
            .map(TrackedObject::speed)
            .unwrap()
    };
    // With the default target of 10 m/s, 35 m of way suffice and the path ends on the connector;
    // with the inherited 20 m/s it continues on the next lane, whose limit then applies.
    assert!(
        speed_after_a_step(&[on_connector]) < speed_after_a_step(&[on_lane, on_connector]) - 0.01
    );
}

#[test]
fn agents_stop_before_a_red_light_and_go_on_green() {
    let ego = bystander();
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[50.0], 10.0), &ego);
    for _ in 0..200 {
        traffic.step(&ego, &[], &lights(SignalStatus::Red), STEP_S);
    }
    let waiting = traffic.objects()[0];
    assert!(
        waiting.speed() < 0.05 && front(&waiting) < 120.0 && front(&waiting) > 112.0,
        "{}",
        front(&waiting)
    );
    for _ in 0..100 {
        traffic.step(&ego, &[], &lights(SignalStatus::Green), STEP_S);
    }
    assert!(traffic.agent_count() == 0 || front(&traffic.objects()[0]) > 125.0);
}

#[test]
fn a_light_that_turns_red_stops_at_its_line() {
    let ego = bystander();
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[80.0], 6.0), &ego);
    for step in 0..200 {
        let status = if step < 5 {
            SignalStatus::Green
        } else {
            SignalStatus::Red
        };
        traffic.step(&ego, &[], &lights(status), STEP_S);
    }
    let waiting = traffic.objects()[0];
    assert!(
        waiting.speed() < 0.05 && front(&waiting) < 119.0 && front(&waiting) > 115.0,
        "{}",
        front(&waiting)
    );
}

#[test]
fn agents_stop_behind_a_standing_ego_and_a_pedestrian() {
    let ego = ego_at(0, 80.0, 0.0);
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[40.0], 10.0), &ego);
    for _ in 0..200 {
        traffic.step(&ego, &[], &lights(SignalStatus::Green), STEP_S);
    }
    let gap = 80.0 - PACIFICA.rear_length - front(&traffic.objects()[0]);
    assert!((0.5..2.5).contains(&gap), "gap {gap}");

    let walker = [object(9, ObjectKind::Pedestrian, 70.0, 0.0, 1.0)];
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[40.0], 10.0), &bystander());
    for _ in 0..200 {
        traffic.step(&bystander(), &walker, &lights(SignalStatus::Green), STEP_S);
    }
    let gap = 69.7 - front(&traffic.objects()[0]);
    assert!((0.5..2.5).contains(&gap), "gap {gap}");
}

#[test]
fn agents_beyond_the_radius_never_come_back() {
    let near = ego_at(0, 100.0, 0.0);
    let far = ego_at(0, 210.0, 0.0);
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[30.0, 60.0], 0.0), &near);
    assert_eq!(traffic.agent_count(), 2);
    traffic.step(&far, &[], &TrafficLights::default(), STEP_S);
    assert_eq!(traffic.agent_count(), 0);
    traffic.step(&near, &[], &TrafficLights::default(), STEP_S);
    assert!(traffic.objects().is_empty());
}

#[test]
fn an_agent_rests_at_a_dead_end() {
    let map = Arc::new(straight_road(&[Stretch::Lane(60.0)], None));
    let mut traffic = IdmTraffic::new(&map, &vehicles(&[20.0], 10.0), &bystander());
    for _ in 0..200 {
        traffic.step(&bystander(), &[], &TrafficLights::default(), STEP_S);
    }
    let rest = traffic.objects()[0];
    assert!(
        rest.speed() < 0.05 && front(&rest) < 59.5,
        "{}",
        front(&rest)
    );
}

#[test]
fn a_clone_goes_its_own_way() {
    let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&[40.0], 10.0), &bystander());
    let mut fork = traffic.clone();
    fork.step(&bystander(), &[], &lights(SignalStatus::Green), STEP_S);
    assert!((traffic.objects()[0].shape.center.x - 40.0).abs() < 1e-12);
    traffic.step(&bystander(), &[], &lights(SignalStatus::Green), STEP_S);
    assert_eq!(traffic.objects(), fork.objects());
}

/// The devkit's own check of its agents: 20 steps of 0.5 s, and no two footprints meet.
#[test]
fn no_two_agents_meet_under_the_law_of_the_devkit_test() {
    let law = IdmParameters {
        target_velocity: 10.0,
        min_gap: 3.0,
        headway: 2.0,
        ..IDM_AGENT
    };
    let map = Arc::new(straight_road(
        &[
            Stretch::Lane(120.0),
            Stretch::Signal(20.0),
            Stretch::Lane(200.0),
        ],
        None,
    ));
    for status in [SignalStatus::Green, SignalStatus::Red] {
        let objects = vehicles(&[90.0, 60.0, 40.0, 20.0], 5.0);
        let mut traffic = IdmTraffic::with_law(&map, &objects, &bystander(), law);
        for _ in 0..20 {
            traffic.step(&bystander(), &[], &lights(status), 0.5);
            assert_apart(&traffic.objects());
        }
    }
}

fn assert_apart(objects: &[TrackedObject]) {
    for (i, a) in objects.iter().enumerate() {
        for b in &objects[i + 1..] {
            assert!(
                !a.shape.overlaps(&b.shape),
                "{} and {} meet",
                a.token,
                b.token
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_queue_behind_a_red_light_never_collides(
        gaps in prop::collection::vec(8.0..25.0f64, 1..6), speed in 0.0..6.0f64, first in 60.0..100.0f64,
    ) {
        let mut x = first;
        let xs: Vec<f64> = gaps.iter().map(|gap| { x -= gap; x }).filter(|&x| x > 3.0).collect();
        prop_assume!(!xs.is_empty());
        let mut traffic = IdmTraffic::new(&crossing(), &vehicles(&xs, speed), &bystander());
        for _ in 0..600 {
            traffic.step(&bystander(), &[], &lights(SignalStatus::Red), STEP_S);
            assert_apart(&traffic.objects());
        }
        let objects = traffic.objects();
        prop_assert_eq!(objects.len(), xs.len());
        prop_assert!(objects.iter().all(|o| o.speed() < 0.3 && front(o) < 120.0));
    }
}
