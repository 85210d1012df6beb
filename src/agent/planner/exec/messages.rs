//! The messages between the program and a planner command: one JSON object a line.
//! `docs/schema/exec_*.schema.json` has their schema.

use super::agents::{ExecAgent, ExecAgentsStep};
use crate::planner::{PlannerInitialization, PlannerInput, check_plan};
use planagent_world::geometry::{OrientedBox, Point, Polygon, Pose, Vector};
use planagent_world::{
    EgoState, HistorySample, Lane, LaneMap, MICROS_PER_SECOND, PACIFICA, STEP_S, TrackedObject,
    TrafficLights, Trajectory, TrajectoryState,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Version of the messages.
const VERSION: u32 = 1;
/// Longest time that a state of a trajectory may be away from now, seconds.
const MAX_TIME_S: f64 = 600.0;
/// Latest begin of a plan from now, seconds: some planners' states are a second apart.
const MAX_START_S: f64 = 3.0;
/// Fewest states of a trajectory.
const MIN_STATES: usize = 2;

/// What the program writes to the command's stdin. Positions are in meters in the map frame (x
/// east, y north), headings in radians counter-clockwise, speeds in m/s.
#[derive(Debug, Clone, Serialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ExecRequest {
    /// The first message of a simulation; the reply is `ready`.
    Initialize(Box<ExecInitialization>),
    /// An iteration; the reply is `trajectory`.
    Step(Box<ExecStep>),
    /// An iteration of a command that controls the other agents; the reply is `agents`.
    Agents(Box<ExecAgentsStep>),
}

/// The first message of a simulation.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecInitialization {
    /// Version of the messages.
    pub version: u32,
    /// Time between two iterations, seconds.
    pub step_s: f64,
    /// The ego vehicle.
    pub vehicle: ExecVehicle,
    /// The map around the scenario.
    pub map: ExecMap,
    /// The route of the ego.
    pub route: ExecRoute,
}

/// Dimensions of the ego vehicle, meters.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecVehicle {
    /// Width over all.
    pub width: f64,
    /// Rear axle to front bumper.
    pub front_length: f64,
    /// Rear axle to rear bumper.
    pub rear_length: f64,
    /// Distance between the axles.
    pub wheel_base: f64,
}

/// The map.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecMap {
    /// Lanes and lane connectors.
    pub lanes: Vec<ExecLane>,
    /// Stop lines.
    pub stop_lines: Vec<ExecStopLine>,
    /// Areas of intersections, each a ring of points; the first is not repeated.
    pub intersections: Vec<Vec<[f64; 2]>>,
    /// Crosswalks.
    pub crosswalks: Vec<Vec<[f64; 2]>>,
    /// Drivable area: road segments, further drivable areas and car parks.
    pub drivable: Vec<Vec<[f64; 2]>>,
}

/// A lane or a lane connector.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecLane {
    /// Its id in these messages.
    pub id: u32,
    /// Whether it is a connector, in an intersection.
    pub connector: bool,
    /// The centerline in driving direction.
    pub centerline: Vec<[f64; 2]>,
    /// The area.
    pub polygon: Vec<[f64; 2]>,
    /// Lanes that lead into it.
    pub incoming: Vec<u32>,
    /// Lanes that it leads to.
    pub outgoing: Vec<u32>,
    /// Lanes of the same direction to the left.
    pub left: Vec<u32>,
    /// Lanes of the same direction to the right.
    pub right: Vec<u32>,
    /// The roadblock that holds it.
    pub roadblock: u32,
    /// Speed limit, m/s; null where the map has none.
    pub speed_limit: Option<f64>,
}

/// A stop line.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecStopLine {
    /// Its area, a thin polygon across the lane.
    pub polygon: Vec<[f64; 2]>,
    /// The lanes that must stop there.
    pub lanes: Vec<u32>,
    /// Whether it belongs to a stop sign; else to a traffic light.
    pub stop_sign: bool,
}

/// The route.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecRoute {
    /// The chain of roadblocks, from the start on.
    pub roadblocks: Vec<u32>,
    /// All lanes of these roadblocks.
    pub lanes: Vec<u32>,
    /// nuPlan's mission goal (x, y, heading); null where it is not known.
    pub goal: Option<[f64; 3]>,
    /// The lane that holds the goal, where the score asks for it: in a modified scenario with a
    /// goal; else null.
    pub goal_lane: Option<u32>,
}

/// An iteration.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecStep {
    /// The iteration, from 0.
    pub iteration: usize,
    /// The ego now.
    pub ego: ExecEgo,
    /// Objects now.
    pub objects: Vec<ExecObject>,
    /// Traffic lights now, by lane connector.
    pub lights: Vec<ExecLight>,
    /// The two seconds before iteration 0, oldest first; only in the first step.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub history: Vec<ExecSample>,
}

/// The ego and the objects before iteration 0.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecSample {
    /// The ego.
    pub ego: ExecEgo,
    /// The objects.
    pub objects: Vec<ExecObject>,
}

/// The ego: its rear axle.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecEgo {
    /// Time, µs.
    pub time_us: i64,
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
    /// Heading.
    pub heading: f64,
    /// Velocity forward and to the left, m/s.
    pub velocity: [f64; 2],
    /// Acceleration forward and to the left, m/s².
    pub acceleration: [f64; 2],
    /// Angle of the front wheels, radians.
    pub steering_angle: f64,
    /// Yaw rate, rad/s.
    pub angular_velocity: f64,
}

/// An object: the center of its box.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecObject {
    /// Its track, the same in all steps.
    pub track: u32,
    /// nuPlan's type: vehicle, pedestrian, bicycle, `traffic_cone`, barrier, `czone_sign` or
    /// `generic_object`.
    pub kind: String,
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
    /// Heading.
    pub heading: f64,
    /// Length of the box.
    pub length: f64,
    /// Width of the box.
    pub width: f64,
    /// Velocity in the map frame, m/s.
    pub velocity: [f64; 2],
}

/// A traffic light.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ExecLight {
    /// The lane connector that it governs.
    pub lane: u32,
    /// green, yellow, red or unknown.
    pub status: String,
}

/// What the command writes to its stdout.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ExecReply {
    /// The command is ready for the first step.
    Ready {},
    /// The trajectory to follow from now on.
    Trajectory {
        /// Its states, at least two, times increasing. They must reach beyond the next step, start
        /// at most 5 m from the ego, and be no farther apart than 5 m and 100 m/s.
        states: Vec<ExecState>,
    },
    /// The next states of the other agents.
    Agents {
        /// The states. Objects that are left out follow the log.
        objects: Vec<ExecAgent>,
    },
    /// The command cannot plan; the simulation fails.
    Error {
        /// Why.
        message: String,
    },
}

/// A state of the planned trajectory: the rear axle.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
pub struct ExecState {
    /// Seconds from now. If the first state is later than 0, the present state goes before it.
    pub t: f64,
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
    /// Heading.
    pub heading: f64,
    /// Speed, m/s.
    pub speed: f64,
    /// Acceleration, m/s².
    #[serde(default)]
    pub acceleration: f64,
    /// Angle of the front wheels, radians.
    #[serde(default)]
    pub steering_angle: f64,
}

impl ExecInitialization {
    /// The first message of a simulation.
    pub(super) fn from_initialization(initialization: &PlannerInitialization<'_>) -> Self {
        let PlannerInitialization { map, route } = initialization;
        let vehicle = ExecVehicle {
            width: PACIFICA.width,
            front_length: PACIFICA.front_length,
            rear_length: PACIFICA.rear_length,
            wheel_base: PACIFICA.wheel_base,
        };
        let route = ExecRoute {
            roadblocks: route.roadblocks.iter().map(|id| id.0).collect(),
            lanes: route.lanes(map).into_iter().map(|id| id.0).collect(),
            goal: route.goal.map(|Pose { x, y, heading }| [x, y, heading]),
            goal_lane: route.goal_lane.map(|id| id.0),
        };
        Self {
            version: VERSION,
            step_s: STEP_S,
            vehicle,
            map: ExecMap::from_map(map),
            route,
        }
    }
}

impl ExecMap {
    fn from_map(map: &LaneMap) -> Self {
        let rings = |polygons: &[Polygon]| polygons.iter().map(ring).collect::<Vec<_>>();
        let stop_lines = map.stop_lines().iter().map(|line| ExecStopLine {
            polygon: ring(&line.polygon),
            lanes: line.lanes.iter().map(|id| id.0).collect(),
            stop_sign: line.stop_sign,
        });
        let areas = [map.road_segments(), map.generic_drivable(), map.carparks()];
        Self {
            lanes: map.lanes().iter().map(ExecLane::from_lane).collect(),
            stop_lines: stop_lines.collect(),
            intersections: rings(map.intersections()),
            crosswalks: rings(map.crosswalks()),
            drivable: areas.into_iter().flat_map(rings).collect(),
        }
    }
}

impl ExecLane {
    fn from_lane(lane: &Lane) -> Self {
        Self {
            id: lane.id.0,
            connector: lane.is_connector(),
            centerline: points(lane.centerline.vertices()),
            polygon: ring(&lane.polygon),
            incoming: lane.incoming.iter().map(|id| id.0).collect(),
            outgoing: lane.outgoing.iter().map(|id| id.0).collect(),
            left: lane.left.iter().map(|beside| beside.lane.0).collect(),
            right: lane.right.iter().map(|beside| beside.lane.0).collect(),
            roadblock: lane.roadblock.0,
            speed_limit: lane.speed_limit,
        }
    }
}

impl ExecStep {
    /// The message of an iteration; `first` adds the history.
    pub(super) fn from_input(input: &PlannerInput<'_>, first: bool) -> Self {
        let scene = &input.scene;
        let past = scene.history.samples().len().saturating_sub(1);
        let history = scene
            .history
            .samples()
            .take(if first { past } else { 0 })
            .map(ExecSample::from_sample);
        Self {
            iteration: input.iteration,
            ego: ExecEgo::from_state(scene.ego),
            objects: scene.objects.iter().map(ExecObject::from_object).collect(),
            lights: lights(scene.lights),
            history: history.collect(),
        }
    }
}

impl ExecSample {
    fn from_sample(sample: &HistorySample) -> Self {
        Self {
            ego: ExecEgo::from_state(&sample.ego),
            objects: sample.objects.iter().map(ExecObject::from_object).collect(),
        }
    }
}

impl ExecEgo {
    pub(super) fn from_state(ego: &EgoState) -> Self {
        let Pose { x, y, heading } = ego.rear_axle;
        Self {
            time_us: ego.time_us,
            x,
            y,
            heading,
            velocity: vector(ego.velocity),
            acceleration: vector(ego.acceleration),
            steering_angle: ego.steering_angle,
            angular_velocity: ego.angular_velocity,
        }
    }
}

impl ExecObject {
    pub(super) fn from_object(object: &TrackedObject) -> Self {
        let OrientedBox {
            center: Pose { x, y, heading },
            length,
            width,
        } = object.shape;
        let (kind, velocity) = (object.kind.to_string(), vector(object.velocity));
        Self {
            track: object.token.0,
            kind,
            x,
            y,
            heading,
            length,
            width,
            velocity,
        }
    }
}

/// The trajectory of a reply, from the ego on; or what is wrong with it.
pub fn trajectory(states: &[ExecState], ego: &EgoState) -> Result<Trajectory, String> {
    // With the present state before it, a single one would make a trajectory that says neither how
    // fast the ego drives nor where it turns.
    if states.len() < MIN_STATES {
        return Err(format!(
            "a plan has at least {MIN_STATES} states, got {}",
            states.len()
        ));
    }
    let is_near = |state: &ExecState| state.t.abs() <= MAX_TIME_S;
    if let Some(place) = states.iter().position(|state| !is_near(state)) {
        return Err(format!(
            "the time of state {place} is not within {MAX_TIME_S} s from now; t of a state is in seconds from now"
        ));
    }
    // The clock of the scenario in place of the time from now would hold the ego where it is.
    if let Some(first) = states.first().filter(|first| first.t > MAX_START_S) {
        return Err(format!(
            "the plan begins {:.1} s from now, and {MAX_START_S} s are the limit; t of a state is in seconds from now",
            first.t
        ));
    }
    let own = |state: &ExecState| TrajectoryState {
        time_us: ego.time_us + (state.t * MICROS_PER_SECOND).round() as i64,
        rear_axle: Pose::new(state.x, state.y, state.heading),
        velocity: Vector::new(state.speed, 0.0),
        acceleration: Vector::new(state.acceleration, 0.0),
        steering_angle: state.steering_angle,
    };
    let present = states
        .first()
        .is_some_and(|first| first.t > 0.0)
        .then(|| TrajectoryState::from(ego));
    let plan = Trajectory::new(present.into_iter().chain(states.iter().map(own)).collect())
        .map_err(|error| error.to_string())?;
    check_plan(&plan, ego).map_err(|error| error.to_string())?;
    Ok(plan)
}

/// The lights as messages have them.
pub(super) fn lights(lights: &TrafficLights) -> Vec<ExecLight> {
    lights
        .iter()
        .map(|(lane, status)| ExecLight {
            lane: lane.0,
            status: status.to_string(),
        })
        .collect()
}

fn ring(polygon: &Polygon) -> Vec<[f64; 2]> {
    points(polygon.ring())
}

fn points(points: &[Point]) -> Vec<[f64; 2]> {
    points.iter().map(|point| [point.x, point.y]).collect()
}

fn vector(vector: Vector) -> [f64; 2] {
    [vector.x, vector.y]
}
