//! One planner on one scenario.

use super::{Error, Result};
use crate::metrics::{Evaluation, MetricRegistry};
use crate::planner::{Planner, PlanningCall};
use crate::scenario::{DataRoots, Frame, Readers, Scenario};
use crate::simulation::{AgentPolicy, Challenge, SimulationLog, simulate_with_agents};
use std::fmt;

impl Scenario {
    /// Opens the scenario that a word names, as on the command line: a generated scenario (`generated/changing_lane/2`), a
    /// Waymo TFRecord file of one scenario, a nuPlan log with a token, a folder of an Argoverse 2 scenario.
    ///
    /// ```
    /// let scenario = planagent::Scenario::open("generated/changing_lane/2")?;
    /// assert_eq!(scenario.scenario_type, "changing_lane");
    /// # Ok::<(), planagent::Error>(())
    /// ```
    ///
    /// # Errors
    /// When the word names no scenario or several, or the scenario cannot be read.
    pub fn open(word: &str) -> Result<Self> {
        let found = Readers::new(&DataRoots::from_environment()).find(word)?;
        match found.as_slice() {
            [one] => Ok(one.open()?),
            several => Err(Error::ManyScenarios { word: word.to_owned(), count: several.len() }),
        }
    }

    /// Opens all scenarios that a word names, for example those of a folder, one by one.
    ///
    /// # Errors
    /// When the word names no scenario.
    pub fn open_all(word: &str) -> Result<impl Iterator<Item = Result<Self>>> {
        let found = Readers::new(&DataRoots::from_environment()).find(word)?;
        Ok(found.into_iter().map(|scenario| Ok(scenario.open()?)))
    }
}

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
        let Self { scenario, challenge, .. } = self;
        f.debug_struct("Simulation")
            .field("scenario", &scenario.id)
            .field("challenge", challenge)
            .finish_non_exhaustive()
    }
}

impl<'a> Simulation<'a> {
    /// A closed loop with non-reactive agents and nuPlan's metrics.
    pub fn new(scenario: &'a Scenario) -> Self {
        Self { scenario, challenge: Challenge::NonReactive, metrics: MetricRegistry::default(), agents: None }
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

    /// Controls the agents by another policy, which `agents` makes from the recorded frame of iteration 0.
    #[must_use]
    pub fn agents(self, agents: impl FnOnce(&Frame) -> Box<dyn AgentPolicy> + 'a) -> Self {
        Self { agents: Some(Box::new(agents)), ..self }
    }

    /// Runs it to its end.
    ///
    /// # Errors
    /// When the scenario is too short, the planner fails, or a trajectory cannot be tracked.
    pub fn run(self, planner: &mut dyn Planner) -> Result<Run> {
        let Self { scenario, challenge, metrics, agents } = self;
        let log = match agents {
            Some(agents) => simulate_with_agents(scenario, planner, challenge, agents)?,
            None => crate::simulation::simulate(scenario, planner, challenge)?,
        };
        let evaluation = log.evaluate_with(scenario, &metrics)?;
        Ok(Run { log, evaluation, calls: planner.calls().to_vec() })
    }
}

/// Runs a planner on a scenario and evaluates it with nuPlan's metrics.
///
/// # Errors
/// As [`Simulation::run`].
pub fn simulate(scenario: &Scenario, planner: &mut dyn Planner, challenge: Challenge) -> Result<Run> {
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
