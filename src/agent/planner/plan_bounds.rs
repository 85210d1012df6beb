//! Bounds of a plan that code outside this program made: a command, or Python.
//!
//! The tracker of nuPlan's closed loop follows any states, also those that no vehicle reaches: the
//! ego then drives off at the limits of its actuators, and the fault looks like bad driving. A
//! plan in another frame or of another step is the usual cause.

use planagent_world::{EgoState, MICROS_PER_SECOND, Trajectory};

/// Distance by which a plan may miss the ego, and two states each other beyond what speed
/// explains, meters: about the ego's length. A reference point other than the rear axle and a plan
/// that is a second old stay within it.
const MAX_GAP_M: f64 = 5.0;
/// Speed from one state to the next, m/s: twice that of the fastest road traffic.
const MAX_SPEED: f64 = 100.0;

/// A plan that leaves the ego.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlanJump {
    /// At the present time, the plan is elsewhere.
    #[error(
        "the plan is {distance_m:.1} m away from the ego now, and {MAX_GAP_M} m are the limit; its states must be the rear axle \
         in the map frame, and begin at the ego"
    )]
    Start {
        /// From the ego's rear axle, meters.
        distance_m: f64,
    },
    /// Two states are farther apart than a vehicle drives between them.
    #[error(
        "the plan jumps {distance_m:.1} m in {time_s:.2} s to its state at {t_s:.2} s, and {MAX_GAP_M} m and {MAX_SPEED} m/s are the \
         limit; its states must be the rear axle in the map frame"
    )]
    Step {
        /// Between the two states, meters.
        distance_m: f64,
        /// Between the two states, seconds.
        time_s: f64,
        /// Time of the second state from now, seconds.
        t_s: f64,
    },
}

/// Checks that a plan starts at the ego and moves as a vehicle can.
pub fn check_plan(plan: &Trajectory, ego: &EgoState) -> Result<(), PlanJump> {
    let seconds = |us: i64| us as f64 / MICROS_PER_SECOND;
    // A plan that does not cover the present is the tracker's error.
    if let Ok(now) = plan.at(ego.time_us) {
        let distance_m = now.rear_axle.distance(&ego.rear_axle);
        if distance_m > MAX_GAP_M {
            return Err(PlanJump::Start { distance_m });
        }
    }
    for pair in plan.states().windows(2) {
        let [from, to] = pair else { continue };
        let distance_m = to.rear_axle.distance(&from.rear_axle);
        let time_s = seconds(to.time_us - from.time_us);
        if distance_m > MAX_GAP_M + MAX_SPEED * time_s {
            let t_s = seconds(to.time_us - ego.time_us);
            return Err(PlanJump::Step {
                distance_m,
                time_s,
                t_s,
            });
        }
    }
    Ok(())
}
