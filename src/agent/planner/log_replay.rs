//! Replays the recorded ego: nuPlan's `log_future_planner`, the reference of scores.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_world::{EgoState, Trajectory, TrajectoryState};

/// Poses of a trajectory after the first.
const POSES: usize = 16;
/// Steps of 0.1 s between poses: 16 poses make 8 s.
const STEPS_BETWEEN: usize = 5;

/// The log-replay planner: at iteration k the recorded state k and up to 16 later ones, 0.5 s
/// apart.
///
/// Where fewer are recorded, the shorter future is the trajectory, as in nuPlan. Where none is,
/// nuPlan's planner fails. Recordings that end with their scenario get there in the last 0.4 s;
/// here the last trajectory is kept.
#[derive(Debug, Clone)]
pub struct LogReplay {
    expert: Vec<EgoState>,
    current: Option<Trajectory>,
}

impl LogReplay {
    /// A planner that replays the recorded states, one per iteration, with those after the end of
    /// the scenario.
    pub fn new(expert: Vec<EgoState>) -> Self {
        Self {
            expert,
            current: None,
        }
    }

    /// The recorded state of an iteration and its recorded future.
    fn recorded(&self, iteration: usize) -> Vec<TrajectoryState> {
        let rest = self.expert.get(iteration..).unwrap_or_default();
        rest.iter()
            .step_by(STEPS_BETWEEN)
            .take(1 + POSES)
            .map(TrajectoryState::from)
            .collect()
    }
}

impl Planner for LogReplay {
    fn name(&self) -> &'static str {
        "log-replay"
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        self.current = None;
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let iteration = input.iteration;
        let states = self.recorded(iteration);
        if states.len() >= 2 {
            self.current = Some(Trajectory::new(states)?);
        }
        let samples = self.expert.len();
        self.current
            .clone()
            .ok_or(PlannerError::NoRecordedFuture { iteration, samples })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_road::{Stretch, ego_at, straight_road, whole_route};
    use planagent_world::{History, STEP_US, SceneView, TrafficLights};

    fn recorded(samples: usize) -> LogReplay {
        LogReplay::new(
            (0..samples)
                .map(|k| ego_at(k as i64 * STEP_US, k as f64, 10.0))
                .collect(),
        )
    }

    fn ask(planner: &mut LogReplay, iteration: usize) -> Result<Trajectory, PlannerError> {
        let map = straight_road(&[Stretch::Lane(100.0)], None);
        let (route, lights, history) = (
            whole_route(&map),
            TrafficLights::default(),
            History::default(),
        );
        let ego = ego_at(0, 0.0, 0.0);
        let scene = SceneView {
            map: &map,
            route: &route,
            ego: &ego,
            objects: &[],
            lights: &lights,
            history: &history,
        };
        planner.compute_trajectory(&PlannerInput { iteration, scene })
    }

    #[test]
    fn gives_seventeen_states_over_eight_seconds() {
        let trajectory = ask(&mut recorded(151), 30).unwrap();
        assert_eq!(trajectory.states().len(), 17);
        assert_eq!(
            (trajectory.start_us(), trajectory.end_us()),
            (3_000_000, 11_000_000)
        );
        assert!((trajectory.at(3_700_000).unwrap().rear_axle.x - 37.0).abs() < 1e-9);
    }

    #[test]
    fn a_shorter_future_is_used_as_it_is() {
        let mut planner = recorded(151);
        assert_eq!(ask(&mut planner, 70).unwrap().end_us(), 15_000_000);
        for (iteration, end_us, states) in [
            (71, 14_600_000, 16),
            (143, 14_800_000, 2),
            (145, 15_000_000, 2),
        ] {
            let trajectory = ask(&mut planner, iteration).unwrap();
            assert_eq!(
                (trajectory.start_us(), trajectory.end_us()),
                (iteration as i64 * STEP_US, end_us)
            );
            assert_eq!(trajectory.states().len(), states);
        }
    }

    #[test]
    fn without_a_future_the_last_trajectory_is_kept() {
        let mut planner = recorded(151);
        let last = ask(&mut planner, 145).unwrap();
        for iteration in 146..=150 {
            assert_eq!(ask(&mut planner, iteration).unwrap(), last);
        }
    }

    #[test]
    fn has_nothing_to_replay_after_the_end() {
        let error = ask(&mut recorded(53), 52).unwrap_err();
        assert!(matches!(
            error,
            PlannerError::NoRecordedFuture {
                iteration: 52,
                samples: 53
            }
        ));
    }
}
