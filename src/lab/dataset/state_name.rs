//! The name of a state in a dataset, from which the state is made again.

use super::states::lane_graph;
use planagent_agent::environment::{LaneGraph, LaneGraphError, TextForm};
use planagent_agent::reasoning::{Names, PlannerCode, parse};
use planagent_agent::simulation::{Challenge, ClosedLoop, SimulationError, UnknownChallenge};
use planagent_controls::search;
use planagent_scenario::{OpenError, Scenario};
use planagent_score::pdm::PdmMemory;
use planagent_world::STEP_S;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Word with which generated scenarios begin.
const GENERATED: &str = "generated/";
/// Maximum iterations of a simulation to a state: nuPlan's scenarios have 150.
const MAX_ITERATIONS: usize = 600;
/// Maximum deviation of a state's time from the iterations that led to it, seconds.
const TIME_TOLERANCE: f64 = 1e-6;
/// Between two codes that controlled the ego, and between a code's iterations and its line.
const BETWEEN: (char, char) = (';', '*');

/// A state: a generated scenario, and what controlled the ego in it. All fields are texts and
/// numbers, so that a table of states has one type per column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateName {
    /// Id of the scenario, `generated/TYPE/SEED`, perhaps modified.
    pub scenario: String,
    /// Seed of the dataset.
    pub seed: u64,
    /// Time after the start of the scenario, seconds.
    pub time_s: f64,
    /// `nonreactive` or `reactive`.
    pub challenge: String,
    /// Form of the lane-graph text, which decides on the lanes that a code may name.
    pub scene_text: TextForm,
    /// The codes that controlled the ego before, as `ITERATIONS*CODE`, separated by `;`.
    pub driven: String,
}

/// Why a state cannot be made again.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum StateError {
    #[error(
        "scenario '{0}' is not generated; states of datasets are, as generated/changing_lane/10000012"
    )]
    NotGenerated(String),
    #[error("scenario '{word}': {source}")]
    Scenario {
        word: String,
        source: Box<OpenError>,
    },
    #[error(transparent)]
    Challenge(#[from] UnknownChallenge),
    #[error("challenge '{0}': the states of datasets are of nonreactive or reactive")]
    OpenLoop(String),
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    #[error("driven: {0}; write ITERATIONS*CODE, separated by ';', as the dataset does")]
    Codes(String),
    #[error("time_s is {time_s}, but the codes of driven lead to {driven_s}; take both of one row")]
    Time { time_s: f64, driven_s: f64 },
    #[error("the state has no lane graph: {0}")]
    LaneGraph(#[from] LaneGraphError),
}

/// A state that was made again.
pub(super) struct OpenState {
    pub(super) simulation: ClosedLoop<'static>,
    pub(super) graph: LaneGraph,
}

/// What controlled the ego, as [`StateName::driven`] has it.
pub(super) fn driven_text(driven: &[(PlannerCode, usize)]) -> String {
    let (between, times) = BETWEEN;
    let parts: Vec<String> = driven
        .iter()
        .map(|(code, iterations)| format!("{iterations}{times}{code}"))
        .collect();
    parts.join(&between.to_string())
}

impl StateName {
    /// Simulates to the state.
    ///
    /// # Errors
    /// When the name is not that of a state of a dataset.
    pub(super) fn open(&self) -> Result<OpenState, StateError> {
        if !self.scenario.starts_with(GENERATED) {
            return Err(StateError::NotGenerated(self.scenario.clone()));
        }
        let challenge: Challenge = self.challenge.parse()?;
        if !Challenge::CLOSED_LOOP.contains(&challenge) {
            return Err(StateError::OpenLoop(self.challenge.clone()));
        }
        let scenario = Scenario::open(&self.scenario).map_err(|source| StateError::Scenario {
            word: self.scenario.clone(),
            source: Box::new(source),
        })?;
        let mut simulation = ClosedLoop::new(Arc::new(scenario), challenge)?;
        let (between, _) = BETWEEN;
        for part in self.driven.split(between).filter(|part| !part.is_empty()) {
            self.follow(&mut simulation, part)?;
        }
        let driven_s = simulation.iteration() as f64 * STEP_S;
        if (driven_s - self.time_s).abs() > TIME_TOLERANCE {
            return Err(StateError::Time {
                time_s: self.time_s,
                driven_s,
            });
        }
        let graph = lane_graph(&simulation.scene(), self.scene_text)?;
        Ok(OpenState { simulation, graph })
    }

    /// Lets one code control the ego.
    fn follow(&self, simulation: &mut ClosedLoop<'static>, part: &str) -> Result<(), StateError> {
        let wrong = |what: &str| StateError::Codes(format!("'{part}' {what}"));
        let (_, times) = BETWEEN;
        let (iterations, line) = part
            .split_once(times)
            .ok_or_else(|| wrong("has no iterations"))?;
        let iterations: usize = iterations
            .trim()
            .parse()
            .map_err(|_| wrong("begins with no number of iterations"))?;
        if simulation.iteration().saturating_add(iterations) > MAX_ITERATIONS {
            return Err(wrong("goes beyond 60 s"));
        }
        let graph = lane_graph(&simulation.scene(), self.scene_text)?;
        let code = parse(line, &Names::from_graph(&graph))
            .answer
            .ok_or_else(|| wrong("has no code of this scene"))?;
        let plan = search::planner(simulation, &graph, code)
            .ok_or_else(|| wrong("has a code without a plan"))?;
        search::follow(simulation, &plan, &mut PdmMemory::default(), iterations)
            .map(|_| ())
            .ok_or_else(|| wrong("goes beyond the end of the scenario"))
    }
}
