//! How a plan drives: as its code says, or as a passenger would accept.

use planagent_world::dynamics::{IdmParameters, Lead};
use planagent_world::geometry::{Polyline, wrap_angle};
use planagent_world::{EgoState, PACIFICA, STEP_S};

/// The highest forward acceleration of the ego's center while it turns, m/s² (nuPlan's bound is
/// 2.40).
/// Why: docs/decisions/128-comfortable-plans.md.
const TURN_ACCEL: f64 = 2.0;
/// Length of lane over which a bend is measured, meters: before and behind a place.
const BEND_WINDOW: f64 = 3.0;
/// Time ahead for which the sharpest bend counts, seconds.
const BEND_PREVIEW_S: f64 = 0.6;
/// Change of the yaw rate on the way into a bend, a share of it per second.
const TURN_CHANGE: f64 = 0.6;

/// Maximum jerk of a roll-out, m/s³.
/// Why: docs/decisions/128-comfortable-plans.md.
const MAX_JERK: f64 = 2.0;
/// A lead object that needs more than this deceleration is braked for at any jerk, m/s².
const URGENT_DECEL: f64 = 2.0;
/// Part of the gap that such a stop leaves, meters.
const URGENT_GAP: f64 = 0.5;
/// The hardest braking because the desired speed is lower, m/s².
/// Why: docs/decisions/128-comfortable-plans.md.
const SPEED_DECEL: f64 = 1.0;
/// Below this speed an ego that brakes stands, m/s: its deceleration ends there.
const STANDS: f64 = 0.1;

/// How the plan of a code drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Ride {
    /// IDM from the first step on, whatever the ego did before, and at the desired speed through
    /// bends.
    Idm,
    /// IDM that starts from the ego's own acceleration and limits its jerk, unless a collision asks
    /// for more, and speeds up less while the ego turns.
    /// Why: docs/decisions/128-comfortable-plans.md.
    Comfortable,
}

/// The bends along a path.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Bends {
    /// The curvature at each meter of the path, 1/m; empty where bends do not matter.
    curvature: Vec<f64>,
}

impl Bends {
    /// Those of `line` from arc length `from` on, for `length` meters.
    pub(super) fn along(line: &Polyline, from: f64, length: f64) -> Self {
        let curvature = |ahead: usize| {
            let s = from + ahead as f64;
            let (before, behind) = (
                (s - BEND_WINDOW).max(0.0),
                (s + BEND_WINDOW).min(line.length()),
            );
            if behind - before < BEND_WINDOW {
                return 0.0;
            }
            let heading = |s| line.smooth_pose_at(s).heading;
            wrap_angle(heading(behind) - heading(before)).abs() / (behind - before)
        };
        Self {
            curvature: (0..=length.ceil() as usize).map(curvature).collect(),
        }
    }

    /// The highest acceleration that they allow at `speed` after `progress` meters, m/s². In a turn
    /// nuPlan adds a part to the forward acceleration of the ego's center
    /// ([`EgoState::center_acceleration`]), which this leaves [`TURN_ACCEL`].
    pub(super) fn acceleration(&self, progress: f64, speed: f64) -> f64 {
        let here = progress.max(0.0) as usize;
        let ahead = (progress + speed * BEND_PREVIEW_S).max(0.0) as usize;
        let near = self
            .curvature
            .iter()
            .skip(here)
            .take((ahead + 1).saturating_sub(here));
        let Some(sharpest) = near.copied().reduce(f64::max) else {
            return f64::INFINITY;
        };
        let yaw_rate = speed * sharpest;
        let of_turn = PACIFICA.rear_axle_to_center() * yaw_rate * (yaw_rate + TURN_CHANGE);
        (TURN_ACCEL - of_turn).max(0.0)
    }
}

/// The state of a comfortable roll-out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothed {
    /// Acceleration of the step before, m/s².
    accel: f64,
}

impl Smoothed {
    /// From the ego's own acceleration on. Urgent braking ends at any jerk, as it begins: else the
    /// ego comes to a stop before what it could still pass.
    pub(super) fn from_ego(ego: &EgoState) -> Self {
        Self {
            accel: ego.acceleration.x.max(-URGENT_DECEL),
        }
    }

    /// The acceleration of the next step, m/s².
    pub(super) fn step(
        &mut self,
        idm: IdmParameters,
        bends: &Bends,
        (progress, speed): (f64, f64),
        lead: Option<Lead>,
    ) -> f64 {
        let wanted = gentle(idm, speed)
            .acceleration(speed, lead)
            .min(bends.acceleration(progress, speed));
        let before = if speed < STANDS {
            self.accel.max(0.0)
        } else {
            self.accel
        };
        let step = MAX_JERK * STEP_S;
        let least = if lead.is_some_and(|lead| is_urgent(lead, speed)) {
            wanted
        } else {
            before - step
        };
        self.accel = wanted.max(least).min(least.max(before + step));
        self.accel
    }
}

/// The same law, which brakes by [`SPEED_DECEL`] at most for its desired speed.
fn gentle(idm: IdmParameters, speed: f64) -> IdmParameters {
    let share = 1.0 + SPEED_DECEL / idm.accel_max;
    let target_velocity = idm
        .target_velocity
        .max(speed / share.powf(f64::from(idm.exponent).recip()));
    IdmParameters {
        target_velocity,
        ..idm
    }
}

/// Whether the ego must brake hard to stay behind a lead object.
fn is_urgent(lead: Lead, speed: f64) -> bool {
    let closing = (speed - lead.speed).max(0.0);
    closing * closing > 2.0 * URGENT_DECEL * (lead.gap - URGENT_GAP).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
    use crate::reasoning::PlannerCode;
    use crate::reflection::{LeadPolicy, PlanBuilder, Rollout};
    use planagent_world::{ObjectKind, Scene, SceneBuilder};
    use std::f64::consts::FRAC_PI_2;

    const RADIUS: f64 = 12.0;

    /// A lane to the east that turns to the north at x = 60, and the ego at its start.
    fn bend(speed: f64) -> SceneBuilder {
        let arc = (1..=24).map(|i| {
            let angle = FRAC_PI_2 * f64::from(i) / 24.0;
            [60.0 + RADIUS * angle.sin(), RADIUS - RADIUS * angle.cos()]
        });
        let points: Vec<[f64; 2]> = [[-20.0, 0.0], [60.0, 0.0]]
            .into_iter()
            .chain(arc)
            .chain([[60.0 + RADIUS, 150.0]])
            .collect();
        Scene::builder().lane(points).ego([0.0, 0.0], 0.0, speed)
    }

    fn roll_out(scene: SceneBuilder, ride: Ride, target_speed: f64, steps: usize) -> Rollout {
        let scene = scene.build().unwrap();
        let view = scene.view();
        let graph = LaneGraph::build(&view, DEFAULT_NODE_LENGTH).unwrap();
        let code = PlannerCode {
            centerline: CenterlineName::EgoLane,
            lead_agent: None,
            target_speed,
            accel_max: 1.5,
            decel_max: 3.0,
        };
        let builder = PlanBuilder {
            lead_policy: LeadPolicy::Nearest,
            ride,
            // The end of a short path is followed like what stands there.
            horizon_s: 20.0,
        };
        builder
            .build(GraphedScene::new(&view, &graph), code)
            .unwrap()
            .unwrap()
            .roll_out(&view, steps)
    }

    fn accelerations(rollout: &Rollout) -> Vec<f64> {
        rollout
            .speeds
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) / STEP_S)
            .collect()
    }

    fn least(values: &[f64]) -> f64 {
        values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_comfortable_plan_speeds_up_less_while_it_turns_and_idm_does_not() {
        let of = |ride| {
            let near = bend(6.0).ego([48.0, 0.0], 0.0, 6.0);
            let rollout = roll_out(near, ride, 14.0, 60);
            let accelerations = accelerations(&rollout);
            let steps = rollout
                .poses
                .iter()
                .zip(&rollout.speeds)
                .zip(&accelerations);
            let turning = steps.filter(|((pose, _), _)| pose.heading > 0.3 && pose.heading < 1.2);
            let center = turning.map(|((_, speed), accel)| {
                let yaw_rate = speed / RADIUS;
                accel + PACIFICA.rear_axle_to_center() * yaw_rate * yaw_rate
            });
            let most = accelerations.iter().copied().fold(0.0, f64::max);
            (center.fold(0.0, f64::max), most)
        };
        let (comfortable, idm) = (of(Ride::Comfortable), of(Ride::Idm));
        assert!(
            comfortable.1 > 1.0 && idm.1 > 1.0,
            "{comfortable:?} {idm:?}"
        );
        assert!(comfortable.0 < TURN_ACCEL, "{comfortable:?}");
        assert!(idm.0 > TURN_ACCEL + 0.1, "{idm:?}");
    }

    #[test]
    fn a_comfortable_plan_comes_gently_down_to_a_lower_speed() {
        let of = |ride| {
            let rollout = roll_out(bend(8.0), ride, 5.0, 40);
            accelerations(&rollout)
        };
        let (comfortable, idm) = (of(Ride::Comfortable), of(Ride::Idm));
        assert!(least(&comfortable) > -1.2 * SPEED_DECEL, "{comfortable:?}");
        assert!(least(&idm) < -2.5, "{idm:?}");
        let jerks = comfortable
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).abs() / STEP_S);
        let most = jerks.fold(comfortable[0].abs() / STEP_S, f64::max);
        assert!(most < MAX_JERK + 1e-6, "{most}");
    }

    #[test]
    fn a_comfortable_plan_leaves_the_acceleration_of_the_ego_gently_and_urgent_braking_at_once() {
        let scene = bend(8.0).build().unwrap();
        let first = |own: f64| {
            let mut ego = *scene.view().ego;
            ego.acceleration.x = own;
            let scene = bend(8.0).ego_state(ego);
            accelerations(&roll_out(scene, Ride::Comfortable, 11.0, 5))[0]
        };
        let step = MAX_JERK * STEP_S;
        for own in [-1.5, 0.5] {
            assert!(
                (first(own) - own - step).abs() < 1e-6,
                "{own}: {}",
                first(own)
            );
        }
        let urgent = first(-6.0);
        assert!((urgent + URGENT_DECEL - step).abs() < 1e-6, "{urgent}");
    }

    #[test]
    fn a_comfortable_plan_brakes_at_once_where_a_lead_object_needs_it() {
        let near = bend(9.0).vehicle([19.0, 0.0], 0.0, 0.0);
        let braking = accelerations(&roll_out(near, Ride::Comfortable, 9.0, 20));
        assert!(braking[0] < -2.9, "{braking:?}");
        let far = bend(9.0).vehicle([55.0, 0.0], 0.0, 0.0);
        let braking = accelerations(&roll_out(far, Ride::Comfortable, 9.0, 20));
        assert!(braking[0] > -0.3, "{braking:?}");
    }

    #[test]
    fn a_comfortable_plan_waits_for_who_walks_across_and_the_papers_does_not() {
        use ObjectKind::{Pedestrian, Vehicle};
        // All have crossed the lane within eight seconds.
        let speed_then = |kind, ride| {
            let road = Scene::builder().lane([[-50.0, 0.0], [250.0, 0.0]]);
            let crossed = road
                .ego([0.0, 0.0], 0.0, 8.0)
                .object(kind, [40.0, -9.0], FRAC_PI_2, 3.0);
            roll_out(crossed, ride, 8.0, 80).speeds[80]
        };
        let waits = speed_then(Pedestrian, Ride::Comfortable);
        assert!(waits < 1.5, "{waits}");
        for (kind, ride) in [(Pedestrian, Ride::Idm), (Vehicle, Ride::Comfortable)] {
            let speed = speed_then(kind, ride);
            assert!(speed > 5.0, "{kind} {ride:?}: {speed}");
        }
    }
}
