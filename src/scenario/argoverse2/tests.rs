//! What is derived from a synthetic log.

use super::test_log::{CITY, line, log, set, time_ns, with};
use super::*;
use arrow_array::{Float64Array, Int64Array};
use planagent_world::geometry::Point;
use planagent_world::{Lane, LaneId, LaneKind, ObjectKind};

fn lane_of(scenario: &Scenario, source_id: i64) -> &Lane {
    &scenario.map[scenario.map.lane_by_source(source_id).unwrap()]
}

#[test]
fn the_crossing_becomes_nuplans_layers() {
    let scenario = log(131).opened().unwrap();
    let map = &scenario.map;
    assert_eq!(map.name(), "argoverse 2 PIT, origin (1005, -500)");
    let ids = |lanes: &[LaneId]| {
        lanes
            .iter()
            .map(|&lane| map[lane].source_id)
            .collect::<Vec<_>>()
    };
    let of_kind = |kind| {
        map.lanes()
            .iter()
            .filter(|lane| lane.kind == kind)
            .map(|l| l.source_id)
            .collect::<Vec<_>>()
    };
    assert_eq!(of_kind(LaneKind::Connector), vec![11, 12, 13, 41]);
    assert_eq!(
        of_kind(LaneKind::Lane),
        vec![1, 2, 3, 21, 22, 23, 31, 51],
        "the bike lane is none"
    );
    // Neighbors have the same direction.
    let (first, second) = (lane_of(&scenario, 1), lane_of(&scenario, 2));
    assert!(first.left.is_empty() && second.right.is_empty());
    assert_eq!(
        (first.right_at(30.0), second.left_at(30.0)),
        (Some(second.id), Some(first.id))
    );
    assert_eq!(ids(&map[first.roadblock].lanes), vec![1, 2]);
    assert_eq!(ids(&lane_of(&scenario, 13).incoming), vec![2]);
    assert!(lane_of(&scenario, 3).outgoing.is_empty());
    assert_eq!(map.intersections().len(), 1);
    assert!(
        map.in_intersection(Point::new(67.0, 3.0)) && !map.in_intersection(Point::new(30.0, 0.0))
    );
    assert!(map.on_crosswalk(Point::new(51.0, 0.0)));
    assert!(map.is_drivable(Point::new(20.0, -5.9)) && !map.is_drivable(Point::new(20.0, -6.1)));
    assert!(
        map.lanes()
            .iter()
            .all(|lane| lane.speed_limit.is_none() && !lane.has_traffic_lights)
    );
}

#[test]
fn centerlines_run_in_the_middle_with_a_vertex_every_half_meter() {
    let scenario = log(30).opened().unwrap();
    let straight = &lane_of(&scenario, 2).centerline;
    assert_eq!(straight.vertices().len(), 121);
    assert!(straight.vertices().iter().all(|v| v.y.abs() < 1e-9));
    assert!((straight.length() - 60.0).abs() < 1e-9);
    assert!((lane_of(&scenario, 2).polygon.area() - 210.0).abs() < 1e-6);
}

#[test]
fn a_cul_de_sac_turns_around_a_point() {
    let mut log = log(30);
    let point = (30.0, 0.0);
    log.map["lane_segments"]["2"]["left_lane_boundary"] = line(&[point, point]);
    let scenario = log.opened().unwrap();
    let centerline = &lane_of(&scenario, 2).centerline;
    // Halfway between the point and the right boundary.
    assert!((centerline.start() - Point::new(10.0, -0.875)).norm() < 1e-9);
    assert!((centerline.length() - 30.0).abs() < 1e-9);
}

#[test]
fn ego_objects_route_and_window_are_as_recorded() {
    let scenario = log(131).opened().unwrap();
    assert_eq!(
        (scenario.id.as_str(), scenario.log_name.as_str()),
        ("synthetic", "synthetic")
    );
    assert_eq!((scenario.start, scenario.iterations()), (20, 111));
    assert_eq!(scenario.frames[20].ego.time_us, 2_000_000);
    let ego = &scenario.frames[40].ego;
    assert!((ego.rear_axle.x - 32.0).abs() < 1e-9 && ego.rear_axle.y.abs() < 1e-9);
    assert!((ego.speed() - 8.0).abs() < 1e-6 && ego.acceleration.norm() < 1e-6);
    let route: Vec<i64> = scenario
        .route
        .roadblocks
        .iter()
        .map(|&b| scenario.map[b].source_id)
        .collect();
    assert_eq!(route, vec![1, 11, 21]);
    assert_eq!(
        scenario.route.goal,
        Some(scenario.frames[130].ego.rear_axle)
    );
    assert_eq!(scenario.frames[2].objects.len(), 3);
    let [car, person] = &scenario.frames[40].objects[..] else {
        panic!("{:?}", scenario.frames[40].objects)
    };
    assert_eq!(
        (car.kind, person.kind),
        (ObjectKind::Vehicle, ObjectKind::Pedestrian)
    );
    assert!((car.shape.center.x - 52.0).abs() < 1e-9 && (car.velocity.x - 8.0).abs() < 1e-6);
    assert!((person.shape.center.x - 25.0).abs() < 1e-9 && person.speed() < 1e-6);
    assert_eq!(car.token, scenario.frames[2].objects[0].token);
    let (_guard, folder) = log(131).written();
    let contents = contents(&folder).unwrap();
    assert_eq!(
        (
            contents.steps,
            contents.iterations,
            contents.tracks,
            contents.lanes
        ),
        (131, 111, 4, 12),
        "the bike lane is none"
    );
}

#[test]
fn a_turned_ego_turns_its_boxes() {
    let mut log = log(30);
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    set(&mut log.poses, "qw", Float64Array::from(vec![quarter; 30]));
    set(&mut log.poses, "qz", Float64Array::from(vec![quarter; 30]));
    let scenario = log.opened().unwrap();
    let frame = &scenario.frames[0];
    assert!((frame.ego.rear_axle.heading - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    // 8 m/s to the east are to its right.
    assert!((frame.ego.velocity.y + 8.0).abs() < 1e-6);
    let car = frame
        .objects
        .iter()
        .find(|object| object.kind == ObjectKind::Vehicle)
        .unwrap();
    assert!(
        (car.shape.center.position() - Point::new(0.0, 20.0)).norm() < 1e-9,
        "{car:?}"
    );
    assert!((car.shape.center.heading - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
}

#[test]
fn a_pose_that_is_missing_at_a_sweep_lies_between_its_neighbors() {
    let mut log = log(30);
    // The pose of sweep 7 is 5 ms early, 0.04 m behind. From there to sweep 8 it is 0.84 m in 105
    // ms.
    let early = |step: usize| if step == 7 { 5_000_000 } else { 0 };
    set(
        &mut log.poses,
        "timestamp_ns",
        (0..30)
            .map(|step| Some(time_ns(step) - early(step)))
            .collect::<Int64Array>(),
    );
    let behind = with(&log.poses, "tx_m", 7, Some(CITY.0 + 5.0 + 5.6 - 0.04));
    set(&mut log.poses, "tx_m", behind);
    assert!((log.opened().unwrap().frames[7].ego.rear_axle.x - 5.6).abs() < 1e-9);
}
