//! PDM-Closed beside the record of `tuplan_garage`'s own run: 9 cases, every proposal, every term,
//! what is driven.

use super::town::Town;
use planagent_agent::planner::{PdmClosed, Planner, PlannerInitialization, PlannerInput};
use planagent_score::pdm::{
    Collided, DrivableLayers, PdmPlan, ReferencePath, braking_speed, plan_along,
};
use planagent_world::geometry::{OrientedBox, Point, Polygon, Polyline, Pose, Vector};
use planagent_world::{
    EgoState, History, LaneId, LaneKind, LaneMap, ObjectKind, RoadblockId, Route, SceneView,
    SignalStatus, TrackToken, TrackedObject, TrafficLights, Trajectory,
};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

/// Progress, velocity and leads: rounding apart, these are upstream's.
const IDM_TOLERANCE: f64 = 1e-9;
/// Simulated states and what is driven: upstream's pseudo-inverse is no better.
const STATE_TOLERANCE: f64 = 1e-6;

/// A file of `tests/fixtures/vectors`.
fn vectors(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/vectors")
        .join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The cases. States of the ego, proposals and simulated states have a file of their own, and
/// shapes that cases share are stored once, under names.
fn cases() -> Vec<Value> {
    let (mut record, proposals) = (vectors("pdm_closed.json"), vectors("pdm_proposals.json"));
    let shapes = record["shapes"].take();
    let shape = |value: &Value| {
        value
            .as_str()
            .map_or_else(|| value.clone(), |name| shapes[name].clone())
    };
    let mut cases: Vec<Value> = record["cases"].as_array().unwrap().clone();
    for (case, proposals) in cases.iter_mut().zip(proposals["cases"].as_array().unwrap()) {
        assert_eq!(case["name"], proposals["name"]);
        case["centerline"] = shape(&case["centerline"]);
        for ring in case["lanes"].as_object_mut().unwrap().values_mut() {
            *ring = shape(ring);
        }
        for key in ["ego", "proposals_se2", "simulated", "simulated_every"] {
            case[key] = proposals[key].clone();
        }
    }
    cases
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap()
}

fn rows<const N: usize>(value: &Value) -> Vec<[f64; N]> {
    let rows = value.as_array().unwrap().iter();
    rows.map(|row| std::array::from_fn(|i| row[i].as_f64().unwrap()))
        .collect()
}

/// One recorded case as a scene.
struct Case {
    name: String,
    map: Arc<LaneMap>,
    route: Route,
    centerline: Vec<Pose>,
    ego: EgoState,
    objects: Vec<TrackedObject>,
    lights: TrafficLights,
    history: History,
}

impl Case {
    fn read(case: &Value) -> Self {
        let centerline: Vec<Pose> = rows(&case["centerline"])
            .into_iter()
            .map(|[x, y, h]| Pose::new(x, y, h))
            .collect();
        let line = Polyline::new(centerline.iter().map(Pose::position)).unwrap();
        let mut town = Town::default();
        let mut numbers = Vec::new();
        for (name, ring) in case["lanes"].as_object().unwrap() {
            let polygon =
                Polygon::new(rows(ring).into_iter().map(|[x, y]| Point::new(x, y))).unwrap();
            let red = name.parse::<u32>().is_ok();
            let kind = if red {
                LaneKind::Connector
            } else {
                LaneKind::Lane
            };
            numbers.push((
                name.as_str(),
                town.shaped(kind, line.clone(), polygon, case["speed_limit"].as_f64()),
            ));
        }
        let on_route = case["on_route"]
            .as_array()
            .unwrap()
            .iter()
            .map(|name| name.as_str().unwrap());
        let block = |name| {
            RoadblockId(
                numbers
                    .iter()
                    .find(|(known, _)| *known == name)
                    .unwrap()
                    .1
                    .0,
            )
        };
        let route = Route {
            roadblocks: on_route.map(block).collect(),
            goal: None,
            goal_lane: None,
        };
        let map = town.build();
        let red = map
            .lanes()
            .iter()
            .filter(|lane| lane.is_connector())
            .map(|lane| (lane.id, SignalStatus::Red));
        let ego = &case["ego"];
        let pose = Pose::new(number(ego, "x"), number(ego, "y"), number(ego, "heading"));
        Self {
            name: case["name"].as_str().unwrap().to_owned(),
            lights: red.collect(),
            map: Arc::new(map),
            route,
            centerline,
            ego: EgoState::from_log(
                0,
                pose,
                Vector::new(number(ego, "vx"), 0.0),
                Vector::new(number(ego, "ax"), 0.0),
            ),
            objects: case["objects"]
                .as_array()
                .unwrap()
                .iter()
                .enumerate()
                .map(object)
                .collect(),
            history: History::default(),
        }
    }

    fn scene(&self) -> SceneView<'_> {
        SceneView {
            map: &self.map,
            route: &self.route,
            ego: &self.ego,
            objects: &self.objects,
            lights: &self.lights,
            history: &self.history,
        }
    }

    /// Planned along the recorded centreline.
    fn plan(&self) -> PdmPlan {
        let reference_path = ReferencePath::along(
            &self.map,
            &self.route.roadblocks,
            &self.centerline,
            &self.ego,
        )
        .unwrap();
        assert_eq!(
            reference_path.layers(),
            DrivableLayers::Lanes,
            "{}",
            self.name
        );
        plan_along(&reference_path, &self.scene(), &mut Collided::default()).unwrap()
    }
}

fn object((index, o): (usize, &Value)) -> TrackedObject {
    TrackedObject {
        token: TrackToken(index as u32),
        kind: match o["type"].as_str().unwrap() {
            "VEHICLE" => ObjectKind::Vehicle,
            "PEDESTRIAN" => ObjectKind::Pedestrian,
            "TRAFFIC_CONE" => ObjectKind::TrafficCone,
            other => panic!("unexpected object {other}"),
        },
        shape: OrientedBox::new(
            Pose::new(number(o, "x"), number(o, "y"), number(o, "heading")),
            number(o, "length"),
            number(o, "width"),
        ),
        velocity: Vector::new(number(o, "vx"), number(o, "vy")),
    }
}

fn deviation(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

fn columns(ego: &EgoState) -> [f64; 11] {
    let (p, v, a) = (ego.rear_axle, ego.velocity, ego.acceleration);
    let turning = [
        ego.steering_angle,
        ego.steering_rate,
        ego.angular_velocity,
        ego.angular_acceleration,
    ];
    [
        p.x, p.y, p.heading, v.x, v.y, a.x, a.y, turning[0], turning[1], turning[2], turning[3],
    ]
}

fn with_each(check: impl Fn(&Value, &Case)) {
    let cases = cases();
    assert_eq!(cases.len(), 9);
    for case in &cases {
        check(case, &Case::read(case));
    }
}

/// Whether a number is the recorded one.
fn same(found: f64, expected: &Value, tolerance: f64) -> bool {
    (found - expected.as_f64().unwrap()).abs() <= tolerance
}

#[test]
fn proposals_follow_the_recorded_roll_outs() {
    with_each(|record, case| {
        let plan = case.plan();
        assert_eq!(plan.proposals.len(), 15);
        for (i, proposal) in plan.proposals.iter().enumerate() {
            let states: Vec<[f64; 2]> = rows(&record["idm_progress_velocity"][i]);
            let leads: Vec<[f64; 3]> = rows(&record["leading_agent"][i]);
            let poses: Vec<[f64; 3]> = rows(&record["proposals_se2"][i]);
            assert_eq!((states.len(), leads.len(), poses.len()), (41, 41, 41));
            for step in 0..41 {
                let (at, lead, pose) = (
                    proposal.states[step],
                    proposal.leads[step],
                    proposal.poses[step],
                );
                let off = [
                    deviation(&[at.progress, at.velocity], &states[step]),
                    deviation(
                        &[lead.progress, lead.velocity, lead.length_rear],
                        &leads[step],
                    ),
                    deviation(&[pose.x, pose.y, pose.heading], &poses[step]),
                ];
                assert!(
                    off.iter().all(|&off| off < IDM_TOLERANCE),
                    "{} {i} step {step}: {off:?}",
                    case.name
                );
            }
        }
    });
}

#[test]
fn simulated_states_are_the_recorded_ones() {
    with_each(|record, case| {
        let plan = case.plan();
        let every = record["simulated_every"].as_u64().unwrap() as usize;
        for (i, states) in plan.simulated.iter().enumerate() {
            let expected: Vec<[f64; 11]> = rows(&record["simulated"][i]);
            assert_eq!((states.len(), expected.len()), (41, 9));
            for (state, expected) in states.iter().step_by(every).zip(&expected) {
                let off = deviation(&columns(state), expected);
                assert!(off < STATE_TOLERANCE, "{} {i}: off by {off}", case.name);
            }
        }
    });
}

#[test]
fn every_term_of_every_score_is_the_recorded_one() {
    with_each(|record, case| {
        let plan = case.plan();
        for (i, score) in plan.scores.iter().enumerate() {
            let terms = [
                (
                    "no_collision",
                    &record["multi"]["no_collision"],
                    score.no_at_fault_collisions,
                    0.0,
                ),
                (
                    "drivable",
                    &record["multi"]["drivable"],
                    score.drivable_area,
                    0.0,
                ),
                (
                    "direction",
                    &record["multi"]["direction"],
                    score.driving_direction,
                    0.0,
                ),
                (
                    "ttc",
                    &record["weighted"]["ttc"],
                    score.time_to_collision,
                    0.0,
                ),
                (
                    "comfort",
                    &record["weighted"]["comfort"],
                    score.comfort,
                    0.0,
                ),
                (
                    "progress",
                    &record["weighted"]["progress"],
                    score.progress,
                    1e-6,
                ),
                (
                    "progress_raw",
                    &record["progress_raw"],
                    score.progress_m,
                    1e-5,
                ),
                ("scores", &record["scores"], score.total, 1e-6),
            ];
            for (term, expected, found, tolerance) in terms {
                assert!(
                    same(found, &expected[i], tolerance),
                    "{} {i} {term}: {found} {}",
                    case.name,
                    expected[i]
                );
            }
            let times = [
                ("collision_time_idx", score.first_at_fault_s),
                ("ttc_time_idx", score.first_ttc_s),
            ];
            for (term, found) in times {
                let expected = record[term][i].as_f64().map(|steps| steps * 0.1);
                assert_eq!(
                    found.is_some(),
                    expected.is_some(),
                    "{} {i} {term}",
                    case.name
                );
                assert!(
                    (found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-9,
                    "{} {i} {term}",
                    case.name
                );
            }
        }
        assert_eq!(
            plan.best as u64,
            record["best"].as_u64().unwrap(),
            "{}",
            case.name
        );
    });
}

/// How far a trajectory is from the recorded one, meters and radians.
fn off_the_record(trajectory: &Trajectory, record: &Value) -> f64 {
    let expected: Vec<[f64; 5]> = rows(&record["trajectory"]);
    assert_eq!((trajectory.states().len(), expected.len()), (81, 17));
    let off = expected.iter().map(|&[time_us, x, y, heading, _]| {
        let pose = trajectory.at(time_us as i64).unwrap().rear_axle;
        deviation(&[pose.x, pose.y, pose.heading], &[x, y, heading])
    });
    off.fold(0.0, f64::max)
}

#[test]
fn what_is_driven_is_the_recorded_trajectory() {
    with_each(|record, case| {
        let plan = case.plan();
        assert_eq!(
            plan.emergency_brake,
            record["emergency_brake"].as_bool().unwrap(),
            "{}",
            case.name
        );
        let off = off_the_record(&plan.trajectory, record);
        assert!(off < STATE_TOLERANCE, "{}: off by {off}", case.name);
        if plan.emergency_brake {
            assert!((braking_speed(&case.ego) - 0.495).abs() < 1e-12);
        }
    });
}

#[test]
fn the_planner_finds_the_recorded_centreline_by_itself() {
    with_each(|record, case| {
        // In the curve the recorded headings are those of the circle, not of the chords that a map
        // gives.
        if case.name == "curve_offset" {
            return;
        }
        let mut planner = PdmClosed::new();
        planner
            .initialize(&PlannerInitialization {
                map: &case.map,
                route: &case.route,
            })
            .unwrap();
        let trajectory = planner
            .compute_trajectory(&PlannerInput {
                iteration: 0,
                scene: case.scene(),
            })
            .unwrap();
        let off = off_the_record(&trajectory, record);
        assert!(off < STATE_TOLERANCE, "{}: off by {off}", case.name);
        let reference_path = ReferencePath::find(&case.map, &case.route, &case.ego).unwrap();
        assert_eq!(reference_path.lanes().first(), Some(&LaneId(0)));
        let last = case.centerline[case.centerline.len() - 1];
        assert!((reference_path.centerline().length() - 329.5).abs() < 1e-9);
        assert!(reference_path.centerline().pose_at(329.5).distance(&last) < 1e-9);
    });
}
