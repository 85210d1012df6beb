//! Rolls plans out: IDM along the path of the plan, behind the lead object.

use super::path::onto_centerline;
use super::plan_builder::PlanBuilder;
use super::ride::{Bends, Ride, Smoothed};
use super::shift::shift;
use super::version::Version;
use crate::environment::lane_graph::OncomingLane;
use crate::environment::{CenterlineName, LaneGraph};
use crate::reasoning::{DECELERATIONS, PlannerCode};
use planagent_score::pdm::LATERAL_OFFSETS;
use planagent_world::dynamics::{IdmParameters, Lead};
use planagent_world::geometry::{
    Corridor, GeometryError, OrientedBox, Point, Polyline, Pose, Vector,
};
use planagent_world::{
    EgoState, LaneId, LanePath, PACIFICA, STEP_S, STEP_US, SceneView, SignalStatus, TrackToken,
    TrackedObject, Trajectory, TrajectoryError, TrajectoryState,
};

/// Exponent δ of the plan's IDM (PDM-Closed's).
/// Why: docs/decisions/103-lead-policy.md.
const EXPONENT: i32 = 10;
/// Gap at standstill s0, m (PDM-Closed's).
const MIN_GAP: f64 = 1.0;
/// Headway T, s (PDM-Closed's).
const HEADWAY: f64 = 1.5;
/// A desired speed below this means: stand still, m/s.
const STANDSTILL: f64 = 0.05;
/// Objects slower than this stand, m/s.
const STANDING: f64 = 0.2;
/// Steps between two searches for the lead object, as in PDM-Closed.
const LEAD_REFRESH: usize = 2;
/// Deceleration of the stop, m/s²: the highest that a code may contain.
const STOP_DECEL: f64 = DECELERATIONS[DECELERATIONS.len() - 1];
/// Length of path beyond the end of the fastest roll-out, meters.
const PATH_MARGIN: f64 = 30.0;

/// Which objects a plan follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LeadPolicy {
    /// The named lead agent alone: exactly what the code says.
    Named,
    /// The nearest of the centerline's lead agent, all objects on the path, and red lights, as in
    /// PDM-Closed's roll-out. The name in the code does not matter.
    #[default]
    Nearest,
}

/// The plan of a code: an IDM planner with its path.
#[derive(Debug, Clone, PartialEq)]
pub struct IdmPlan {
    /// The planner code.
    pub code: PlannerCode,
    /// Lanes of the followed centerline.
    pub lanes: LanePath,
    /// Track of the lead agent: the named one, or the centerline's ([`LeadPolicy`]).
    pub lead_agent: Option<TrackToken>,
    /// Which objects are followed.
    pub lead_policy: LeadPolicy,
    /// How it drives.
    ride: Ride,
    /// The way past what blocks the ego's lane, where the plan takes it.
    oncoming: Option<Box<OncomingLane>>,
    /// Where the ego stops in its lane before what it may pass.
    stop_point: Option<Point>,
    /// Paths of the rear axle, one for each of the [`LATERAL_OFFSETS`] from the centerline. The
    /// first is the code's, which keeps a distance from what stands at the edge of the lane.
    paths: [Polyline; LATERAL_OFFSETS.len()],
    /// Where the first path has come onto its line.
    settled: Point,
    /// The speed that bends allow along the paths.
    bends: Bends,
}

/// A roll-out: poses of the rear axle with speeds, every 0.1 s, the present one first.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// Rear-axle poses, map frame.
    pub poses: Vec<Pose>,
    /// Speed at each pose, m/s.
    pub speeds: Vec<f64>,
}

impl IdmPlan {
    /// The plan of `code` from the present state on, along `lanes`, as all plans of its builder.
    ///
    /// # Errors
    /// When the ego's pose is not finite.
    pub(super) fn new(
        scene: &SceneView<'_>,
        code: PlannerCode,
        lanes: LanePath,
        lead_agent: Option<TrackToken>,
        builder: &PlanBuilder,
    ) -> Result<Self, GeometryError> {
        let (paths, settled) = lay_paths(scene, &code, &lanes, builder.horizon_s, None)?;
        let bends = bends(builder.ride, scene, &lanes, &paths);
        Ok(Self {
            code,
            lanes,
            lead_agent,
            lead_policy: builder.lead_policy,
            ride: builder.ride,
            oncoming: None,
            stop_point: None,
            paths,
            settled,
            bends,
        })
    }

    /// The same after another plan: bound for the same lane, it comes onto its line where that one
    /// does.
    ///
    /// # Errors
    /// When the ego's pose is not finite.
    pub fn after(
        self,
        active: &Self,
        scene: &SceneView<'_>,
        horizon_s: f64,
    ) -> Result<Self, GeometryError> {
        let goes_on = self.lane_now(scene) == active.lane_now(scene)
            && self.oncoming.is_some() == active.oncoming.is_some();
        if !goes_on {
            return Ok(self);
        }
        let (paths, settled) = lay_paths(
            scene,
            &self.code,
            &self.lanes,
            horizon_s,
            Some(active.settled),
        )?;
        let bends = bends(self.ride, scene, &self.lanes, &paths);
        Ok(Self {
            paths,
            settled,
            bends,
            ..self
        })
    }

    /// The same where something may block the ego's lane. A plan over the oncoming lane passes it.
    /// A plan in the ego's lane stops where the ego can still leave the lane.
    pub(super) fn at_blocked_lane(mut self, graph: &LaneGraph, follows: CenterlineName) -> Self {
        (self.oncoming, self.stop_point) = match follows {
            CenterlineName::OncomingLane => (graph.oncoming.clone().map(Box::new), None),
            CenterlineName::EgoLane => (None, graph.stop_point()),
            CenterlineName::LeftLane | CenterlineName::RightLane => (None, None),
        };
        self
    }

    /// The same without the stop before what the ego may pass.
    pub(super) fn without_stop_point(self) -> Self {
        Self {
            stop_point: None,
            ..self
        }
    }

    /// The same over the oncoming lane, past what another plan has begun to pass.
    pub(super) fn completing(mut self, lane: &OncomingLane) -> Self {
        (self.oncoming, self.stop_point) = (Some(Box::new(lane.clone())), None);
        self
    }

    /// The way past what blocks the ego's lane, where the plan takes it.
    pub fn oncoming(&self) -> Option<&OncomingLane> {
        self.oncoming.as_deref()
    }

    /// The lane of the plan beside the ego's present place.
    pub fn lane_now(&self, scene: &SceneView<'_>) -> LaneId {
        self.lanes.lane_at(
            self.lanes
                .centerline
                .project(scene.ego.center().position())
                .s,
        )
    }

    /// The plan along `lanes`, which reach further, with a path from the ego's present place.
    ///
    /// # Errors
    /// When the ego's pose is not finite.
    pub fn extended(
        &self,
        scene: &SceneView<'_>,
        lanes: LanePath,
        horizon_s: f64,
    ) -> Result<Self, GeometryError> {
        let (paths, settled) = lay_paths(scene, &self.code, &lanes, horizon_s, Some(self.settled))?;
        let bends = bends(self.ride, scene, &lanes, &paths);
        Ok(Self {
            lanes,
            paths,
            settled,
            bends,
            ..self.clone()
        })
    }

    /// The path of the rear axle, from the ego's place when the plan was built.
    pub fn path(&self) -> &Polyline {
        &self.paths[0]
    }

    /// The roll-out from the present state, `steps` steps of 0.1 s long. Other objects keep their
    /// velocity.
    pub fn roll_out(&self, scene: &SceneView<'_>, steps: usize) -> Rollout {
        self.roll_out_version(Version::PLAN, scene, steps)
    }

    /// The roll-outs of every [`Version`], in order; the stop is the last.
    pub fn roll_out_versions(
        &self,
        scene: &SceneView<'_>,
        steps: usize,
    ) -> Vec<(Version, Rollout)> {
        let mut rollouts = Vec::new();
        for (path, line) in self.paths.iter().enumerate() {
            let road = Road::new(self, line, scene, steps);
            for version in Version::along(path, self.ride) {
                rollouts.push((version, self.roll_out_along(&road, version, scene, steps)));
            }
        }
        rollouts.push((
            Version::STOP,
            self.roll_out_version(Version::STOP, scene, steps),
        ));
        rollouts
    }

    /// The roll-out of one version.
    pub fn roll_out_version(
        &self,
        version: Version,
        scene: &SceneView<'_>,
        steps: usize,
    ) -> Rollout {
        let path = self.paths.get(version.path).unwrap_or(self.path());
        self.roll_out_along(&Road::new(self, path, scene, steps), version, scene, steps)
    }

    /// Simulates a version on its road: IDM towards the nearest lead object of it, whatever the code
    /// names.
    /// Why: docs/decisions/103-lead-policy.md.
    fn roll_out_along(
        &self,
        road: &Road<'_>,
        version: Version,
        scene: &SceneView<'_>,
        steps: usize,
    ) -> Rollout {
        let PlannerCode {
            target_speed,
            accel_max,
            ..
        } = self.code;
        let target_velocity = version.fraction * target_speed;
        let decel_max = if version == Version::STOP {
            STOP_DECEL
        } else {
            self.code.decel_max
        };
        let idm = IdmParameters {
            target_velocity,
            min_gap: MIN_GAP,
            headway: HEADWAY,
            accel_max,
            decel_max,
            exponent: EXPONENT,
        };
        let path = road.path;
        let mut progress = path.project(scene.ego.rear_axle.position()).s;
        let mut speed = scene.ego.velocity.x.max(0.0);
        let mut lead = None;
        let is_smooth = self.ride == Ride::Comfortable && !version.is_brisk;
        let mut smoothed = is_smooth.then(|| Smoothed::from_ego(scene.ego));
        let mut rollout = Rollout {
            poses: vec![path.smooth_pose_at(progress)],
            speeds: vec![speed],
        };
        for step in 0..steps {
            if step % LEAD_REFRESH == 0 {
                lead = road.lead(progress, step as f64 * STEP_S);
            }
            let behind = lead.map(|lead: LeadOnPath| lead.behind(progress));
            let accel = if target_velocity < STANDSTILL {
                -decel_max
            } else if let Some(smoothed) = &mut smoothed {
                smoothed.step(idm, &self.bends, (progress, speed), behind)
            } else {
                let at_most = self.bends.acceleration(progress, speed);
                idm.acceleration(speed, behind).min(at_most)
            };
            // Explicit Euler with the old speed, as in PDM-Closed's own roll-outs.
            progress += STEP_S * speed;
            speed = (speed + STEP_S * accel).max(0.0);
            rollout.poses.push(path.smooth_pose_at(progress));
            rollout.speeds.push(speed);
        }
        rollout
    }
}

/// The paths of a plan from the present state on, long enough for its fastest roll-out, and where
/// the first has come onto its line.
fn lay_paths(
    scene: &SceneView<'_>,
    code: &PlannerCode,
    lanes: &LanePath,
    horizon_s: f64,
    settled: Option<Point>,
) -> Result<([Polyline; LATERAL_OFFSETS.len()], Point), GeometryError> {
    let length = code.target_speed.max(scene.ego.speed()) * horizon_s + PATH_MARGIN;
    let [on, right, left] = LATERAL_OFFSETS;
    let on = on + shift(scene, lanes);
    let [on, right, left] = [on, right, left]
        .map(|beside| onto_centerline(scene.ego, &lanes.centerline, (beside, length), settled));
    let on = on?;
    Ok(([on.path, right?.path, left?.path], on.settled))
}

/// The speeds that bends of the followed lanes allow, from the ego on.
fn bends(
    ride: Ride,
    scene: &SceneView<'_>,
    lanes: &LanePath,
    paths: &[Polyline; LATERAL_OFFSETS.len()],
) -> Bends {
    match ride {
        Ride::Idm => Bends::default(),
        Ride::Comfortable => {
            let line = &lanes.centerline;
            let here = line.project(scene.ego.rear_axle.position()).s;
            Bends::along(line, here, paths[0].length())
        }
    }
}

impl Rollout {
    /// The roll-out as a trajectory that begins at the present state.
    ///
    /// # Errors
    /// When a pose is not finite.
    pub fn to_trajectory(&self, ego: &EgoState) -> Result<Trajectory, TrajectoryError> {
        let planned =
            self.poses
                .iter()
                .zip(&self.speeds)
                .enumerate()
                .skip(1)
                .map(|(i, (&pose, &speed))| {
                    let accel = (speed - self.speeds[i - 1]) / STEP_S;
                    TrajectoryState::moving(ego.time_us + i as i64 * STEP_US, pose, speed, accel)
                });
        Trajectory::new(
            std::iter::once(TrajectoryState::from(ego))
                .chain(planned)
                .collect(),
        )
    }

    /// Length of the path, meters.
    pub fn distance(&self) -> f64 {
        self.poses.windows(2).map(|w| w[0].distance(&w[1])).sum()
    }
}

/// The lead object: arc length of its rear on the path, and its speed along the path.
#[derive(Debug, Clone, Copy)]
struct LeadOnPath {
    rear_s: f64,
    speed: f64,
}

impl LeadOnPath {
    /// As IDM takes it, for an ego whose rear axle is at arc length `progress`.
    fn behind(self, progress: f64) -> Lead {
        Lead {
            gap: self.rear_s - progress - PACIFICA.front_length,
            speed: self.speed,
        }
    }
}

/// The candidates for the lead object along one path during one roll-out.
struct Road<'a> {
    path: &'a Polyline,
    corridor: Corridor,
    /// Objects that may come onto the corridor within the horizon.
    objects: Vec<TrackedObject>,
    named: Option<TrackedObject>,
    /// Arc length at which the front bumper stops, for a red light or the end of the path.
    stop_s: f64,
}

impl<'a> Road<'a> {
    /// The road of a path: what may come onto it, but for what stands beside it.
    /// Why: docs/decisions/115-past-what-stands.md.
    fn new(plan: &IdmPlan, path: &'a Polyline, scene: &SceneView<'_>, steps: usize) -> Self {
        let corridor = Corridor::new(path.clone(), PACIFICA.width / 2.0);
        let seconds = steps as f64 * STEP_S;
        let footprint = scene.ego.footprint();
        let may_come = |object: &&TrackedObject| {
            let later = moved(object, seconds);
            let sweep = object.shape.bounds().joined(later.bounds());
            corridor.bounds().overlaps(&sweep) && !object.shape.overlaps(&footprint)
        };
        // Beside what stands there is nothing to follow: whether the ego touches it, the score
        // says. Nor is there behind what stands in the lane where the path leads past it.
        let front = path.project(scene.ego.rear_axle.position()).s + PACIFICA.front_length;
        let is_beside = |object: &TrackedObject| {
            let rear_s = object
                .shape
                .corners()
                .map(|corner| path.project(corner).s)
                .into_iter()
                .fold(f64::INFINITY, f64::min);
            object.speed() < STANDING && rear_s < front
        };
        let named = plan
            .lead_agent
            .and_then(|token| scene.objects.iter().find(|o| o.token == token).copied());
        let (objects, named) = match plan.lead_policy {
            LeadPolicy::Named => (Vec::new(), named),
            LeadPolicy::Nearest => {
                let ahead = scene
                    .objects
                    .iter()
                    .filter(may_come)
                    .filter(|object| !is_beside(object));
                let is_passed = |object: &TrackedObject| {
                    object.speed() < STANDING && !corridor.meets_box(&object.shape)
                };
                (
                    ahead.copied().collect(),
                    named.filter(|object| !is_beside(object) && !is_passed(object)),
                )
            }
        };
        let stop_s = match plan.lead_policy {
            LeadPolicy::Named => path.length(),
            LeadPolicy::Nearest => {
                let stops = red_light(plan, path, scene)
                    .into_iter()
                    .chain(before_obstacle(plan, path, scene));
                stops.fold(path.length(), f64::min)
            }
        };
        Self {
            path,
            corridor,
            objects,
            named,
            stop_s,
        }
    }

    /// The lead object after `seconds`, for an ego at arc length `progress`.
    fn lead(&self, progress: f64, seconds: f64) -> Option<LeadOnPath> {
        let front = progress + PACIFICA.front_length;
        let on_path = self.objects.iter().filter_map(|object| {
            let shape = moved(object, seconds);
            if !self.corridor.meets_box(&shape) {
                return None;
            }
            self.place(object, &shape, progress)
        });
        let named = self
            .named
            .iter()
            .filter_map(|object| self.place(object, &moved(object, seconds), progress));
        let stop = (self.stop_s > front - MIN_GAP).then_some(LeadOnPath {
            rear_s: self.stop_s,
            speed: 0.0,
        });
        on_path
            .chain(named)
            .chain(stop)
            .min_by(|a, b| a.rear_s.total_cmp(&b.rear_s))
    }

    /// The object's place on the path; `None` when its center lies behind the ego's rear axle.
    fn place(
        &self,
        object: &TrackedObject,
        shape: &OrientedBox,
        progress: f64,
    ) -> Option<LeadOnPath> {
        let foot = self.path.project(shape.center.position());
        if foot.s <= progress {
            return None;
        }
        let rear_s = shape
            .corners()
            .iter()
            .map(|&corner| self.path.project(corner).s)
            .fold(f64::INFINITY, f64::min);
        let along = Vector::new(foot.heading.cos(), foot.heading.sin());
        Some(LeadOnPath {
            rear_s,
            speed: object.velocity.dot(&along).max(0.0),
        })
    }
}

/// The box of an object that keeps its velocity.
fn moved(object: &TrackedObject, seconds: f64) -> OrientedBox {
    let at = object.shape.center.position() + object.velocity * seconds;
    object
        .shape
        .moved_to(Pose::at(at, object.shape.center.heading))
}

/// Arc length on the path of the place before an obstacle at which the ego can still leave its
/// lane. Where the ego is beyond that place, it stops as soon as its code allows.
fn before_obstacle(plan: &IdmPlan, path: &Polyline, scene: &SceneView<'_>) -> Option<f64> {
    let stop_s = path.project(plan.stop_point?).s;
    let front = path.project(scene.ego.rear_axle.position()).s + PACIFICA.front_length;
    let soonest =
        front + MIN_GAP + scene.ego.velocity.x.max(0.0).powi(2) / (2.0 * plan.code.decel_max);
    Some(stop_s.max(soonest))
}

/// Arc length on the path of the first red light ahead: the start of its connector.
fn red_light(plan: &IdmPlan, path: &Polyline, scene: &SceneView<'_>) -> Option<f64> {
    let here = plan
        .lanes
        .centerline
        .project(scene.ego.rear_axle.position())
        .s
        + PACIFICA.front_length;
    let lanes = plan.lanes.lanes.iter().zip(&plan.lanes.starts);
    let red = lanes.filter(|&(&lane, &start)| {
        start >= here - MIN_GAP && scene.lights.status(lane) == Some(SignalStatus::Red)
    });
    let start = red.map(|(_, &start)| start).next()?;
    Some(path.project(plan.lanes.centerline.point_at(start)).s)
}
