//! A drive from its first iteration to its last.

use super::closed_loop::ClosedLoop;
use super::error::SimulationError;
use super::observation::Challenge;
use crate::metrics::{
    EvaluatedPlans, EvaluatedSimulation, Evaluation, MetricError, MetricList, evaluate, evaluate_open_loop,
};
use crate::planner::Planner;
use crate::scenario::Scenario;
use crate::world::{EgoState, HistorySample, Trajectory};
use std::time::Instant;

/// What happened in a drive of N iterations.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationLog {
    /// Which challenge was driven.
    pub challenge: Challenge,
    /// Name of the planner.
    pub planner: String,
    /// The ego and the objects at iterations 0 to N−2: what nuPlan's metrics look at.
    pub samples: Vec<HistorySample>,
    /// The trajectory given at each of those iterations.
    pub trajectories: Vec<Trajectory>,
    /// Wall time that the planner took at each of them, seconds. A measurement: it differs from run to run.
    pub runtimes_s: Vec<f64>,
}

impl SimulationLog {
    /// Judges the drive by the metrics of its challenge; `scenario` is the one that was driven.
    ///
    /// # Errors
    /// As [`evaluate`] and [`evaluate_open_loop`].
    pub fn evaluate(&self, scenario: &Scenario) -> Result<Evaluation, MetricError> {
        let expert: Vec<EgoState> = scenario.expert().copied().collect();
        match self.challenge.metric_list() {
            MetricList::ClosedLoop => {
                evaluate(&EvaluatedSimulation { map: &scenario.map, samples: &self.samples, expert: &expert })
            }
            MetricList::OpenLoop => evaluate_open_loop(&EvaluatedPlans {
                samples: &self.samples,
                trajectories: &self.trajectories,
                expert: &expert,
                future: &scenario.future,
            }),
        }
    }
}

/// How far a drive has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Iterations that are done.
    pub done: usize,
    /// Iterations that there will be: N−1.
    pub total: usize,
}

/// Drives a scenario from iteration 0 to its end.
///
/// # Errors
/// When the scenario is too short, the planner fails, or its trajectory cannot be followed.
pub fn simulate(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
) -> Result<SimulationLog, SimulationError> {
    simulate_with_progress(scenario, planner, challenge, &mut |_| ())
}

/// Like [`simulate`], calling `on_progress` after every iteration.
///
/// # Errors
/// When the scenario is too short, the planner fails, or its trajectory cannot be followed.
pub fn simulate_with_progress(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
    on_progress: &mut dyn FnMut(Progress),
) -> Result<SimulationLog, SimulationError> {
    let mut drive = ClosedLoop::new(scenario, challenge)?;
    drive.initialize(planner)?;
    let name = planner.name().to_owned();
    let total = scenario.iterations() - 1;
    let mut log = SimulationLog {
        challenge,
        planner: name.clone(),
        samples: Vec::with_capacity(total),
        trajectories: Vec::with_capacity(total),
        runtimes_s: Vec::with_capacity(total),
    };
    while !drive.is_over() {
        let started = Instant::now();
        let trajectory = drive.plan(planner)?;
        log.runtimes_s.push(started.elapsed().as_secs_f64());
        log.samples.push(drive.present().clone());
        drive.advance(&trajectory, &name)?;
        log.trajectories.push(trajectory);
        on_progress(Progress { done: log.samples.len(), total });
    }
    Ok(log)
}
