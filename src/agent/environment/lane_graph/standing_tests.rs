//! What stands on the ego's lane, and the way past it.

use super::standing::swing;
use super::tests::graph;
use super::*;
use crate::environment::sketch::{self, Drawn};
use planagent_world::ObjectKind::{TrafficCone, Vehicle};
use planagent_world::geometry::{Point, Polyline, Vector};
use planagent_world::{EgoState, ObjectKind, PACIFICA, Scene};

/// The lane graph of a road with one lane a direction, with the oncoming lane to overtake on.
fn with_oncoming(drawn: &Drawn) -> LaneGraph {
    graph(drawn).with_oncoming_lane(&drawn.scene())
}

#[test]
fn the_oncoming_lane_is_named_only_where_it_leads_past_what_stands_for_good() {
    use ObjectKind::{Pedestrian, TrafficCone, Vehicle};
    let road = || sketch::straight(1, 1, 0, 8.0);
    let is_named = |drawn: Drawn| {
        with_oncoming(&drawn)
            .centerline(CenterlineName::OncomingLane)
            .is_some()
    };
    assert!(!is_named(road()), "nothing stands there");
    assert!(is_named(road().put(Vehicle, 25.0, 0.0, 0.0, 0.0)));
    assert!(is_named(road().put(TrafficCone, 25.0, 0.0, 0.0, 0.0)));
    assert!(
        !is_named(road().put(Vehicle, 25.0, 0.0, 0.0, 3.0)),
        "it moves"
    );
    assert!(
        !is_named(road().put(Pedestrian, 25.0, 0.0, 0.0, 0.0)),
        "nobody passes people so"
    );
    assert!(
        !is_named(
            road()
                .put(Vehicle, 25.0, 0.0, 0.0, 0.0)
                .put(Vehicle, 32.0, 0.0, 0.0, 0.0)
        ),
        "a queue"
    );
    assert!(
        !is_named(road().put(Vehicle, 25.0, -2.6, 0.0, 0.0)),
        "the ego fits past it"
    );
    let car = |drawn: Drawn| drawn.put(Vehicle, 25.0, 0.0, 0.0, 0.0);
    assert!(
        !is_named(car(sketch::straight(1, 0, 0, 8.0))),
        "no lane is beside it"
    );
    assert!(
        !is_named(car(sketch::straight(2, 1, 1, 8.0))),
        "the lane beside has the ego's direction"
    );
    assert_eq!(
        graph(&car(road())).centerline(CenterlineName::OncomingLane),
        None,
        "it was not asked for"
    );
}

#[test]
fn what_stands_as_in_a_queue_blocks_the_lane_and_is_not_passed_against_traffic() {
    use ObjectKind::Vehicle;
    let pair = |turn: f64| {
        sketch::straight(1, 1, 0, 8.0)
            .put(Vehicle, 25.0, 0.0, turn, 0.0)
            .put(Vehicle, 32.0, 0.0, turn, 0.0)
    };
    let (queue, crash) = (with_oncoming(&pair(0.0)), with_oncoming(&pair(0.6)));
    let may_queue = |graph: &LaneGraph| graph.blocked.map(|blocked| blocked.may_queue);
    assert_eq!(
        (may_queue(&queue), may_queue(&crash)),
        (Some(true), Some(false))
    );
    assert!(queue.oncoming.is_none() && crash.oncoming.is_some());
    let behind_traffic = pair(0.0).put(Vehicle, 40.0, 0.0, 0.0, 3.0);
    assert_eq!(
        with_oncoming(&behind_traffic).blocked,
        None,
        "the first waits for one that moves"
    );
    let crashed = pair(0.6).put(Vehicle, 40.0, 0.0, 0.0, 3.0);
    assert!(
        graph(&crashed).blocked.is_some(),
        "who stands askew waits for nobody"
    );
}

#[test]
fn a_crashed_car_before_an_intersection_blocks_the_lane_and_a_waiting_one_does_not() {
    let blocked = |turn: f64| {
        let (crossing, _) = sketch::crossing(2, 1, 40.0, 8.0);
        graph(&crossing.put(Vehicle, 32.0, 0.0, turn, 0.0)).blocked
    };
    assert_eq!(blocked(0.0), None);
    assert!(blocked(0.5).is_some());
}

#[test]
fn the_path_over_the_oncoming_lane_leads_past_and_back() {
    let drawn = sketch::straight(1, 1, 0, 8.0).put(ObjectKind::Vehicle, 25.0, 0.0, 0.0, 0.0);
    let graph = with_oncoming(&drawn);
    let oncoming = graph.oncoming.as_ref().unwrap();
    let line = &oncoming.centerline.path.centerline;
    let left = |x: f64| line.project(Point::new(x, 0.0)).point.y;
    assert!(
        left(0.0).abs() < 0.1 && left(60.0).abs() < 0.1,
        "{} {}",
        left(0.0),
        left(60.0)
    );
    // Beside the car, half the ego and half the car and a distance apart.
    let beside = line
        .vertices()
        .iter()
        .filter(|p| (22.0..28.0).contains(&p.x))
        .map(|p| p.y);
    assert!(
        beside.into_iter().all(|y| y > 2.4 && y < 3.5),
        "{:?}",
        line.vertices()
    );
    assert!((oncoming.border - 1.8).abs() < 0.11 && oncoming.traffic.length() > 60.0);
    assert_eq!(
        graph.centerlines.len(),
        1,
        "it is no lane of the ego's direction"
    );
}

#[test]
fn an_ego_on_the_oncoming_lane_belongs_to_the_lane_that_it_left() {
    let mut drawn = sketch::straight(1, 1, 0, 8.0).put(ObjectKind::Vehicle, 5.0, 0.0, 0.0, 0.0);
    let (own, route) = (
        graph(&drawn).nodes[0].lane,
        graph(&drawn).ego_lane().path.lanes.clone(),
    );
    drawn = drawn.route_through(&route);
    drawn.ego = EgoState::from_log(
        0,
        drawn.ego.rear_axle.translated(0.0, 3.2),
        drawn.ego.velocity,
        Vector::zeros(),
    );
    let graph = with_oncoming(&drawn);
    assert_eq!(graph.nodes[0].lane, own);
    assert!(
        graph.oncoming.is_some(),
        "the ego is still beside what it passes"
    );
    let followed = drawn.put(ObjectKind::Vehicle, -12.0, -3.2, 0.0, 5.0);
    assert!(
        with_oncoming(&followed).oncoming.is_some(),
        "who follows in the lane that it left does not block it"
    );
}

#[test]
fn a_taper_belongs_to_the_stretch_that_it_blocks() {
    let blocked = |cones: &[(f64, f64)]| {
        let put =
            |road: Drawn, &(ahead, left): &(f64, f64)| road.put(TrafficCone, ahead, left, 0.0, 0.0);
        graph(&cones.iter().fold(sketch::straight(1, 1, 0, 5.0), put))
            .blocked
            .map(|blocked| blocked.from_s)
    };
    let (far, near, closing) = ((20.0, -1.1), (30.0, -1.1), (36.0, 0.0));
    assert_eq!(blocked(&[near]), None, "there is room beside it");
    let alone = blocked(&[closing]).unwrap();
    assert!(
        (alone - blocked(&[near, closing]).unwrap() - 6.0).abs() < 1e-9,
        "the ego stops before the taper"
    );
    assert!(
        (alone - blocked(&[far, closing]).unwrap()).abs() < 1e-9,
        "the ego can stop behind it"
    );
}

#[test]
fn what_the_ego_has_passed_blocks_its_lane_no_more() {
    // The ego's rear bumper is past a car that broke down by a gap, and the ego that far aside.
    let is_blocked = |gap: f64, aside: f64| {
        let front_of_car = 25.0 + Vehicle.default_size().0 / 2.0;
        let scene = Scene::builder()
            .lane([[-100.0, 0.0], [300.0, 0.0]])
            .lane([[300.0, 3.5], [-100.0, 3.5]])
            .ego(
                [front_of_car + gap + PACIFICA.length() / 2.0, aside],
                0.0,
                8.0,
            )
            .vehicle([25.0, 0.0], 0.0, 0.0)
            .route([0])
            .build()
            .unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        graph.blocked.is_some()
    };
    assert!(is_blocked(-0.5, 2.9), "beside it");
    assert!(is_blocked(0.5, 2.9), "too near to come back");
    assert!(!is_blocked(1.5, 2.9), "there is room to come back");
    assert!(!is_blocked(15.0, 2.9), "far behind");
    assert!(!is_blocked(0.5, 0.0), "back in its lane");
}

#[test]
fn what_leaves_more_room_than_a_plan_can_use_blocks_the_lane() {
    // A lane of 6 m: 3 m to each side of its middle.
    let is_blocked = |y: f64| {
        let scene = Scene::builder()
            .lane_width(6.0)
            .lane([[-50.0, 0.0], [150.0, 0.0]])
            .ego([0.0, 0.0], 0.0, 8.0)
            .vehicle([30.0, y], 0.0, 0.0)
            .build()
            .unwrap();
        let graph = LaneGraph::build(&scene.view(), DEFAULT_NODE_LENGTH).unwrap();
        graph.blocked.is_some()
    };
    assert!(is_blocked(-0.5) && is_blocked(0.5));
    assert!(!is_blocked(-1.8) && !is_blocked(1.8));
}

#[test]
fn the_front_corner_swings_out_on_the_outer_side_of_a_bend() {
    let arc = |side: f64| {
        let points = (0..=60).map(|i| {
            let angle = f64::from(i) * 0.02;
            Point::new(12.0 * angle.sin(), side * 12.0 * (1.0 - angle.cos()))
        });
        Polyline::new(points).unwrap()
    };
    let side = 12.0 + PACIFICA.width / 2.0;
    let expected = side.hypot(PACIFICA.front_length) - side;
    for (left_bend, line) in [(true, arc(1.0)), (false, arc(-1.0))] {
        let found = swing(&line, (6.0, 8.0), !left_bend);
        assert!((found - expected).abs() < 0.02, "{found} {expected}");
        assert!(swing(&line, (6.0, 8.0), left_bend) <= 0.0);
    }
    let straight = Polyline::new([[0.0, 0.0], [50.0, 0.0]].map(|[x, y]| Point::new(x, y))).unwrap();
    assert!(swing(&straight, (20.0, 25.0), true) <= 0.0);
}
