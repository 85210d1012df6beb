//! One episode of reinforcement learning: its plans, its reward, and what is observed.

use crate::errors::{Failure, Outcome};
use crate::trajectory::through;
use planagent::evaluation::{EvaluatedSimulation, MetricRegistry};
use planagent::planning::{HistorySample, SceneView};
use planagent::road::{Point, Polyline, Pose};
use planagent::traffic::{TrackToken, TrackedObject};
use planagent::{Challenge, EgoState, Scenario as Opened, Trajectory};
use planagent_agent::environment::{CenterlineName, GraphedScene, LaneGraph};
use planagent_agent::planner::{ReflectionSettings, planner_code};
use planagent_agent::simulation::ClosedLoop;
use planagent_runs::worker::run::with_causes;
use planagent_scenario::HeldScenario;
use planagent_score::pdm::PdmMemory;
use planagent_world::STEP_S;
use std::sync::Arc;

/// Length of the nodes of the lane graph, meters.
const NODE_LENGTH_M: f64 = 20.0;
/// Time that the plan of a planner code reaches, seconds.
const PLAN_S: f64 = 8.0;
/// Maximum accelerations and decelerations of codes, m/s²: default, gentle, firm, emergency (those
/// of `grid-code`).
const ACCELERATIONS: [(f64, f64); 4] = [(1.5, 3.0), (1.0, 2.0), (2.0, 4.0), (1.5, 6.0)];
/// Centerlines in the order of their numbers.
const CENTERLINES: [CenterlineName; 3] = [
    CenterlineName::EgoLane,
    CenterlineName::LeftLane,
    CenterlineName::RightLane,
];

/// Points of the reference path in an observation, and the space between them, meters.
const PATH_POINTS: usize = 10;
const PATH_STEP_M: f64 = 5.0;
/// Objects in an observation, the nearest ones, and the numbers of each.
const OBJECTS: usize = 8;
const OBJECT_NUMBERS: usize = 9;
/// Numbers before the path: speed, acceleration, steering angle, yaw rate, speed limit.
const EGO_NUMBERS: usize = 5;
/// Length of an observation.
pub(crate) const OBSERVATION: usize = EGO_NUMBERS + 2 * PATH_POINTS + OBJECTS * OBJECT_NUMBERS;
/// Scales of an observation: meters, m/s, m/s², length and width of an object in meters.
const METERS: f64 = 50.0;
const SPEED: f64 = 20.0;
const ACCELERATION: f64 = 5.0;
const SIZE: f64 = 10.0;
/// Limit where the map has none, m/s.
const UNKNOWN_LIMIT: f64 = 15.0;
/// Reward of a meter of progress, and of an end by a fault.
const PER_METER: f64 = 0.1;
const FAULT: f64 = -10.0;

/// What all episodes have in common.
pub(crate) struct Rules {
    pub(crate) scenarios: Vec<Arc<Opened>>,
    pub(crate) challenge: Challenge,
    /// Steps of 0.1 s for each action.
    pub(crate) steps: usize,
    /// Seconds between the poses of an action; an action is a code where this is none.
    pub(crate) pose_dt_s: Option<f64>,
}

pub(crate) struct Episode {
    pub(crate) closed_loop: ClosedLoop<'static>,
    reference: Polyline,
    limit: f64,
    progress: f64,
    /// What the ego overlaps at the start.
    touched: Vec<TrackToken>,
    is_ended: bool,
    pub(crate) random: u64,
    pub(crate) scenario: usize,
    /// What nuPlan's score is computed from.
    samples: Vec<HistorySample>,
    pub(crate) collided: bool,
    pub(crate) is_off_road: bool,
    /// nuPlan's score, at the end of the scenario.
    pub(crate) score: Option<f64>,
}

/// What an episode gives at a step: reward, whether it terminated by a fault, whether it was
/// truncated at its end.
#[derive(Clone, Copy, Default)]
pub(crate) struct Stepped {
    pub(crate) reward: f64,
    pub(crate) terminated: bool,
    pub(crate) truncated: bool,
}

/// `SplitMix64`, which needs one word of state.
fn drawn(random: &mut u64) -> u64 {
    *random = random.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*random ^ (*random >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

impl Episode {
    pub(crate) fn new(rules: &Rules, mut random: u64, fixed: Option<usize>) -> Outcome<Self> {
        let scenario =
            fixed.unwrap_or_else(|| (drawn(&mut random) % rules.scenarios.len() as u64) as usize);
        let absent = || Failure::argument(format!("there is no scenario {scenario}"));
        let held = HeldScenario::Shared(Arc::clone(
            rules.scenarios.get(scenario).ok_or_else(absent)?,
        ));
        let closed_loop = ClosedLoop::new(held, rules.challenge)?;
        let (view, mut memory) = (closed_loop.scene(), PdmMemory::default());
        memory.choose_reference_path(&view);
        let no_path = || {
            Failure::new(
                "SceneError",
                "the route of the scenario has no lanes to follow",
            )
        };
        let path = memory.reference_path.ok_or_else(no_path)?;
        let reference = path.centerline().line().clone();
        let limit = path
            .speed_limit(view.map, view.ego)
            .unwrap_or(UNKNOWN_LIMIT);
        let (progress, touched) = (
            reference.project(view.ego.center().position()).s,
            touching(&view).collect(),
        );
        Ok(Self {
            reference,
            limit,
            progress,
            touched,
            is_ended: false,
            random,
            scenario,
            closed_loop,
            samples: Vec::new(),
            collided: false,
            is_off_road: false,
            score: None,
        })
    }

    /// nuPlan's score of the whole scenario.
    fn scored(&self, challenge: Challenge) -> Outcome<f64> {
        let scenario = self.closed_loop.scenario();
        let expert: Vec<EgoState> = scenario.expert().copied().collect();
        let simulation = EvaluatedSimulation::new(&scenario.map, &self.samples, &expert);
        let evaluated = MetricRegistry::default().evaluate(challenge.metric_list(), &simulation);
        evaluated
            .map(|evaluation| evaluation.score.value)
            .map_err(|error| Failure::new("SimulationError", with_causes(&error)))
    }

    fn plan(&self, rules: &Rules, action: &[f64]) -> Outcome<Trajectory> {
        let scene = self.closed_loop.scene();
        let Some(dt_s) = rules.pose_dt_s else {
            return code_plan(&scene, action);
        };
        let ego = scene.ego.rear_axle;
        let (poses, _) = action.as_chunks::<3>();
        let of = |&[x, y, heading]: &[f64; 3]| {
            Pose::at(ego.to_map(Point::new(x, y)), ego.heading + heading)
        };
        through(scene.ego, &poses.iter().map(of).collect::<Vec<_>>(), dt_s)
    }

    pub(crate) fn step(&mut self, rules: &Rules, action: &[f64]) -> Outcome<Stepped> {
        if self.is_ended {
            *self = Self::new(rules, self.random, None)?;
            return Ok(Stepped::default());
        }
        let plan = self.plan(rules, action)?;
        let mut stepped = Stepped::default();
        for _ in 0..rules.steps {
            self.samples.push(self.closed_loop.present().clone());
            self.closed_loop.advance(&plan, "of an environment")?;
            let view = self.closed_loop.scene();
            let progress = self.reference.project(view.ego.center().position()).s;
            stepped.reward += PER_METER * (progress - self.progress);
            self.progress = progress;
            let corners = view.ego.footprint().corners();
            self.is_off_road = corners.iter().any(|&corner| !view.map.is_drivable(corner));
            self.collided = touching(&view).any(|token| !self.touched.contains(&token));
            if self.is_off_road || self.collided {
                stepped.reward += FAULT;
                stepped.terminated = true;
            }
            stepped.truncated = !stepped.terminated && self.closed_loop.is_over();
            if stepped.terminated || stepped.truncated {
                self.is_ended = true;
                if stepped.truncated {
                    self.score = Some(self.scored(rules.challenge)?);
                }
                break;
            }
        }
        Ok(stepped)
    }

    pub(crate) fn write(&self, out: &mut [f32]) {
        let view = self.closed_loop.scene();
        let ego = view.ego;
        let mut numbers = out.iter_mut();
        let mut put = |value: f64| {
            if let Some(number) = numbers.next() {
                *number = value as f32;
            }
        };
        put(ego.velocity.x / SPEED);
        put(ego.acceleration.x / ACCELERATION);
        put(ego.steering_angle);
        put(ego.angular_velocity);
        put(self.limit / SPEED);
        for i in 1..=PATH_POINTS {
            let point = self
                .reference
                .point_at(self.progress + i as f64 * PATH_STEP_M);
            let local = ego.rear_axle.to_local(point);
            put(local.x / METERS);
            put(local.y / METERS);
        }
        for object in nearest(ego, view.objects) {
            let center = object.shape.center;
            let local = ego.rear_axle.to_local(center.position());
            let turned = center.heading - ego.rear_axle.heading;
            let (sin, cos) = ego.rear_axle.heading.sin_cos();
            let (vx, vy) = (object.velocity.x, object.velocity.y);
            for value in [
                1.0,
                local.x / METERS,
                local.y / METERS,
                turned.cos(),
                turned.sin(),
                (cos * vx + sin * vy) / SPEED,
                (cos * vy - sin * vx) / SPEED,
                object.shape.length / SIZE,
                object.shape.width / SIZE,
            ] {
                put(value);
            }
        }
        numbers.for_each(|number| *number = 0.0);
    }
}

/// The tracks that the ego overlaps.
fn touching<'a>(view: &SceneView<'a>) -> impl Iterator<Item = TrackToken> + use<'a> {
    let footprint = view.ego.footprint();
    let bounds = footprint.bounds();
    let overlaps = move |object: &&TrackedObject| {
        object.shape.bounds().overlaps(&bounds) && object.shape.overlaps(&footprint)
    };
    view.objects
        .iter()
        .filter(overlaps)
        .map(|object| object.token)
}

/// The nearest objects, nearest first.
fn nearest<'a>(
    ego: &EgoState,
    objects: &'a [TrackedObject],
) -> impl Iterator<Item = &'a TrackedObject> {
    let at = ego.center();
    let mut by_distance: Vec<(f64, &TrackedObject)> = objects
        .iter()
        .map(|object| (at.distance(&object.shape.center), object))
        .collect();
    if by_distance.len() > OBJECTS {
        by_distance.select_nth_unstable_by(OBJECTS, |a, b| a.0.total_cmp(&b.0));
        by_distance.truncate(OBJECTS);
    }
    by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.token.cmp(&b.1.token)));
    by_distance.into_iter().map(|(_, object)| object)
}

/// The plan of a code: the numbers of its centerline, of its speed in tenths of the limit, and of
/// its accelerations. Where the scene has no such centerline, the ego's lane is followed.
fn code_plan(scene: &SceneView<'_>, code: &[f64]) -> Outcome<Trajectory> {
    let failed = |error: &dyn std::error::Error| Failure::new("SceneError", error.to_string());
    let graph = LaneGraph::build(scene, NODE_LENGTH_M).map_err(|error| failed(&error))?;
    let &[centerline, speed, accelerations] = code else {
        return Err(Failure::argument(
            "a code has three numbers: centerline, speed, accelerations",
        ));
    };
    let outside = || {
        Failure::argument(format!(
            "{code:?} is no code; its numbers lie in 0 to 2, 0 to 10 and 0 to 3"
        ))
    };
    let name = CENTERLINES
        .get(centerline as usize)
        .copied()
        .ok_or_else(outside)?;
    let accelerations = ACCELERATIONS
        .get(accelerations as usize)
        .copied()
        .ok_or_else(outside)?;
    if !(0.0..=10.0).contains(&speed) {
        return Err(outside());
    }
    let builder = ReflectionSettings::default().plan_builder();
    let build = |name| {
        builder.build(
            GraphedScene::new(scene, &graph),
            planner_code(&graph, name, speed / 10.0, accelerations),
        )
    };
    let plan = match build(name).map_err(|error| failed(&error))? {
        Some(plan) => Some(plan),
        None => build(CenterlineName::EgoLane).map_err(|error| failed(&error))?,
    };
    let plan = plan.ok_or_else(|| Failure::new("SceneError", "the ego is on no lane"))?;
    let rollout = plan.roll_out(scene, (PLAN_S / STEP_S) as usize);
    rollout
        .to_trajectory(scene.ego)
        .map_err(|error| failed(&error))
}
