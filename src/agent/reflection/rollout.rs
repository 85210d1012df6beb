//! Rolls plans out: IDM along the path of the plan, behind the lead object.

use super::idm_plan::IdmPlan;
use super::ride::{Ride, Smoothed};
use super::road::{LeadOnPath, Road};
use crate::reasoning::{DECELERATIONS, PlannerCode};
use planagent_score::pdm::SPEED_FRACTIONS;
use planagent_world::dynamics::IdmParameters;
use planagent_world::geometry::Pose;
use planagent_world::{
    EgoState, STEP_S, STEP_US, SceneView, Trajectory, TrajectoryError, TrajectoryState,
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

/// A version of a plan: slower, or to the side within its lane, by the fractions and offsets of
/// PDM-Closed's proposals, or a hard stop. The first is the plan itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Version {
    /// Index of its path in [`planagent_score::pdm::LATERAL_OFFSETS`].
    path: usize,
    /// Its share of the desired speed.
    fraction: f64,
    /// Whether it comes to that speed, from above or below, as fast as the code allows, whatever the
    /// ride.
    /// Why: docs/decisions/156-brisk-versions-stay.md.
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
    /// The roll-out as a trajectory from the present time on. It begins on the path and not at the
    /// ego: the tracker has to see how far the ego is off it, as Reflection's simulation does.
    ///
    /// # Errors
    /// When a pose is not finite.
    /// Why: docs/decisions/155-from-the-path.md.
    pub fn to_trajectory(&self, ego: &EgoState) -> Result<Trajectory, TrajectoryError> {
        let states = self.poses.iter().zip(&self.speeds).enumerate();
        let states = states.map(|(i, (&rear_axle, &speed))| {
            let Some(before) = i.checked_sub(1) else {
                let now = TrajectoryState::from(ego);
                return TrajectoryState { rear_axle, ..now };
            };
            let accel = (speed - self.speeds[before]) / STEP_S;
            TrajectoryState::moving(ego.time_us + i as i64 * STEP_US, rear_axle, speed, accel)
        });
        Trajectory::new(states.collect())
    }

    /// Length of the path, meters.
    pub fn distance(&self) -> f64 {
        self.poses.windows(2).map(|w| w[0].distance(&w[1])).sum()
    }
}

#[cfg(test)]
mod tests {
    use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
    use crate::reasoning::PlannerCode;
    use crate::reflection::{LeadPolicy, PlanBuilder, Ride};
    use planagent_world::dynamics::{JerkPenalty, follow, simulate_proposal};
    use planagent_world::{STEP_US, Scene, SceneView};

    #[test]
    fn the_ego_drives_a_lane_change_as_its_first_roll_out_was_simulated() {
        let scene = Scene::builder()
            .lanes(2, [[-50.0, 0.0], [250.0, 0.0]])
            .ego([0.0, -3.5], 0.0, 12.0)
            .build()
            .unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride: Ride::Comfortable,
            horizon_s: 8.0,
        };
        let code = PlannerCode {
            centerline: CenterlineName::LeftLane,
            lead_agent: None,
            target_speed: 12.0,
            accel_max: 1.5,
            decel_max: 3.0,
        };
        let plan = builder
            .build(GraphedScene::new(&view, &graph), code)
            .unwrap()
            .unwrap();
        let judged = simulate_proposal(
            view.ego,
            &plan.roll_out(&view, 40).poses,
            JerkPenalty::PdmClosed,
        );
        let mut ego = *view.ego;
        let between_two_calls = 1..=20;
        for state in &judged[between_two_calls] {
            let now = SceneView { ego: &ego, ..view };
            let trajectory = plan.roll_out(&now, 80).to_trajectory(&ego).unwrap();
            ego = follow(&ego, &trajectory, STEP_US).unwrap();
            let off = (ego.rear_axle.y - state.rear_axle.y).abs();
            assert!(off < 0.02, "{off} m beside it at {} µs", ego.time_us);
        }
        assert!(ego.rear_axle.y > -2.5, "it changes lanes");
    }
}
