//! One reactive vehicle: its path, progress and speed (devkit `idm_agent.py`).

use super::footprint::Footprint;
use crate::dynamics::idm::{IdmParameters, Lead};
use crate::dynamics::progress_path::ProgressPath;
use crate::geometry::{OrientedBox, Polyline, Pose};
use crate::{LaneId, LaneMap, ObjectKind, SignalStatus, TrackToken, TrackedObject, TrafficLights};
use std::collections::VecDeque;
use std::sync::Arc;

/// Path length ahead of an agent in addition to its headway, meters.
const MIN_PATH_LENGTH: f64 = 20.0;
/// Duration of a lane change, seconds, its least length, meters, and the poses on the way.
const LANE_CHANGE_S: f64 = 3.0;
const MIN_LANE_CHANGE_LENGTH: f64 = 15.0;
const LANE_CHANGE_POSES: u32 = 30;
/// Segments of its route that an agent keeps.
const ROUTE_SEGMENTS: usize = 5;

/// A vehicle on its path. Its size stays that of iteration 0.
#[derive(Debug, Clone)]
pub(super) struct IdmAgent {
    token: TrackToken,
    length: f64,
    width: f64,
    idm: IdmParameters,
    route: VecDeque<LaneId>,
    path: Arc<ProgressPath>,
    /// Meters along the path; may run a little past its end, where the pose stays.
    progress: f64,
    speed: f64,
    footprint: Arc<Footprint>,
}

impl IdmAgent {
    /// An agent for a recorded vehicle, snapped to the baseline of `lane`; `None` when that
    /// baseline makes no path.
    pub(super) fn snapped(
        vehicle: &TrackedObject,
        speed: f64,
        map: &LaneMap,
        lane: LaneId,
        idm: IdmParameters,
    ) -> Option<Self> {
        let baseline = &map[lane].centerline;
        let center = vehicle.shape.center.position();
        let snapped = vehicle.shape.moved_to(baseline.nearest_pose(center));
        Some(Self {
            token: vehicle.token,
            length: vehicle.shape.length,
            width: vehicle.shape.width,
            idm,
            route: VecDeque::from([lane]),
            path: Arc::new(ProgressPath::new(&baseline.vertex_poses())?),
            progress: baseline.project(center).s,
            speed,
            footprint: Arc::new(Footprint::of_box(snapped)),
        })
    }

    /// Its recorded track.
    pub(super) fn token(&self) -> TrackToken {
        self.token
    }

    /// Speed along the path, m/s.
    pub(super) fn speed(&self) -> f64 {
        self.speed
    }

    /// The segments of its route, the oldest first.
    pub(super) fn route(&self) -> impl Iterator<Item = LaneId> {
        self.route.iter().copied()
    }

    /// Its footprint after the previous step.
    pub(super) fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// Pose of its center.
    pub(super) fn pose(&self) -> Pose {
        self.path.pose_at(self.progress)
    }

    /// Its length, meters.
    pub(super) fn length(&self) -> f64 {
        self.length
    }

    /// The parameters of its law.
    pub(super) fn law(&self) -> &IdmParameters {
        &self.idm
    }

    /// The lane of its route that holds its center.
    pub(super) fn lane(&self, map: &LaneMap) -> Option<LaneId> {
        let center = self.pose().position();
        self.route()
            .find(|&lane| map[lane].polygon.contains(center))
    }

    /// Turns into a lane beside its own: over the next seconds the path goes over to the baseline
    /// there. False where the lane is too short for that.
    pub(super) fn change_lane(&mut self, map: &LaneMap, target: LaneId) -> bool {
        let line = &map[target].centerline;
        let foot = line.project(self.pose().position());
        let over = (self.speed * LANE_CHANGE_S).max(MIN_LANE_CHANGE_LENGTH);
        if foot.s + over > line.length() {
            return false;
        }
        // A smooth step from the lateral offset to 0, then the rest of the baseline.
        let blend = |i: u32| {
            let share = f64::from(i) / f64::from(LANE_CHANGE_POSES);
            let left = foot.lateral * (1.0 - share * share * (3.0 - 2.0 * share));
            line.frenet_to_map(foot.s + over * share, left)
        };
        let changing = (0..=LANE_CHANGE_POSES).map(blend);
        let rest = line
            .vertices()
            .iter()
            .zip(line.arc_lengths())
            .filter(|&(_, &s)| s > foot.s + over)
            .map(|(&p, _)| p);
        let Ok(whole) = Polyline::new(changing.chain(rest)) else {
            return false;
        };
        let Some(path) = ProgressPath::new(&whole.vertex_poses()) else {
            return false;
        };
        self.path = Arc::new(path);
        self.progress = 0.0;
        let own = self.lane(map);
        self.route = own.into_iter().chain([target]).collect();
        true
    }

    pub(super) fn shape(&self) -> OrientedBox {
        OrientedBox::new(self.pose(), self.length, self.width)
    }

    /// The agent as an object of the scene.
    pub(super) fn object(&self) -> TrackedObject {
        let shape = self.shape();
        let velocity = shape.center.direction() * self.speed;
        TrackedObject {
            token: self.token,
            kind: ObjectKind::Vehicle,
            shape,
            velocity,
        }
    }

    /// Appends lanes until the path is long enough: of those that may be entered, the one that
    /// bends least at its start. An edge with traffic lights may be entered when it shows green,
    /// any other when it does not show red. An agent that stands at the very end of its path starts
    /// the longer one at the last pose but one, as in nuPlan.
    pub(super) fn extend_route(&mut self, map: &LaneMap, lights: &TrafficLights) {
        while self.path.length() - self.progress
            < MIN_PATH_LENGTH + self.idm.target_velocity * self.idm.headway
        {
            let Some(&last) = self.route.back() else {
                return;
            };
            let may_enter = |lane: &LaneId| {
                let status = lights.status(*lane);
                if map[*lane].has_traffic_lights {
                    status == Some(SignalStatus::Green)
                } else {
                    status != Some(SignalStatus::Red)
                }
            };
            let bend = |lane: &LaneId| map[*lane].centerline.curvature_at(0.0).abs();
            let open = map[last].outgoing.iter().copied().filter(may_enter);
            let Some(next) = open.min_by(|a, b| bend(a).total_cmp(&bend(b))) else {
                return;
            };
            let mut poses = self.path.between(self.progress, self.path.length());
            poses.extend(map[next].centerline.vertex_poses());
            let Some(path) = ProgressPath::new(&poses) else {
                return;
            };
            self.path = Arc::new(path);
            self.progress = 0.0;
            // Stop lines are sought along the route, and those of lanes far behind no longer
            // matter.
            if self.route.len() == ROUTE_SEGMENTS {
                self.route.pop_front();
            }
            self.route.push_back(next);
        }
    }

    /// The strip of its width from its center to the end of its path. At the very end it is the
    /// last piece of the path, which lies behind its center.
    pub(super) fn path_ahead(&self) -> Option<Footprint> {
        Footprint::of_strip(
            &self.path.between(self.progress, self.path.length()),
            self.width / 2.0,
        )
    }

    /// Moves for `dt` seconds behind `lead`; without one, the end of its path is a standing
    /// obstacle.
    pub(super) fn propagate(&mut self, lead: Option<Lead>, map: &LaneMap, dt: f64) {
        if let Some(limit) = self
            .route
            .back()
            .and_then(|&lane| map[lane].speed_limit)
            .filter(|&limit| limit > 0.0)
        {
            self.idm.target_velocity = limit;
        }
        let path_end = Lead {
            gap: self.path.length() - self.progress - self.length / 2.0,
            speed: 0.0,
        };
        let acceleration = self
            .idm
            .acceleration(self.speed, Some(lead.unwrap_or(path_end)));
        self.progress += dt * self.speed;
        self.speed = (self.speed + dt * acceleration).max(0.0);
        self.footprint = Arc::new(self.projected_footprint());
    }

    /// Its box and the strip that it covers within its headway.
    fn projected_footprint(&self) -> Footprint {
        let from = self.progress - self.length / 2.0;
        let to = self.progress + self.length / 2.0 + self.speed * self.idm.headway;
        let own = Footprint::of_box(self.shape());
        match Footprint::of_strip(&self.path.between(from, to), self.width / 2.0) {
            Some(strip) => own.united(strip),
            None => own,
        }
    }
}
