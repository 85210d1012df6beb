//! Hand-worked cases of what happens over several steps, and of the branches that the record does
//! not reach.

use super::town::{Town, route};
use planagent_agent::planner::{
    PdmClosed, Planner, PlannerError, PlannerInitialization, PlannerInput,
};
use planagent_score::pdm::{
    Collided, DrivableLayers, EgoAreas, Forecast, NoReferencePath, PdmError, PdmMemory,
    ReferencePath, plan, plan_along, time_to_collision,
};
use planagent_world::geometry::{OrientedBox, Point, Polygon, Pose, Vector};
use planagent_world::{
    EgoState, History, LaneAreas, LaneId, LaneKind, LaneMap, Neighbor, ObjectKind, Route,
    SceneView, TrackToken, TrackedObject, TrafficLights,
};
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::sync::Arc;

fn ego(x: f64, speed: f64) -> EgoState {
    EgoState::from_log(
        0,
        Pose::new(x, 0.0, 0.0),
        Vector::new(speed, 0.0),
        Vector::zeros(),
    )
}

fn track(
    token: u32,
    kind: ObjectKind,
    center: Pose,
    (length, width): (f64, f64),
    speed: f64,
) -> TrackedObject {
    let velocity = center.direction() * speed;
    TrackedObject {
        token: TrackToken(token),
        kind,
        shape: OrientedBox::new(center, length, width),
        velocity,
    }
}

/// What is around an ego.
struct Around {
    map: Arc<LaneMap>,
    route: Route,
    lights: TrafficLights,
    history: History,
}

impl Around {
    fn new(map: LaneMap, lanes: &[LaneId]) -> Self {
        let (lights, history) = (TrafficLights::default(), History::default());
        Self {
            map: Arc::new(map),
            route: route(lanes),
            lights,
            history,
        }
    }

    fn scene<'a>(&'a self, ego: &'a EgoState, objects: &'a [TrackedObject]) -> SceneView<'a> {
        let Self {
            map,
            route,
            lights,
            history,
        } = self;
        SceneView {
            map,
            route,
            ego,
            objects,
            lights,
            history,
        }
    }
}

/// A straight road of two lanes, 200 m of 10 m/s and 200 m of 20 m/s.
fn road() -> Around {
    let mut town = Town::default();
    let slow = town.piece(LaneKind::Lane, &[(0.0, 0.0), (200.0, 0.0)], Some(10.0));
    let fast = town.piece(LaneKind::Lane, &[(200.0, 0.0), (400.0, 0.0)], Some(20.0));
    town.link(slow, fast);
    Around::new(town.build(), &[slow, fast])
}

#[test]
fn what_was_touched_once_is_ignored_in_all_later_steps() {
    let around = road();
    let reference_path = ReferencePath::find(&around.map, &around.route, &ego(10.0, 5.0)).unwrap();
    // The front is at 14.049 m: the cone from 13.8 m on touches it.
    let cone = [track(
        7,
        ObjectKind::TrafficCone,
        Pose::new(14.0, 0.0, 0.0),
        (0.4, 0.4),
        0.0,
    )];
    let mut collided = Collided::default();
    plan_along(
        &reference_path,
        &around.scene(&ego(10.0, 5.0), &cone),
        &mut collided,
    )
    .unwrap();
    assert_eq!(collided.tracks, BTreeSet::from([TrackToken(7)]));
    let behind = ego(0.0, 5.0);
    let length_rear = |collided: &mut Collided| {
        plan_along(&reference_path, &around.scene(&behind, &cone), collided)
            .unwrap()
            .proposals[4]
            .leads[2]
            .length_rear
    };
    assert!(
        (length_rear(&mut collided) - 2.588).abs() < 1e-12,
        "a free road"
    );
    assert!(
        length_rear(&mut Collided::default()).abs() < 1e-12,
        "someone who has not touched it stops for it"
    );
}

#[test]
fn the_way_is_kept_while_target_velocities_follow_the_lane() {
    let around = road();
    let mut memory = PdmMemory::default();
    let first = plan(&mut memory, &around.scene(&ego(10.0, 5.0), &[])).unwrap();
    let reference_path = memory.reference_path.clone();
    let later = plan(&mut memory, &around.scene(&ego(250.0, 5.0), &[])).unwrap();
    let targets = |targets: [f64; 5], plan: &planagent_score::pdm::PdmPlan| {
        plan.proposals
            .iter()
            .zip(targets.iter().cycle())
            .all(|(p, t)| (p.target_velocity - t).abs() < 1e-12)
    };
    assert!(
        targets([2.0, 4.0, 6.0, 8.0, 10.0], &first)
            && targets([4.0, 8.0, 12.0, 16.0, 20.0], &later)
    );
    assert_eq!(memory.reference_path, reference_path);
    assert!((later.proposals[0].states[0].progress - 250.0).abs() < 1e-9);
    let lateral: Vec<f64> = later
        .proposals
        .iter()
        .step_by(5)
        .map(|p| p.poses[0].y)
        .collect();
    assert_eq!(lateral, [0.0, -1.0, 1.0]);
}

#[test]
fn the_first_step_has_no_lead_and_odd_steps_keep_theirs() {
    let around = road();
    let reference_path = ReferencePath::find(&around.map, &around.route, &ego(10.0, 5.0)).unwrap();
    let car = [track(
        1,
        ObjectKind::Vehicle,
        Pose::new(40.0, 0.0, 0.0),
        (4.0, 2.0),
        3.0,
    )];
    let plan = plan_along(
        &reference_path,
        &around.scene(&ego(10.0, 5.0), &car),
        &mut Collided::default(),
    )
    .unwrap();
    for proposal in &plan.proposals {
        let [start, first, second, third] = [0, 1, 2, 3].map(|step| proposal.leads[step]);
        assert_eq!((start, first), Default::default());
        // 5 m/s with nothing to read: the gap is held at 1 m, so the first step brakes as hard as
        // it may.
        assert!((proposal.states[1].velocity - 4.7).abs() < 1e-12);
        // At 0.2 s the rear of the car is at 38.6 m; the step before the ego was at 10.5 m and its
        // front at 14.549 m.
        assert!((second.progress - (10.5 + 38.6 - 14.549)).abs() < 1e-9);
        assert!((second.velocity - 3.0).abs() < 1e-12 && second.length_rear.abs() < 1e-12);
        assert_eq!(second, third);
    }
}

#[test]
fn a_policy_on_a_free_road_inherits_the_velocity_that_the_one_before_has_read() {
    // A car cuts across at 45°. At 2.6 s its centre is at 21.2 m: ahead of the slowest policy,
    // behind the fastest.
    let around = road();
    let reference_path = ReferencePath::find(&around.map, &around.route, &ego(10.0, 5.0)).unwrap();
    let diagonal = Pose::new(24.0, 0.0, FRAC_PI_4).translated(-30.0, 0.0);
    let car = [track(1, ObjectKind::Vehicle, diagonal, (4.0, 2.0), 10.0)];
    let plan = plan_along(
        &reference_path,
        &around.scene(&ego(10.0, 5.0), &car),
        &mut Collided::default(),
    )
    .unwrap();
    let (slow, fast) = (plan.proposals[0].leads[26], plan.proposals[4].leads[26]);
    let along = 10.0 * FRAC_PI_4.cos();
    assert!(
        (slow.velocity - along).abs() < 1e-9 && slow.length_rear.abs() < 1e-12,
        "{slow:?}"
    );
    assert!(
        (fast.progress - 400.0).abs() < 1e-9 && (fast.length_rear - 2.588).abs() < 1e-12,
        "a free road: {fast:?}"
    );
    assert!((fast.velocity - along).abs() < 1e-9, "inherited: {fast:?}");
}

#[test]
fn beside_an_ego_in_an_intersection_everyone_is_relevant() {
    // Comes from the left, 60° off the heading, and touches the shifted ego at 0.3 s.
    let car = [track(
        1,
        ObjectKind::Vehicle,
        Pose::new(2.0, 4.0, -FRAC_PI_2),
        (4.6, 1.9),
        3.0,
    )];
    let states: Vec<EgoState> = (0..41).map(|i| ego(0.5 * f64::from(i), 5.0)).collect();
    let first_ttc = |inside: bool| {
        let mut town = Town::default();
        town.lane((-50.0, 0.0), (50.0, 0.0));
        if inside {
            let corners = [(-1.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-1.0, 5.0)];
            let points = corners.map(|(x, y)| Point::new(x, y));
            town.parts.intersections.push(Polygon::new(points).unwrap());
        }
        let map = town.build();
        let (route, lights) = (BTreeSet::from([LaneId(0)]), TrafficLights::default());
        let forecast = Forecast::new(
            &map,
            &route,
            &states[0],
            &car,
            &lights,
            &mut Collided::default(),
        );
        time_to_collision(&map, &states, &[EgoAreas::default(); 41], &forecast).state
    };
    assert_eq!(first_ttc(true), Some(0));
    assert_eq!(
        first_ttc(false),
        None,
        "touched while not relevant, it is ignored from then on"
    );
}

#[test]
fn lanes_tile_the_road_or_leave_gaps() {
    let layers = |gap: f64, areas: LaneAreas| {
        let mut town = Town::default();
        town.parts.lane_areas = areas;
        let right = town.lane((0.0, 0.0), (100.0, 0.0));
        let left = town.lane((0.0, 4.0 + gap), (100.0, 4.0 + gap));
        town.parts.lanes[0].left.push(Neighbor {
            lane: left,
            from_s: 0.0,
            to_s: 100.0,
        });
        town.parts.lanes[1].right.push(Neighbor {
            lane: right,
            from_s: 0.0,
            to_s: 100.0,
        });
        DrivableLayers::from_map(&town.build(), &BTreeSet::from([right]), Point::origin())
    };
    assert_eq!(layers(0.0, LaneAreas::Derived), DrivableLayers::Lanes);
    assert_eq!(
        layers(1.0, LaneAreas::Derived),
        DrivableLayers::DrivableArea
    );
    assert_eq!(
        layers(1.0, LaneAreas::Drawn),
        DrivableLayers::Lanes,
        "what nuPlan draws counts as it is"
    );
    let mut town = Town::default();
    let (a, b) = (
        town.lane((0.0, 0.0), (50.0, 0.0)),
        town.lane((51.0, 0.0), (100.0, 0.0)),
    );
    town.link(a, b);
    assert_eq!(
        DrivableLayers::from_map(&town.build(), &BTreeSet::from([a]), Point::origin()),
        DrivableLayers::DrivableArea
    );
}

#[test]
fn says_when_there_is_no_way() {
    let around = road();
    let nowhere = Around {
        route: Route::default(),
        ..road()
    };
    let start = ego(10.0, 5.0);
    let error = plan(&mut PdmMemory::default(), &nowhere.scene(&start, &[])).unwrap_err();
    assert_eq!(
        error,
        PdmError::NoReferencePath(NoReferencePath::EmptyRoute)
    );
    let mut planner = PdmClosed::new();
    let refused = planner.initialize(&PlannerInitialization {
        map: &nowhere.map,
        route: &nowhere.route,
    });
    assert!(matches!(refused, Err(PlannerError::EmptyRoute)));
    planner
        .initialize(&PlannerInitialization {
            map: &around.map,
            route: &around.route,
        })
        .unwrap();
    assert_eq!(planner.drivable_layers(), None);
    let input = PlannerInput {
        iteration: 0,
        scene: around.scene(&start, &[]),
    };
    let trajectory = planner.compute_trajectory(&input).unwrap();
    assert_eq!((trajectory.start_us(), trajectory.end_us()), (0, 8_000_000));
    assert_eq!(planner.drivable_layers(), Some(DrivableLayers::Lanes));
    assert_eq!(planner.name(), "pdm-closed");
}
