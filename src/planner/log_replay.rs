//! Drives what was recorded: nuPlan's `log_future_planner`, the reference that scores are compared with.

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::world::{EgoState, Trajectory, TrajectoryState};

/// Poses of a trajectory beside the first.
const POSES: usize = 16;
/// Steps of 0.1 s from pose to pose: 16 poses make 8 s.
const STEPS_BETWEEN: usize = 5;

/// The log-replay planner: at iteration k the recorded state k and 16 later ones, 0.5 s apart.
///
/// Where the recording has too few later states, the trajectory before is kept, as in nuPlan. A recording shorter than 8 s
/// is replayed to its last state.
#[derive(Debug, Clone)]
pub struct LogReplay {
    expert: Vec<EgoState>,
    current: Option<Trajectory>,
}

impl LogReplay {
    /// A planner that replays the recorded states, one an iteration from iteration 0 on.
    pub fn new(expert: Vec<EgoState>) -> Self {
        Self { expert, current: None }
    }

    /// The trajectory of an iteration whose whole future is recorded.
    fn full(&self, iteration: usize) -> Option<Vec<TrajectoryState>> {
        (0..=POSES).map(|i| self.expert.get(iteration + i * STEPS_BETWEEN).map(TrajectoryState::from)).collect()
    }

    /// What is recorded from an iteration on, the last state included.
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
