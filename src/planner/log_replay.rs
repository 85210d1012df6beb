//! Replays the recorded ego: nuPlan's `log_future_planner`, the reference of scores.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::world::{EgoState, Trajectory, TrajectoryState};

/// Poses of a trajectory after the first.
const POSES: usize = 16;
/// Steps of 0.1 s between poses: 16 poses make 8 s.
const STEPS_BETWEEN: usize = 5;

/// The log-replay planner: at iteration k the recorded state k and 16 later ones, 0.5 s apart.
///
/// Where the recording has too few later states, the last trajectory is kept, as in nuPlan. A recording shorter than 8 s
/// is replayed to its last state.
#[derive(Debug, Clone)]
pub struct LogReplay {
    expert: Vec<EgoState>,
    current: Option<Trajectory>,
}

impl LogReplay {
    /// A planner that replays the recorded states, one per iteration, with those after the end of the scenario.
    pub fn new(expert: Vec<EgoState>) -> Self {
        Self { expert, current: None }
    }

    /// The trajectory of an iteration whose whole future is recorded.
    fn full(&self, iteration: usize) -> Option<Vec<TrajectoryState>> {
        (0..=POSES).map(|i| self.expert.get(iteration + i * STEPS_BETWEEN).map(TrajectoryState::from)).collect()
    }

    /// The recorded states from an iteration on, the last one included.
    fn rest(&self, iteration: usize) -> Vec<TrajectoryState> {
        let rest = self.expert.get(iteration..).unwrap_or_default();
        let last = rest.len().saturating_sub(1);
        let kept = rest.iter().enumerate().filter(|(i, _)| i % STEPS_BETWEEN == 0 || *i == last);
        kept.map(|(_, state)| TrajectoryState::from(state)).collect()
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
        let trajectory = match (self.full(iteration), &self.current) {
            (Some(states), _) => Trajectory::new(states)?,
            (None, Some(earlier)) => earlier.clone(),
            (None, None) => {
                let states = self.rest(iteration);
                if states.len() < 2 {
                    let samples = self.expert.len();
                    return Err(PlannerError::NoRecordedFuture { iteration, samples });
                }
                Trajectory::new(states)?
            }
        };
        self.current = Some(trajectory.clone());
        Ok(trajectory)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::test_road::{Stretch, ego_at, straight_road, whole_route};
    use crate::world::{History, STEP_US, SceneView, TrafficLights};

    fn recorded(samples: usize) -> LogReplay {
        LogReplay::new((0..samples).map(|k| ego_at(k as i64 * STEP_US, k as f64, 10.0)).collect())
    }

    fn ask(planner: &mut LogReplay, iteration: usize) -> Result<Trajectory, PlannerError> {
        let map = straight_road(&[Stretch::Lane(100.0)], None);
        let (route, lights, history) = (whole_route(&map), TrafficLights::default(), History::default());
        let ego = ego_at(0, 0.0, 0.0);
        let scene = SceneView { map: &map, route: &route, ego: &ego, objects: &[], lights: &lights, history: &history };
        planner.compute_trajectory(&PlannerInput { iteration, scene })
    }

    #[test]
    fn gives_seventeen_states_over_eight_seconds() {
        let trajectory = ask(&mut recorded(151), 30).unwrap();
        assert_eq!(trajectory.states().len(), 17);
        assert_eq!((trajectory.start_us(), trajectory.end_us()), (3_000_000, 11_000_000));
        assert!((trajectory.at(3_700_000).unwrap().rear_axle.x - 37.0).abs() < 1e-9);
    }

    #[test]
    fn keeps_its_trajectory_near_the_end_of_the_recording() {
        let mut planner = recorded(151);
        let last_full = ask(&mut planner, 70).unwrap();
        assert_eq!(last_full.end_us(), 15_000_000);
        assert_eq!(ask(&mut planner, 71).unwrap(), last_full);
        assert_eq!(ask(&mut planner, 149).unwrap(), last_full);
    }

    #[test]
    fn replays_a_short_recording_to_its_end() {
        let mut planner = recorded(53);
        let trajectory = ask(&mut planner, 0).unwrap();
        assert_eq!(trajectory.end_us(), 5_200_000);
        assert_eq!(ask(&mut planner, 51).unwrap(), trajectory);
    }

    #[test]
    fn has_nothing_to_replay_after_the_end() {
        let error = ask(&mut recorded(53), 52).unwrap_err();
        assert!(matches!(error, PlannerError::NoRecordedFuture { iteration: 52, samples: 53 }));
    }
}
