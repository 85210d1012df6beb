//! The plan of a planner code: its lanes, its paths, and how it drives.

use super::path::{Pace, SWERVES};
use super::plan_builder::PlanBuilder;
use super::plan_paths::PlanPaths;
use super::ride::Ride;
use crate::environment::lane_graph::{OncomingLane, STANDING};
use crate::environment::{CenterlineName, GraphedScene};
use crate::reasoning::PlannerCode;
use planagent_world::geometry::{Corridor, GeometryError, Point, Polyline};
use planagent_world::{LaneId, LanePath, PACIFICA, SceneView, TrackToken, TrackedObject};

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
    pub(super) paths: PlanPaths,
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
    pub(super) fn ride_here(&self) -> Ride {
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
}
