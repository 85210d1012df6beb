//! nuPlan's two-stage ego controller: an LQR tracker and a kinematic bicycle (devkit
//! `two_stage_controller.py`), for one step of a planned trajectory or for a whole proposal.

use super::bicycle::advance;
use super::lqr::{TrackingError, command, track};
use super::profile::{JerkPenalty, MotionProfile};
use crate::geometry::Pose;
use crate::{EgoState, STEP_US, Trajectory};

/// The ego after it followed `trajectory` for `dt_us` microseconds. nuPlan takes the step from the
/// timestamps of the log.
///
/// # Errors
/// When the trajectory does not cover the step or lasts less than 0.1 s.
pub fn follow(
    ego: &EgoState,
    trajectory: &Trajectory,
    dt_us: i64,
) -> Result<EgoState, TrackingError> {
    trajectory.at(ego.time_us + dt_us)?;
    Ok(advance(ego, track(ego, trajectory)?, dt_us))
}

/// Rolls an ego out along a fixed reference of rear-axle poses 0.1 s apart, the first at the time
/// of `start`: PDM-Closed's proposal simulation (`tuplan_garage`'s `pdm_simulator.py`). The
/// profiles are fitted once, and the pose with the same index is tracked without interpolation.
/// Returns as many states as poses, `start` first; with fewer than two poses `start` alone.
pub fn simulate_proposal(
    start: &EgoState,
    reference: &[Pose],
    penalty: JerkPenalty,
) -> Vec<EgoState> {
    let mut states = Vec::with_capacity(reference.len().max(1));
    states.push(*start);
    let Some(profile) = MotionProfile::fit(reference, penalty) else {
        return states;
    };
    let mut ego = *start;
    for (step, &target) in reference[..reference.len() - 1].iter().enumerate() {
        ego = advance(&ego, command(&ego, target, &profile, step as f64), STEP_US);
        states.push(ego);
    }
    states
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrajectoryState;
    use crate::dynamics::lqr::TrackingError;
    use crate::geometry::Vector;
    use serde_json::Value;

    /// Deviation allowed from the recorded states; the pseudo-inverse upstream itself is good to
    /// about 4e-7.
    const TOLERANCE: f64 = 1e-6;

    fn fixture(name: &str) -> Value {
        let path = format!(
            "{}/../../tests/fixtures/vectors/{name}",
            env!("CARGO_MANIFEST_DIR")
        );
        serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
    }

    fn number(row: &Value, key: &str) -> f64 {
        row[key].as_f64().unwrap()
    }

    fn state(row: &Value) -> EgoState {
        EgoState {
            time_us: row["time_us"].as_i64().unwrap(),
            rear_axle: Pose::new(number(row, "x"), number(row, "y"), number(row, "heading")),
            velocity: Vector::new(number(row, "vx"), number(row, "vy")),
            acceleration: Vector::new(number(row, "ax"), number(row, "ay")),
            steering_angle: number(row, "steer"),
            steering_rate: number(row, "steer_rate"),
            angular_velocity: number(row, "ang_vel"),
            angular_acceleration: number(row, "ang_acc"),
        }
    }

    fn columns(ego: &EgoState) -> [f64; 11] {
        let p = ego.rear_axle;
        let (v, a) = (ego.velocity, ego.acceleration);
        let steering = [ego.steering_angle, ego.steering_rate];
        let turning = [ego.angular_velocity, ego.angular_acceleration];
        [
            p.x,
            p.y,
            p.heading,
            v.x,
            v.y,
            a.x,
            a.y,
            steering[0],
            steering[1],
            turning[0],
            turning[1],
        ]
    }

    fn deviation(a: &[f64], b: &[f64]) -> f64 {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn follows_the_recorded_controller() {
        let vectors = fixture("two_stage_controller.json");
        let cases = vectors["cases"].as_array().unwrap();
        assert_eq!(cases.len(), 6);
        for case in cases {
            let states = case["trajectory"]
                .as_array()
                .unwrap()
                .iter()
                .map(|row| TrajectoryState::from(&state(row)));
            let trajectory = Trajectory::new(states.collect()).unwrap();
            let mut ego = state(&case["initial_state"]);
            for (k, step) in case["steps"].as_array().unwrap().iter().enumerate() {
                let command = track(&ego, &trajectory).unwrap();
                let commands = [command.acceleration, command.steering_rate];
                let wanted = [number(step, "accel_cmd"), number(step, "steering_rate_cmd")];
                assert!(
                    deviation(&commands, &wanted) < TOLERANCE,
                    "{} step {k}: {commands:?} {wanted:?}",
                    case["name"]
                );
                ego = follow(&ego, &trajectory, STEP_US).unwrap();
                let expected = state(&step["next_state"]);
                assert_eq!(ego.time_us, expected.time_us);
                let off = deviation(&columns(&ego), &columns(&expected));
                assert!(off < TOLERANCE, "{} step {k}: off by {off}", case["name"]);
                let center = ego.center();
                let wanted = &step["next_state"];
                assert!((center.x - number(wanted, "center_x")).abs() < TOLERANCE);
                assert!(
                    (ego.center_acceleration().x - number(wanted, "center_ax")).abs() < TOLERANCE
                );
            }
        }
    }

    #[test]
    fn fits_the_recorded_profiles() {
        for case in fixture("two_stage_controller.json")["cases"]
            .as_array()
            .unwrap()
        {
            let list = |key: &str| -> Vec<f64> {
                serde_json::from_value(case["fit"][key].clone()).unwrap()
            };
            let poses: Vec<[f64; 3]> =
                serde_json::from_value(case["fit"]["poses"].clone()).unwrap();
            let poses: Vec<Pose> = poses
                .iter()
                .map(|&[x, y, heading]| Pose::new(x, y, heading))
                .collect();
            let profile = MotionProfile::fit(&poses, JerkPenalty::AccelerationDifferences).unwrap();
            let (velocity, curvature) = (list("velocity"), list("curvature"));
            assert_eq!(profile.velocity().len(), velocity.len());
            assert!(
                deviation(profile.velocity(), &velocity) < TOLERANCE,
                "{}",
                case["name"]
            );
            assert!(
                deviation(profile.curvature(), &curvature) < TOLERANCE,
                "{}",
                case["name"]
            );
        }
    }

    #[test]
    fn simulates_the_recorded_proposals() {
        let vectors = fixture("pdm_proposals.json");
        for case in vectors["cases"].as_array().unwrap() {
            let ego = &case["ego"];
            let start = EgoState::from_log(
                0,
                Pose::new(number(ego, "x"), number(ego, "y"), number(ego, "heading")),
                Vector::new(number(ego, "vx"), 0.0),
                Vector::new(number(ego, "ax"), 0.0),
            );
            let every = case["simulated_every"].as_u64().unwrap() as usize;
            let proposals: Vec<Vec<[f64; 3]>> =
                serde_json::from_value(case["proposals_se2"].clone()).unwrap();
            let simulated: Vec<Vec<[f64; 11]>> =
                serde_json::from_value(case["simulated"].clone()).unwrap();
            assert_eq!((proposals.len(), simulated.len()), (15, 15));
            for (proposal, expected) in proposals.iter().zip(&simulated) {
                let reference: Vec<Pose> = proposal
                    .iter()
                    .map(|&[x, y, heading]| Pose::new(x, y, heading))
                    .collect();
                let states = simulate_proposal(&start, &reference, JerkPenalty::PdmClosed);
                assert_eq!(states.len(), 41);
                for (ego, expected) in states.iter().step_by(every).zip(expected) {
                    let off = deviation(&columns(ego), expected);
                    assert!(off < TOLERANCE, "{}: off by {off}", case["name"]);
                }
            }
        }
    }

    #[test]
    fn a_proposal_without_motion_is_its_start() {
        let start = EgoState::from_log(7, Pose::default(), Vector::zeros(), Vector::zeros());
        assert_eq!(
            simulate_proposal(&start, &[], JerkPenalty::default()),
            vec![start]
        );
        assert_eq!(
            simulate_proposal(&start, &[Pose::default()], JerkPenalty::default()),
            vec![start]
        );
    }

    #[test]
    fn refuses_a_trajectory_that_has_ended() {
        let states = (0..3).map(|i| {
            TrajectoryState::moving(i * STEP_US, Pose::new(i as f64, 0.0, 0.0), 10.0, 0.0)
        });
        let trajectory = Trajectory::new(states.collect()).unwrap();
        let late = EgoState::from_log(300_000, Pose::default(), Vector::zeros(), Vector::zeros());
        assert!(matches!(
            follow(&late, &trajectory, STEP_US),
            Err(TrackingError::NotCovered(_))
        ));
    }
}
