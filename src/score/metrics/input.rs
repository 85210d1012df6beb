//! The input of the metrics, with the intermediate results that several of them share.

use super::MetricError;
use super::collision::{Collision, find_collisions};
use super::corners::DrivenLanes;
use super::expert_comparison::{FRAMES_PER_SECOND, PlannerExpertErrors, compare_with_expert};
use super::route_progress::Progress;
use planagent_world::{EgoState, HistorySample, Interaction, LaneMap, Trajectory};
use std::cell::OnceCell;

/// One simulation and its expert.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct EvaluatedSimulation<'a> {
    /// The map.
    pub map: &'a LaneMap,
    /// The simulated samples in order of time: N−1 of them, iteration 0 included.
    pub samples: &'a [HistorySample],
    /// The recorded ego: N states, from iteration 0 on.
    pub expert: &'a [EgoState],
    /// The planned trajectory of each sample; the closed-loop metrics need none.
    pub trajectories: &'a [Trajectory],
    /// The recorded ego after `expert`, at the same rate; the closed-loop metrics need none.
    pub future: &'a [EgoState],
    /// What a modification added to the scenario.
    pub interaction: Option<&'a Interaction>,
}

impl<'a> EvaluatedSimulation<'a> {
    /// What the closed-loop metrics need.
    pub fn new(map: &'a LaneMap, samples: &'a [HistorySample], expert: &'a [EgoState]) -> Self {
        Self {
            map,
            samples,
            expert,
            trajectories: &[],
            future: &[],
            interaction: None,
        }
    }

    /// Adds what the open-loop metrics need.
    pub fn with_plans(self, trajectories: &'a [Trajectory], future: &'a [EgoState]) -> Self {
        Self {
            trajectories,
            future,
            ..self
        }
    }

    /// Adds what a modification added to the scenario: its kind decides the metrics of the score.
    pub fn with_interaction(self, interaction: Option<&'a Interaction>) -> Self {
        Self {
            interaction,
            ..self
        }
    }
}

/// A checked simulation with lazily computed intermediate results.
#[derive(Debug)]
pub struct MetricInput<'a> {
    /// The simulation.
    pub simulation: EvaluatedSimulation<'a>,
    states: Vec<EgoState>,
    lanes: OnceCell<DrivenLanes>,
    collisions: OnceCell<Vec<Collision>>,
    progress: OnceCell<Option<Progress>>,
    comparison: OnceCell<Result<PlannerExpertErrors, MetricError>>,
}

impl<'a> MetricInput<'a> {
    /// Checks a simulation.
    pub fn new(simulation: EvaluatedSimulation<'a>) -> Result<Self, MetricError> {
        let states: Vec<EgoState> = simulation.samples.iter().map(|sample| sample.ego).collect();
        check(&states, simulation.expert)?;
        Ok(Self {
            simulation,
            states,
            lanes: OnceCell::new(),
            collisions: OnceCell::new(),
            progress: OnceCell::new(),
            comparison: OnceCell::new(),
        })
    }

    /// The ego at each sample.
    pub fn states(&self) -> &[EgoState] {
        &self.states
    }

    pub(super) fn lanes(&self) -> &DrivenLanes {
        self.lanes
            .get_or_init(|| DrivenLanes::from_states(self.simulation.map, &self.states))
    }

    pub(super) fn collisions(&self) -> &[Collision] {
        self.collisions
            .get_or_init(|| find_collisions(self.simulation.samples, self.lanes()))
    }

    /// The progress along the expert's route; `None` without one.
    pub(super) fn progress(&self) -> Option<&Progress> {
        let EvaluatedSimulation { map, expert, .. } = self.simulation;
        self.progress
            .get_or_init(|| Progress::from_states(map, &self.states, expert))
            .as_ref()
    }

    /// The share of the expert's progress that the ego made; 1 without an expert route.
    pub(super) fn progress_ratio(&self) -> f64 {
        self.progress().map_or(1.0, Progress::ratio)
    }

    pub(super) fn comparison(&self) -> Result<&PlannerExpertErrors, MetricError> {
        let EvaluatedSimulation {
            trajectories,
            expert,
            future,
            ..
        } = self.simulation;
        let compared = self.comparison.get_or_init(|| {
            let (samples, trajectories_len) = (self.states.len(), trajectories.len());
            if trajectories_len != samples {
                return Err(MetricError::TrajectoryCount {
                    samples,
                    trajectories: trajectories_len,
                });
            }
            compare_with_expert(trajectories, expert, future, FRAMES_PER_SECOND)
        });
        compared.as_ref().map_err(Clone::clone)
    }
}

/// Samples that the yaw-acceleration filter needs: one more than its order 3.
const MIN_SAMPLES: usize = 4;

fn check(states: &[EgoState], expert: &[EgoState]) -> Result<(), MetricError> {
    if states.len() < MIN_SAMPLES {
        return Err(MetricError::TooFewSamples {
            got: states.len(),
            needed: MIN_SAMPLES,
        });
    }
    if expert.is_empty() {
        return Err(MetricError::NoExpert);
    }
    if let Some(before) = states.windows(2).position(|w| w[1].time_us <= w[0].time_us) {
        let index = before + 1;
        return Err(MetricError::TimeNotIncreasing {
            index,
            time_us: states[index].time_us,
        });
    }
    for (whose, states) in [("ego", states), ("expert", expert)] {
        let finite = |s: &EgoState| {
            s.rear_axle.is_finite()
                && s.velocity.norm().is_finite()
                && s.acceleration.norm().is_finite()
                && (s.angular_velocity + s.angular_acceleration).is_finite()
        };
        if let Some(index) = states.iter().position(|s| !finite(s)) {
            return Err(MetricError::NotFinite { whose, index });
        }
    }
    Ok(())
}
