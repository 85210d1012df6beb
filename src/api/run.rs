//! One planner on one scenario.

use super::Result;
use planagent_agent::planner::{Planner, PlanningCall};
use planagent_agent::simulation::{AgentPolicy, Challenge, SimulationLog, simulate_with_agents};
use planagent_scenario::{Frame, Scenario};
use planagent_score::metrics::{Evaluation, MetricRegistry};
use std::fmt;

type MakeAgents<'a> = Box<dyn FnOnce(&Frame) -> Box<dyn AgentPolicy> + 'a>;

/// A simulation that is about to run.
pub struct Simulation<'a> {
    scenario: &'a Scenario,
    challenge: Challenge,
    metrics: MetricRegistry,
    agents: Option<MakeAgents<'a>>,
}

impl fmt::Debug for Simulation<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            scenario,
            challenge,
            ..
        } = self;
        f.debug_struct("Simulation")
            .field("scenario", &scenario.id)
            .field("challenge", challenge)
            .finish_non_exhaustive()
    }
}

impl<'a> Simulation<'a> {
    /// A closed loop with non-reactive agents and nuPlan's metrics.
    pub fn new(scenario: &'a Scenario) -> Self {
        Self {
            scenario,
            challenge: Challenge::NonReactive,
            metrics: MetricRegistry::default(),
            agents: None,
        }
    }

    /// Sets the challenge.
    #[must_use]
    pub fn challenge(self, challenge: Challenge) -> Self {
        Self { challenge, ..self }
    }

    /// Evaluates with other metrics.
    #[must_use]
    pub fn metrics(self, metrics: MetricRegistry) -> Self {
        Self { metrics, ..self }
    }

    /// Controls the agents by another policy, which `agents` makes from the recorded frame of
    /// iteration 0.
    #[must_use]
    pub fn agents(self, agents: impl FnOnce(&Frame) -> Box<dyn AgentPolicy> + 'a) -> Self {
        Self {
            agents: Some(Box::new(agents)),
            ..self
        }
    }

    /// Runs it to its end.
    ///
    /// # Errors
    /// When the scenario is too short, the planner fails, or a trajectory cannot be tracked.
    pub fn run(self, planner: &mut dyn Planner) -> Result<Run> {
        let Self {
            scenario,
            challenge,
            metrics,
            agents,
        } = self;
        let log = match agents {
            Some(agents) => simulate_with_agents(scenario, planner, challenge, agents)?,
            None => planagent_agent::simulation::simulate(scenario, planner, challenge)?,
        };
        let evaluation = log.evaluate_with(scenario, &metrics)?;
        Ok(Run {
            log,
            evaluation,
            calls: planner.calls().to_vec(),
        })
    }
}

/// Runs a planner on a scenario and evaluates it with nuPlan's metrics.
///
/// # Errors
/// As [`Simulation::run`].
pub fn simulate(
    scenario: &Scenario,
    planner: &mut dyn Planner,
    challenge: Challenge,
) -> Result<Run> {
    Simulation::new(scenario).challenge(challenge).run(planner)
}

/// The result of a simulation.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Run {
    /// The samples and trajectories.
    pub log: SimulationLog,
    /// The metrics and the score.
    pub evaluation: Evaluation,
    /// The planning calls of an agent.
    pub calls: Vec<PlanningCall>,
}

impl Run {
    /// nuPlan's score, in [0, 1].
    pub fn score(&self) -> f64 {
        self.evaluation.score.value
    }

    /// The score of a metric by nuPlan's name; `None` for a metric without one.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.evaluation.metric(name).and_then(|metric| metric.score)
    }
}
