//! Many drives: scenarios x planners x challenges on all cores, each recorded with its score or its error.

use super::source::ScenarioSource;
use crate::metrics::Score;
use crate::mllm::Mllm;
use crate::planner::{
    IdmPlanner, LogReplay, PLAN_AGENT, PlanAgent, PlanAgentSettings, Planner, PlanningCall, SimplePlanner,
};
use crate::reasoning::PromptSet;
use crate::scenario::Scenario;
use crate::simulation::{Challenge, Progress, SimulationLog, simulate_with_progress};
use rayon::prelude::*;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// The planners that can be run by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlannerKind {
    /// The agent of the paper.
    PlanAgent,
    /// The recorded driver.
    LogReplay,
    /// nuPlan's IDM planner.
    Idm,
    /// nuPlan's planner that goes straight on.
    Simple,
}

impl PlannerKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::PlanAgent, Self::LogReplay, Self::Idm, Self::Simple];

    /// The name on the command line and in results.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::PlanAgent => PLAN_AGENT,
            Self::LogReplay => "log-replay",
            Self::Idm => "idm",
            Self::Simple => "simple",
        }
    }
}

impl fmt::Display for PlannerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A name that is no planner.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown planner '{0}'; known are plan-agent, log-replay, idm, simple")]
pub struct UnknownPlanner(String);

impl FromStr for PlannerKind {
    type Err = UnknownPlanner;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == name).ok_or_else(|| UnknownPlanner(name.to_owned()))
    }
}

/// What `plan-agent` is made of; shared by all drives.
#[derive(Clone)]
pub struct AgentParts {
    /// The model.
    pub model: Arc<dyn Mllm>,
    /// How it is asked.
    pub prompts: Arc<PromptSet>,
    /// Everything else.
    pub settings: PlanAgentSettings,
}

impl AgentParts {
    /// An agent for one scenario: the scenario's name goes into its seed, so that no drive depends on another.
    pub fn agent(&self, scenario_id: &str) -> PlanAgent {
        let mut settings = self.settings.clone();
        let hash = blake3::Hasher::new().update(&settings.seed.to_le_bytes()).update(scenario_id.as_bytes()).finalize();
        settings.seed = hash.as_bytes().iter().take(8).fold(0, |seed, &byte| seed << 8 | u64::from(byte));
        PlanAgent::new(Arc::clone(&self.model), Arc::clone(&self.prompts), settings)
    }
}

/// One drive to be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// What is driven.
    pub source: ScenarioSource,
    /// By whom.
    pub planner: PlannerKind,
    /// Among which traffic.
    pub challenge: Challenge,
}

/// A drive that came to its end.
#[derive(Debug, Clone)]
pub struct Driven {
    /// What it scored.
    pub score: Score,
    /// The planning calls, for `plan-agent`.
    pub calls: Vec<PlanningCall>,
    /// What happened.
    pub log: SimulationLog,
}

/// The record of one assignment.
#[derive(Debug, Clone)]
pub struct DriveRecord {
    /// Name of the scenario; of the source, when it could not be opened.
    pub scenario: String,
    /// nuPlan's type of the scenario.
    pub scenario_type: String,
    /// Name of the log.
    pub log_name: String,
    /// By whom.
    pub planner: PlannerKind,
    /// Among which traffic.
    pub challenge: Challenge,
    /// The drive, or why there is none.
    pub outcome: Result<Driven, String>,
}

/// Makes all drives, on all threads of the current pool; records come in the order of the assignments.
/// `on_iteration` is called after every iteration of every drive, from any thread.
pub fn run(
    assignments: &[Assignment],
    agent: Option<&AgentParts>,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> Vec<DriveRecord> {
    assignments.par_iter().map(|assignment| drive(assignment, agent, on_iteration)).collect()
}

fn drive(assignment: &Assignment, agent: Option<&AgentParts>, on_iteration: &(dyn Fn(Progress) + Sync)) -> DriveRecord {
    let Assignment { source, planner, challenge } = assignment;
    let record = |scenario: &str, scenario_type: &str, log_name: &str, outcome| DriveRecord {
        scenario: scenario.to_owned(),
        scenario_type: scenario_type.to_owned(),
        log_name: log_name.to_owned(),
        planner: *planner,
        challenge: *challenge,
        outcome,
    };
    match source.open() {
        Ok(scenario) => {
            let outcome = drive_scenario(&scenario, *planner, *challenge, agent, on_iteration);
            record(&scenario.id, &scenario.scenario_type, &scenario.log_name, outcome)
        }
        Err(error) => record(&source.to_string(), "unknown", "unknown", Err(with_causes(&error))),
    }
}

/// One drive with its score.
fn drive_scenario(
    scenario: &Scenario,
    planner: PlannerKind,
    challenge: Challenge,
    agent: Option<&AgentParts>,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> Result<Driven, String> {
    let simulate = |planner: &mut dyn Planner| {
        simulate_with_progress(scenario, planner, challenge, &mut |progress| on_iteration(progress))
            .map_err(|error| with_causes(&error))
    };
    let (log, calls) = match planner {
        PlannerKind::PlanAgent => {
            let parts = agent.ok_or_else(|| "plan-agent needs a model".to_owned())?;
            let mut planner = parts.agent(&scenario.id);
            (simulate(&mut planner)?, planner.calls().to_vec())
        }
        PlannerKind::LogReplay => (simulate(&mut LogReplay::new(scenario.recorded().copied().collect()))?, Vec::new()),
        PlannerKind::Idm => (simulate(&mut IdmPlanner::default())?, Vec::new()),
        PlannerKind::Simple => (simulate(&mut SimplePlanner::default())?, Vec::new()),
    };
    let evaluation = log.evaluate(scenario).map_err(|error| with_causes(&error))?;
    Ok(Driven { score: evaluation.score, calls, log })
}

/// An error with all its causes in one line.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let inner_text = inner.to_string();
        if !text.contains(&inner_text) {
            text = format!("{text}: {inner_text}");
        }
        cause = inner.source();
    }
    text
}
