//! A scenario while its changes are made.

use super::draws::Draws;
use super::fault::Fault;
use super::lanes::{EgoLanes, LanePlace};
use crate::Scenario;
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{
    CrossingActor, DriverBehavior, EgoState, LaneId, ObjectKind, RoadblockId, TrackToken,
    TrackedObject,
};
use std::collections::BTreeSet;
use std::sync::Arc;

/// The straight path of an actor across a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct CrossingPath {
    /// Where it meets the lane, meters ahead of the ego's center.
    pub(super) ahead_m: f64,
    pub(super) lane: LanePlace,
    /// Its start, meters left of the centerline.
    pub(super) from_left_m: f64,
    /// Its end, meters left of the centerline.
    pub(super) to_left_m: f64,
    /// m/s; 0 for an actor that stays at its start.
    pub(super) speed: f64,
    /// The actor starts when the ego's center is so far before the crossing, meters.
    pub(super) trigger_m: f64,
}

/// A vehicle that drives from iteration 0 on.
#[derive(Debug, Clone, Copy)]
pub(super) struct MovingVehicle {
    pub(super) object: TrackedObject,
    pub(super) behavior: Option<DriverBehavior>,
}

/// Where the expert drives instead of the log.
#[derive(Debug)]
pub(super) struct GoalPath {
    /// The centerline of the lanes to the goal.
    pub(super) path: planagent_world::LanePath,
    /// Where it is beside the ego's start, meters.
    pub(super) from_s: f64,
    /// How far the expert drives on it, meters.
    pub(super) length: f64,
    /// Its roadblocks.
    pub(super) roadblocks: Vec<RoadblockId>,
}

/// A scenario with the changes so far.
#[derive(Debug)]
pub(super) struct Draft {
    pub(super) scenario: Scenario,
    pub(super) lanes: EgoLanes,
    pub(super) draws: Draws,
    /// Logged tracks that are left out.
    pub(super) removed: BTreeSet<TrackToken>,
    /// What never moves.
    pub(super) standing: Vec<TrackedObject>,
    pub(super) moving: Vec<MovingVehicle>,
    pub(super) crossing: Vec<CrossingActor>,
    /// Speed of the ego at the start, m/s; without it, the logged one.
    pub(super) ego_speed: Option<f64>,
    pub(super) goal: Option<GoalPath>,
    pub(super) behavior: DriverBehavior,
    pub(super) lane_changes: bool,
    next_token: u32,
}

impl Draft {
    /// A scenario without changes, and the lanes around its ego at the start.
    pub(super) fn new(scenario: Scenario, lanes: EgoLanes, draws: Draws) -> Self {
        let tokens = scenario
            .frames
            .iter()
            .flat_map(|frame| frame.objects.iter().map(|object| object.token.0));
        let next_token = tokens.max().map_or(0, |token| token.saturating_add(1));
        Self {
            scenario,
            lanes,
            draws,
            removed: BTreeSet::new(),
            standing: Vec::new(),
            moving: Vec::new(),
            crossing: Vec::new(),
            ego_speed: None,
            goal: None,
            behavior: DriverBehavior::Default,
            lane_changes: false,
            next_token,
        }
    }

    /// The ego at the start.
    pub(super) fn ego(&self) -> &EgoState {
        &self.scenario.frames[self.scenario.start].ego
    }

    /// A token that no other object has.
    pub(super) fn token(&mut self) -> TrackToken {
        let token = TrackToken(self.next_token);
        self.next_token = self.next_token.saturating_add(1);
        token
    }

    /// Adds an object that never moves.
    pub(super) fn stand(&mut self, kind: ObjectKind, center: Pose, (length, width): (f64, f64)) {
        let token = self.token();
        let shape = OrientedBox::new(center, length, width);
        self.standing.push(TrackedObject {
            token,
            kind,
            shape,
            velocity: Vector::zeros(),
        });
    }

    /// Adds a vehicle that drives along its heading.
    pub(super) fn drive(
        &mut self,
        center: Pose,
        (length, width): (f64, f64),
        speed: f64,
        behavior: Option<DriverBehavior>,
    ) {
        let token = self.token();
        let shape = OrientedBox::new(center, length, width);
        let velocity = center.direction() * speed;
        let object = TrackedObject {
            token,
            kind: ObjectKind::Vehicle,
            shape,
            velocity,
        };
        self.moving.push(MovingVehicle { object, behavior });
    }

    /// Adds an actor that crosses a lane.
    pub(super) fn cross(
        &mut self,
        kind: ObjectKind,
        size: (f64, f64),
        path: CrossingPath,
    ) -> Result<(), Fault> {
        let pose = self
            .lanes
            .place(&self.scenario.map, path.ahead_m, path.lane)?
            .pose;
        let beside = |left_m: f64| pose.translated(0.0, left_m).position();
        let actor = CrossingActor {
            token: self.token(),
            kind,
            size,
            from: beside(path.from_left_m),
            to: beside(path.to_left_m),
            speed: path.speed,
            along: Arc::new(self.lanes.path.centerline.clone()),
            at_s: self.lanes.start_s + path.ahead_m,
            trigger_m: path.trigger_m,
        };
        self.crossing.push(actor);
        Ok(())
    }

    /// How far the recorded driver gets along the ego's path, meters from the start.
    pub(super) fn driven_m(&self) -> f64 {
        let line = &self.lanes.path.centerline;
        let end = self
            .scenario
            .expert()
            .last()
            .map_or(self.lanes.start_s, |ego| {
                line.project(ego.center().position()).s
            });
        end - self.lanes.start_s
    }

    /// Speed limit of a lane, m/s; where it has none, that of the ego's path or a usual one.
    pub(super) fn limit(&self, lane: LaneId) -> f64 {
        /// nuPlan's IDM agents drive so fast where a lane has no limit, m/s.
        const FALLBACK: f64 = 10.0;
        let map = &self.scenario.map;
        let of_path = || {
            self.lanes
                .path
                .lanes
                .iter()
                .find_map(|&lane| map[lane].speed_limit)
        };
        map[lane]
            .speed_limit
            .filter(|&limit| limit > 0.0)
            .or_else(of_path)
            .unwrap_or(FALLBACK)
    }
}
