//! What the forecast keeps, and where it puts it.

use crate::road::{Road, cruise, ego, object, rectangle, straight};
use planagent_score::pdm::{Collided, DrivableLayers, DrivableMap, Forecast};
use planagent_world::geometry::{Point, Pose, Vector};
use planagent_world::{
    EgoState, LaneAreas, LaneId, LaneMap, MapBuilder, Neighbor, ObjectKind, SignalStatus,
    TrackToken, TrackedObject, TrafficLights,
};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;

fn forecast(
    map: &LaneMap,
    ego: &EgoState,
    objects: &[TrackedObject],
    collided: &mut Collided,
) -> Forecast {
    Forecast::new(
        map,
        &BTreeSet::new(),
        ego,
        objects,
        &TrafficLights::default(),
        collided,
    )
}

fn tokens(forecast: &Forecast) -> Vec<u32> {
    forecast.objects().iter().map(|o| o.track.token.0).collect()
}

fn cone(token: u32, x: f64) -> TrackedObject {
    object(
        token,
        ObjectKind::TrafficCone,
        Pose::new(x, 0.0, 0.0),
        (0.4, 0.4),
        0.0,
    )
}

#[test]
fn the_nearest_within_fifty_meters_are_kept_static_ones_first() {
    let map = straight();
    let me = ego(0, 0.0, 0.0, 0.0, 5.0);
    let walker = |token, x| {
        object(
            token,
            ObjectKind::Pedestrian,
            Pose::new(x, 3.0, 0.0),
            (0.6, 0.6),
            1.0,
        )
    };
    let car = |token, x| {
        object(
            token,
            ObjectKind::Vehicle,
            Pose::new(x, 0.0, 0.0),
            (4.0, 2.0),
            5.0,
        )
    };
    let objects = [
        walker(1, 9.0),
        car(2, 20.0),
        cone(3, 50.0),
        cone(4, 50.1),
        cone(5, 10.0),
        car(6, 10.0),
    ];
    assert_eq!(
        tokens(&forecast(&map, &me, &objects, &mut Collided::default())),
        [5, 3, 6, 2, 1]
    );

    let crowd: Vec<TrackedObject> = (0..40)
        .map(|k| walker(100 + k, 45.0 - f64::from(k)))
        .collect();
    let kept = tokens(&forecast(&map, &me, &crowd, &mut Collided::default()));
    assert_eq!(kept.len(), 25);
    assert_eq!((kept[0], kept[24]), (139, 115));
}

#[test]
fn boxes_move_along_their_axis_every_second_step() {
    let map = straight();
    let me = ego(0, 0.0, 0.0, 0.0, 5.0);
    // Sliding sideways counts as driving along the axis; moving mostly backwards as driving back.
    let mut sliding = object(
        1,
        ObjectKind::Vehicle,
        Pose::new(20.0, 0.0, 0.0),
        (4.0, 2.0),
        0.0,
    );
    sliding.velocity = Vector::new(3.0, 4.0);
    let mut backing = sliding;
    backing.token = TrackToken(2);
    backing.velocity = Vector::new(-3.0, 4.0);
    let forecast = forecast(&map, &me, &[sliding, backing], &mut Collided::default());
    let x = |i: usize, step| forecast.objects()[i].shape_at(step).center.x;
    for (step, moved) in [
        (0, 0.0),
        (1, 0.0),
        (2, 1.0),
        (3, 1.0),
        (40, 20.0),
        (81, 40.0),
    ] {
        assert!(
            (x(0, step) - 20.0 - moved).abs() < 1e-9 && (x(1, step) - 20.0 + moved).abs() < 1e-9,
            "{step}"
        );
    }
    assert!((forecast.objects()[0].shape_at(40).center.heading).abs() < 1e-12);
}

#[test]
fn what_is_touched_once_is_ignored_later() {
    let map = straight();
    let mut collided = Collided::default();
    let objects = [cone(1, 2.0), cone(2, 20.0)];
    assert_eq!(
        tokens(&forecast(
            &map,
            &ego(0, 0.0, 0.0, 0.0, 5.0),
            &objects,
            &mut collided
        )),
        [2]
    );
    assert_eq!(collided.tracks, BTreeSet::from([TrackToken(1)]));
    assert_eq!(
        tokens(&forecast(
            &map,
            &ego(1, -20.0, 0.0, 0.0, 5.0),
            &objects,
            &mut collided
        )),
        [2]
    );
}

#[test]
fn red_lights_of_the_route_stand_unless_the_ego_is_wholly_behind_them() {
    let mut road = Road::default();
    let (on, off) = (
        road.connector((20.0, 0.0), (60.0, 0.0)),
        road.connector((20.0, 20.0), (60.0, 20.0)),
    );
    let map = road.build();
    let route = BTreeSet::from([on]);
    let lights: TrafficLights = [(on, SignalStatus::Red), (off, SignalStatus::Red)]
        .into_iter()
        .collect();
    let mut collided = Collided::default();
    let mut reds = |x: f64, lights: &TrafficLights| {
        Forecast::new(
            &map,
            &route,
            &ego(0, x, 0.0, 0.0, 5.0),
            &[],
            lights,
            &mut collided,
        )
        .red_lights()
        .to_vec()
    };
    assert_eq!(reds(0.0, &lights), [on]);
    assert_eq!(reds(20.0, &lights), [on]);
    assert!(reds(0.0, &[(on, SignalStatus::Yellow)].into_iter().collect()).is_empty());
    assert!(reds(40.0, &lights).is_empty());
    assert!(reds(0.0, &lights).is_empty());
}

#[test]
fn areas_tell_lanes_road_and_route_apart() {
    let mut road = Road::default();
    road.lane((-100.0, 0.0), (400.0, 0.0));
    road.lane((-100.0, 4.0), (400.0, 4.0));
    road.parts
        .generic_drivable
        .push(rectangle((-100.0, 400.0), (-4.0, -2.0)));
    let map = road.build();
    let route = BTreeSet::from([LaneId(0)]);
    let state = |y: f64| cruise(1, 0.0, y, 5.0).remove(0);
    let areas = |y: f64, layers| {
        let center = state(y).center().position();
        let at = DrivableMap::around(&map, &route, center, layers).areas_of(&state(y));
        (at.multiple_lanes, at.non_drivable, at.oncoming)
    };
    assert_eq!(areas(0.0, DrivableLayers::Lanes), (false, false, false));
    assert_eq!(areas(1.5, DrivableLayers::Lanes), (true, false, false));
    assert_eq!(areas(4.0, DrivableLayers::Lanes), (false, false, true));
    assert_eq!(areas(-1.0, DrivableLayers::Lanes), (false, true, false));
    assert_eq!(
        areas(-1.0, DrivableLayers::DrivableArea),
        (false, false, false)
    );
    assert_eq!(
        areas(-30.0, DrivableLayers::DrivableArea),
        (false, true, true)
    );
    // The metric's tolerance is 0.3 m; the corners are 0.05 m and 0.35 m outside.
    let judged = |y: f64| {
        let around = DrivableMap::around(
            &map,
            &route,
            state(y).center().position(),
            DrivableLayers::Lanes,
        );
        around
            .judged_as_by_the_metric()
            .areas_of(&state(y))
            .non_drivable
    };
    assert!(areas(-2.9, DrivableLayers::DrivableArea).1);
    assert_eq!([-1.0, -2.9, -3.2].map(judged), [false, false, true]);
}

#[test]
fn a_lane_beside_the_route_is_no_oncoming_lane_where_areas_are_derived() {
    let mut road = Road::default();
    let own = road.lane((-100.0, 0.0), (400.0, 0.0));
    let beside = road.lane((-100.0, 4.0), (400.0, 4.0));
    road.lane((400.0, 8.0), (-100.0, 8.0));
    road.parts.lanes[beside.index()].right.push(Neighbor {
        lane: own,
        from_s: 0.0,
        to_s: 500.0,
    });
    let is_oncoming = |areas: LaneAreas, y: f64| {
        let mut parts = road.parts.clone();
        parts.lane_areas = areas;
        let map = LaneMap::new(parts.with_roadblocks_as_road().with_dense_baselines()).unwrap();
        let state = cruise(1, 0.0, y, 5.0).remove(0);
        let center = state.center().position();
        let route = BTreeSet::from([own]);
        let around = DrivableMap::around(&map, &route, center, DrivableLayers::Lanes);
        let as_by_pdm = around.areas_of(&state).oncoming;
        let judged = around.judged_as_by_the_metric().areas_of(&state).oncoming;
        (as_by_pdm, judged)
    };
    assert_eq!(is_oncoming(LaneAreas::Derived, 0.0), (false, false));
    assert_eq!(is_oncoming(LaneAreas::Derived, 4.0), (true, false));
    assert_eq!(is_oncoming(LaneAreas::Derived, 8.0), (true, true));
    assert_eq!(is_oncoming(LaneAreas::Drawn, 4.0), (true, true));
}

/// A bend to the left of 30 m radius, then a straight on.
fn bend() -> LaneMap {
    const RADIUS: f64 = 30.0;
    let mut map = MapBuilder::default();
    let arc = (0..=60).map(|i| f64::from(i) * FRAC_PI_2 / 60.0);
    let bend = arc.map(|turned| Point::new(RADIUS * turned.sin(), RADIUS * (1.0 - turned.cos())));
    map.lane(bend, 3.5, None).unwrap();
    map.lane(
        [Point::new(RADIUS, RADIUS), Point::new(RADIUS, 130.0)],
        3.5,
        None,
    )
    .unwrap();
    map.connect_touching();
    map.finish().unwrap()
}

#[test]
fn along_lanes_a_vehicle_stays_on_its_lane_and_what_crosses_it_does_not() {
    let map = bend();
    let me = ego(0, -10.0, 0.0, 0.0, 5.0);
    let on_lane = object(
        1,
        ObjectKind::Vehicle,
        Pose::new(0.0, 0.0, 0.0),
        (4.0, 2.0),
        10.0,
    );
    let across = object(
        2,
        ObjectKind::Vehicle,
        Pose::new(6.0, 0.6, 1.0),
        (4.0, 2.0),
        10.0,
    );
    let against = object(
        3,
        ObjectKind::Vehicle,
        Pose::new(6.0, 0.6, 3.34),
        (4.0, 2.0),
        10.0,
    );
    let walker = object(
        4,
        ObjectKind::Pedestrian,
        Pose::new(1.0, 0.0, 0.0),
        (0.6, 0.6),
        1.5,
    );
    let objects = [on_lane, across, against, walker];
    let straight = forecast(&map, &me, &objects, &mut Collided::default());
    let curved = straight.clone().along_lanes(&map);
    let at = |forecast: &Forecast, token: u32, step| {
        let found = forecast
            .objects()
            .iter()
            .find(|object| object.track.token.0 == token);
        found.unwrap().shape_at(step).center
    };
    for step in [10, 20, 30, 40] {
        let place = at(&curved, 1, step);
        let foot = map[LaneId(0)].centerline.project(place.position());
        let beyond = map[LaneId(1)].centerline.project(place.position());
        assert!(
            foot.distance.min(beyond.distance) < 0.4,
            "step {step}: {place:?}"
        );
        let driven = 10.0 * f64::from(u32::try_from(step).unwrap()) * 0.1;
        assert!(
            (place.heading - driven / 30.0).abs() < 0.02,
            "step {step}: {place:?}"
        );
        for token in [2, 3, 4] {
            assert_eq!(at(&curved, token, step), at(&straight, token, step));
        }
    }
    assert!(
        at(&straight, 1, 40).y.abs() < 1e-9,
        "PDM-Closed's forecast keeps the direction"
    );
}
