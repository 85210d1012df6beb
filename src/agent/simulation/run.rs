//! A simulation from its first iteration to its last.

use super::agents::AgentPolicy;
use super::challenge::Challenge;
use super::closed_loop::ClosedLoop;
use super::error::SimulationError;
use crate::planner::Planner;
use planagent_scenario::{Frame, Scenario};
use planagent_score::metrics::{EvaluatedSimulation, Evaluation, MetricError, MetricRegistry};
use planagent_world::{EgoState, HistorySample, Trajectory};
use std::time::Instant;

/// The result of a simulation of N iterations.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SimulationLog {
    /// The challenge.
    pub challenge: Challenge,
    /// Name of the planner.
    pub planner: String,
    /// The ego and the objects at iterations 0 to N−2, which nuPlan's metrics use.
    pub samples: Vec<HistorySample>,
    /// The planned trajectory at each of those iterations.
    pub trajectories: Vec<Trajectory>,
    /// Wall time of the planner at each of them, seconds. It differs from run to run.
    pub runtimes_s: Vec<f64>,
}

impl SimulationLog {
    /// Computes nuPlan's metrics of the challenge; `scenario` is the simulated one.
    ///
    /// # Errors
    /// As [`MetricRegistry::evaluate`].
    pub fn evaluate(&self, scenario: &Scenario) -> Result<Evaluation, MetricError> {
        self.evaluate_with(scenario, &MetricRegistry::default())
    }

    /// Like [`Self::evaluate`], with other metrics.
    ///
    /// # Errors
    /// As [`MetricRegistry::evaluate`].
    pub fn evaluate_with(
        &self,
        scenario: &Scenario,
        metrics: &MetricRegistry,
    ) -> Result<Evaluation, MetricError> {
        let expert: Vec<EgoState> = scenario.expert().copied().collect();
        let simulation = EvaluatedSimulation::new(&scenario.map, &self.samples, &expert)
            .with_plans(&self.trajectories, &scenario.future)
            .with_interaction(scenario.interaction.as_deref());
        metrics.evaluate(self.challenge.metric_list(), &simulation)
    }
}

/// The progress of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Finished iterations.
    pub done: usize,
    /// All iterations: N−1.
    pub total: usize,
}

/// Simulates a scenario from iteration 0 to its end.
///
/// # Errors
/// When the scenario is too short, the planner fails, or its trajectory cannot be tracked.
pub fn simulate(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
) -> Result<SimulationLog, SimulationError> {
    simulate_with_progress(scenario, planner, challenge, &mut |_| ())
}

/// Like [`simulate`], with a call of `on_progress` after every iteration.
///
/// # Errors
/// As [`simulate`].
pub(crate) fn simulate_with_progress(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
    on_progress: &mut dyn FnMut(Progress),
) -> Result<SimulationLog, SimulationError> {
    simulate_prepared(
        ClosedLoop::new(scenario, challenge)?,
        planner,
        challenge,
        on_progress,
    )
}

/// Like [`simulate`], with other agents than the challenge's. `agents` makes their policy from the
/// recorded frame of iteration 0.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_with_agents(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
    agents: impl FnOnce(&Frame) -> Box<dyn AgentPolicy>,
) -> Result<SimulationLog, SimulationError> {
    simulate_prepared(
        ClosedLoop::with_agents(scenario, challenge, agents)?,
        planner,
        challenge,
        &mut |_| (),
    )
}

/// Runs a simulation that was prepared to its end.
///
/// # Errors
/// As [`simulate`], and when the agents' policy fails.
pub fn simulate_prepared(
    mut simulation: ClosedLoop<'_>,
    planner: &mut dyn Planner,
    challenge: Challenge,
    on_progress: &mut dyn FnMut(Progress),
) -> Result<SimulationLog, SimulationError> {
    simulation.initialize(planner)?;
    let name = planner.name().to_owned();
    let total = simulation.scenario().iterations() - 1;
    let mut log = SimulationLog {
        challenge,
        planner: name.clone(),
        samples: Vec::with_capacity(total),
        trajectories: Vec::with_capacity(total),
        runtimes_s: Vec::with_capacity(total),
    };
    while !simulation.is_over() {
        let started = Instant::now();
        let trajectory = simulation.plan(planner)?;
        log.runtimes_s.push(started.elapsed().as_secs_f64());
        // Before the step: a sample is what the planner saw when it planned this trajectory.
        log.samples.push(simulation.present().clone());
        simulation.advance(&trajectory, &name)?;
        log.trajectories.push(trajectory);
        on_progress(Progress {
            done: log.samples.len(),
            total,
        });
    }
    simulation.finish(planner)?;
    Ok(log)
}
