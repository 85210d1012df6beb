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

/// Angle by which a plan may turn from the ego's heading within [`TURN_S`], degrees: no vehicle turns
/// so far, and headings in degrees or of another axis do.
const MAX_TURN_DEG: f64 = 90.0;
const TURN_S: f64 = 1.0;

/// Longest time from now to a state, seconds. The tracker looks at every tenth of a second of a plan,
/// so one of a year would never end.
const MAX_TIME_S: f64 = 600.0;

/// A plan that leaves the ego.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlanJump {
    /// The plan has a state in another age.
    #[error("the plan has a state {t_s:.0} s from now, and {MAX_TIME_S} s are the limit")]
    Far {
        /// Time of the state from now, seconds.
        t_s: f64,
    },
    /// At the present time, the plan is elsewhere.
    #[error(
        "the plan is {distance_m:.1} m away from the ego now, and {MAX_GAP_M} m are the limit; its states must be the rear axle \
         in the map frame, and begin at the ego"
    )]
    Start {
        /// From the ego's rear axle, meters.
        distance_m: f64,
    },
    /// The plan heads elsewhere.
    #[error(
        "the plan heads {turn_deg:.0} degrees away from the ego at {t_s:.2} s, and {MAX_TURN_DEG} degrees within {TURN_S} s are the \
         limit; a heading is in radians, counter-clockwise from the x axis of the map"
    )]
    Turn {
        /// Between the headings of the ego and of the state, degrees.
        turn_deg: f64,
        /// Time of the state from now, seconds.
        t_s: f64,
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
    for state in plan.states() {
        let t_s = seconds(state.time_us.saturating_sub(ego.time_us));
        if t_s.abs() > MAX_TIME_S {
            return Err(PlanJump::Far { t_s });
        }
    }
    // A plan that does not cover the present is the tracker's error.
    if let Ok(now) = plan.at(ego.time_us) {
        let distance_m = now.rear_axle.distance(&ego.rear_axle);
        if distance_m > MAX_GAP_M {
            return Err(PlanJump::Start { distance_m });
        }
    }
    for state in plan.states() {
        let t_s = seconds(state.time_us - ego.time_us);
        let turn = state.rear_axle.heading - ego.rear_axle.heading;
        let turn_deg = turn.sin().atan2(turn.cos()).abs().to_degrees();
        if (0.0..=TURN_S).contains(&t_s) && turn_deg > MAX_TURN_DEG {
            return Err(PlanJump::Turn { turn_deg, t_s });
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

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::TrajectoryState;
    use planagent_world::geometry::{Pose, Vector};

    fn state(t_s: f64, heading: f64) -> TrajectoryState {
        TrajectoryState {
            time_us: (t_s * MICROS_PER_SECOND) as i64,
            rear_axle: Pose::new(0.0, 0.0, heading),
            velocity: Vector::new(0.0, 0.0),
            acceleration: Vector::new(0.0, 0.0),
            steering_angle: 0.0,
        }
    }

    #[test]
    fn a_plan_heads_where_the_ego_does() {
        let still = Vector::new(0.0, 0.0);
        let ego = EgoState::from_log(0, Pose::new(0.0, 0.0, 3.0), still, still);
        let checked = |headings: [f64; 2]| {
            let states = vec![state(0.0, headings[0]), state(0.5, headings[1])];
            check_plan(&Trajectory::new(states).unwrap(), &ego)
        };
        // A whole turn more is the same heading.
        for headings in [
            [3.0, 3.1],
            [3.0, -3.1],
            [3.0 - std::f64::consts::TAU, 3.0],
            [2.0, 4.0],
        ] {
            assert_eq!(checked(headings), Ok(()), "{headings:?}");
        }
        for headings in [[100.0, 100.0], [0.0, 0.0], [3.0, 1.0]] {
            let error = checked(headings).unwrap_err();
            assert!(
                matches!(error, PlanJump::Turn { .. }),
                "{headings:?}: {error}"
            );
        }
    }

    #[test]
    fn a_plan_of_years_is_refused_before_it_is_followed() {
        let still = Vector::new(0.0, 0.0);
        let ego = EgoState::from_log(0, Pose::new(0.0, 0.0, 0.0), still, still);
        for far_s in [601.0, -601.0, 1e9, 1e30] {
            let mut states = vec![state(0.0, 0.0), state(far_s, 0.0)];
            states.sort_by_key(|state| state.time_us);
            let error = check_plan(&Trajectory::new(states).unwrap(), &ego).unwrap_err();
            assert!(matches!(error, PlanJump::Far { .. }), "{error}");
        }
    }
}
