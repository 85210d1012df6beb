//! Rolls plans out: IDM along the path of the plan, behind the lead object.

use super::path::{Pace, SWERVES};
use super::plan_builder::PlanBuilder;
use super::plan_paths::PlanPaths;
use super::ride::{Ride, Smoothed};
use super::road::{LeadOnPath, Road};
use crate::environment::lane_graph::{OncomingLane, STANDING};
use crate::environment::{CenterlineName, GraphedScene};
use crate::reasoning::{DECELERATIONS, PlannerCode};
use planagent_score::pdm::SPEED_FRACTIONS;
use planagent_world::dynamics::IdmParameters;
use planagent_world::geometry::{Corridor, GeometryError, Point, Polyline, Pose};
use planagent_world::{
    EgoState, LaneId, LanePath, PACIFICA, STEP_S, STEP_US, SceneView, TrackToken, TrackedObject,
    Trajectory, TrajectoryError, TrajectoryState,
};

/// Exponent δ of the plan's IDM (PDM-Closed's).
/// Why: docs/decisions/103-lead-policy.md.
const EXPONENT: i32 = 10;
/// Gap at standstill s0, m (PDM-Closed's).
pub(super) const MIN_GAP: f64 = 1.0;
/// Headway T, s (PDM-Closed's).
const HEADWAY: f64 = 1.5;
/// A desired speed below this means: stand still, m/s.
const STANDSTILL: f64 = 0.05;
/// Steps between two searches for the lead object, as in PDM-Closed.
pub(super) const LEAD_REFRESH: usize = 2;
/// Deceleration of the stop, and of braking for a waiting place at most, m/s²: the highest that a
/// code may contain.
pub(super) const STOP_DECEL: f64 = DECELERATIONS[DECELERATIONS.len() - 1];

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
    /// How it drives in a lane that nothing blocks.
    ride: Ride,
    /// Whether it leaves a lane that something blocks.
    leaves_blocked_lane: bool,
    /// The way past what blocks the ego's lane, where the plan takes it.
    oncoming: Option<Box<OncomingLane>>,
    /// Where the front bumper stops before what the ego may pass, map frame: from there it can still
    /// leave its lane.
    pub(super) waiting_place: Option<Point>,
    /// Its paths, from the ego's place when it was built.
    paths: PlanPaths,
}

/// A version of a plan: slower, or to the side within its lane, by the fractions and offsets of
/// PDM-Closed's proposals, or a hard stop. The first is the plan itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Version {
    /// Index of its path in [`planagent_score::pdm::LATERAL_OFFSETS`].
    path: usize,
    /// Its share of the desired speed.
    fraction: f64,
    /// Whether it comes to that speed as fast as the code allows, whatever the ride.
    is_brisk: bool,
}

impl Version {
    /// The plan itself.
    pub const PLAN: Self = Self {
        path: 0,
        fraction: 1.0,
        is_brisk: false,
    };
    /// A stop on the plan's own path, at the highest deceleration that a code may contain.
    pub const STOP: Self = Self {
        path: 0,
        fraction: 0.0,
        is_brisk: true,
    };

    /// The versions along a path, the fastest first. On the plan's own path, those that slow down
    /// gently come before those that brake; to the side the ego evades something.
    fn along(path: usize, ride: Ride) -> Vec<Self> {
        let fractions = || SPEED_FRACTIONS.into_iter().rev();
        let version = |is_brisk| {
            move |fraction| Self {
                path,
                fraction,
                is_brisk,
            }
        };
        let slower = fractions().skip(1);
        match (ride, path) {
            (Ride::Idm, _) => fractions().map(version(false)).collect(),
            (Ride::Comfortable, 0) => fractions()
                .map(version(false))
                .chain(slower.map(version(true)))
                .collect(),
            (Ride::Comfortable, _) => fractions()
                .take(1)
                .map(version(false))
                .chain(slower.map(version(true)))
                .collect(),
        }
    }

    /// Whether it rides as the plan itself does.
    pub(super) fn rides_as_plan(self) -> bool {
        !self.is_brisk
    }

    /// Whether it moves along the path of the plan itself.
    pub fn is_on_own_path(self) -> bool {
        self.path == 0 && self != Self::STOP
    }
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
        let bound = (&code, &lanes, builder.ride);
        let paths = PlanPaths::lay(scene, bound, builder.horizon_s, (None, Pace::Usual))?;
        Ok(Self {
            code,
            lanes,
            lead_agent,
            lead_policy: builder.lead_policy,
            ride: builder.ride,
            leaves_blocked_lane: false,
            oncoming: None,
            waiting_place: None,
            paths,
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
        let pace = match self.paths.pace {
            Pace::Usual => active.paths.pace,
            swerve @ Pace::Swerve(_) => swerve,
        };
        self.laid(scene, horizon_s, (Some(active.paths.settled), pace))
    }

    /// The same with its paths laid again from the ego's present place.
    fn laid(
        self,
        scene: &SceneView<'_>,
        horizon_s: f64,
        onto: (Option<Point>, Pace),
    ) -> Result<Self, GeometryError> {
        let bound = (&self.code, &self.lanes, self.ride);
        let paths = PlanPaths::lay(scene, bound, horizon_s, onto)?;
        Ok(Self { paths, ..self })
    }

    /// The same where something may block the ego's lane. A plan over the oncoming lane passes it.
    /// A plan in the ego's lane stops where the ego can still leave the lane, unless its path leads
    /// past, and brakes for that place as hard as it must: who stops nearer never passes. One that
    /// leaves the lane rides as IDM does: out of braking, a gentle start comes too late to pass.
    /// Why: docs/decisions/132-past-at-once.md, docs/decisions/144-wait-where-the-way-begins.md,
    /// docs/decisions/148-swerve-or-wait.md.
    pub(super) fn at_blocked_lane(
        mut self,
        seen: GraphedScene<'_>,
        follows: CenterlineName,
    ) -> Self {
        let graph = seen.graph;
        self.leaves_blocked_lane =
            follows != CenterlineName::EgoLane && graph.stop_point().is_some();
        (self.oncoming, self.waiting_place) = match follows {
            CenterlineName::OncomingLane => (graph.oncoming.clone().map(Box::new), None),
            CenterlineName::EgoLane => {
                let place = graph.stop_point().filter(|_| !self.leads_past(seen));
                (None, place)
            }
            CenterlineName::LeftLane | CenterlineName::RightLane => (None, None),
        };
        self
    }

    /// The same, as quickly into the lane beside as it must to pass what blocks the ego's: by the
    /// gentlest swerve that leads past. Unchanged where none does.
    pub(super) fn swerving(
        self,
        seen: GraphedScene<'_>,
        horizon_s: f64,
    ) -> Result<Self, GeometryError> {
        let changes_lanes = self.leaves_blocked_lane && self.oncoming.is_none();
        if !changes_lanes || self.ride == Ride::Idm || self.leads_past(seen) {
            return Ok(self);
        }
        for swerve in self.swerves(seen.scene, horizon_s) {
            let swerve = swerve?;
            if swerve.leads_past(seen) {
                return Ok(swerve);
            }
        }
        Ok(self)
    }

    /// The same, swerving into its lane, the gentlest first.
    pub(crate) fn swerves(
        &self,
        scene: &SceneView<'_>,
        horizon_s: f64,
    ) -> impl Iterator<Item = Result<Self, GeometryError>> {
        SWERVES.into_iter().map(move |accel| {
            let onto = (None, Pace::Swerve(accel));
            self.clone().laid(scene, horizon_s, onto)
        })
    }

    /// Whether the path leads past all that blocks the ego's lane and past its lead agent, if that
    /// stands: within the lane, or a little over its border.
    pub(crate) fn leads_past(&self, GraphedScene { scene, graph }: GraphedScene<'_>) -> bool {
        let own = &graph.ego_lane().path.centerline;
        let lead = graph.lead_agent(CenterlineName::EgoLane);
        let is_in_the_way = |object: &TrackedObject| {
            let s = own.project(object.shape.center.position()).s;
            lead.is_some_and(|lead| lead.token == object.token)
                || graph
                    .blocked
                    .is_some_and(|blocked| (blocked.from_s..=blocked.to_s).contains(&s))
        };
        let strip = Corridor::new(self.path().clone(), PACIFICA.width / 2.0);
        !scene.objects.iter().any(|object| {
            object.speed() < STANDING && is_in_the_way(object) && strip.meets_box(&object.shape)
        })
    }

    /// The same without the stop before what the ego may pass.
    pub(super) fn without_waiting_place(self) -> Self {
        Self {
            waiting_place: None,
            ..self
        }
    }

    /// The same over the oncoming lane, past what another plan has begun to pass.
    pub(super) fn completing(mut self, lane: &OncomingLane) -> Self {
        (self.oncoming, self.waiting_place) = (Some(Box::new(lane.clone())), None);
        self.leaves_blocked_lane = true;
        self
    }

    /// How it drives here.
    fn ride_here(&self) -> Ride {
        if self.leaves_blocked_lane {
            Ride::Idm
        } else {
            self.ride
        }
    }

    /// Whether it follows who walked onto its path as if they stopped there, as a passenger would
    /// expect. PDM-Closed's roll-outs, and the paper's, see people walk on.
    /// Why: docs/decisions/149-a-cause-to-leave.md.
    pub(super) fn expects_people_to_stop(&self) -> bool {
        self.ride == Ride::Comfortable
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
        let onto = (Some(self.paths.settled), self.paths.pace);
        let plan = Self {
            lanes,
            ..self.clone()
        };
        plan.laid(scene, horizon_s, onto)
    }

    /// The path of the rear axle, from the ego's place when the plan was built.
    pub fn path(&self) -> &Polyline {
        self.paths.own()
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
        let roads = self
            .paths
            .each()
            .map(|path| Road::new(self, path, scene, steps));
        let along = |path| Version::along(path, self.ride_here());
        let versions = (0..roads.len()).flat_map(along).chain([Version::STOP]);
        let roll_out = |version: Version| {
            let road = roads.get(version.path)?;
            Some((version, self.roll_out_along(road, version, scene, steps)))
        };
        versions.filter_map(roll_out).collect()
    }

    /// The roll-out of one version.
    pub fn roll_out_version(
        &self,
        version: Version,
        scene: &SceneView<'_>,
        steps: usize,
    ) -> Rollout {
        let path = self.paths.get(version.path);
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
            road.decel_max
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
        let mut progress = road.start;
        let mut speed = scene.ego.velocity.x.max(0.0);
        let mut lead = None;
        let is_smooth = self.ride_here() == Ride::Comfortable && !version.is_brisk;
        let mut smoothed = is_smooth.then(|| Smoothed::from_ego(scene.ego));
        let mut rollout = Rollout {
            poses: vec![path.smooth_pose_at(progress)],
            speeds: vec![speed],
        };
        for step in 0..steps {
            if step % LEAD_REFRESH == 0 {
                lead = road.lead(progress, step);
            }
            let behind = lead.map(|lead: LeadOnPath| lead.behind(progress));
            let accel = if target_velocity < STANDSTILL {
                -decel_max
            } else if let Some(smoothed) = &mut smoothed {
                smoothed.step(idm, &self.paths.bends, (progress, speed), behind)
            } else {
                let at_most = self.paths.bends.acceleration(progress, speed);
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
