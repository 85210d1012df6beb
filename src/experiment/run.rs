//! Many drives: scenarios x planners x challenges on all cores, each handed over with its score or its error when it ends.

use super::panic_guard::catch_panic;
use super::source::ScenarioSource;
use crate::metrics::{Evaluation, MetricResult, Score};
use crate::pdm::DrivableLayers;
use crate::planner::{
    CodeSource, IdmPlanner, LlmAssist, LogReplay, PLAN_AGENT, PdmClosed, PlanAgent, PlanAgentSettings, Planner,
    PlanningCall, SimplePlanner,
};
use crate::reasoning::AssistVariant;
use crate::scenario::{Scenario, UNKNOWN_TYPE};

use crate::simulation::{Challenge, Progress, SimulationLog, simulate_with_progress};
use rayon::prelude::*;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

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
    /// PDM-Closed.
    PdmClosed,
    /// LLM-ASSIST whose model plans.
    LlmAssistUnc,
    /// LLM-ASSIST whose model tunes PDM-Closed.
    LlmAssistPar,
    /// A control: the agent with random codes instead of a model.
    RandomCode,
    /// A control: the agent with one fixed code.
    FixedCode,
    /// A control: the agent with the code of a grid that Reflection scores best.
    GridCode,
}

impl PlannerKind {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::PlanAgent,
        Self::LogReplay,
        Self::Idm,
        Self::Simple,
        Self::PdmClosed,
        Self::LlmAssistUnc,
        Self::LlmAssistPar,
        Self::RandomCode,
        Self::FixedCode,
        Self::GridCode,
    ];

    /// The name on the command line and in results.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::PlanAgent => PLAN_AGENT,
            Self::LogReplay => "log-replay",
            Self::Idm => "idm",
            Self::Simple => "simple",
            Self::PdmClosed => "pdm-closed",
            Self::LlmAssistUnc => "llm-assist-unc",
            Self::LlmAssistPar => "llm-assist-par",
            Self::RandomCode => "random-code",
            Self::FixedCode => "fixed-code",
            Self::GridCode => "grid-code",
        }
    }

    /// Whether it is one of LLM-ASSIST's.
    pub fn is_llm_assist(self) -> bool {
        matches!(self, Self::LlmAssistUnc | Self::LlmAssistPar)
    }

    /// Whether it asks the configured model.
    pub fn needs_model(self) -> bool {
        self == Self::PlanAgent || self.is_llm_assist()
    }
}

impl fmt::Display for PlannerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A name that is no planner.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown planner '{name}'; known are {}", PlannerKind::ALL.map(PlannerKind::as_str).join(", "))]
pub struct UnknownPlanner {
    name: String,
}

impl FromStr for PlannerKind {
    type Err = UnknownPlanner;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == name).ok_or_else(|| UnknownPlanner { name: name.to_owned() })
    }
}

/// What agents are made of; shared by all drives.
#[derive(Clone)]
pub struct AgentParts {
    /// What `plan-agent` thinks with, where it drives.
    pub model: Option<CodeSource>,
    /// Everything else.
    pub settings: PlanAgentSettings,
}

impl AgentParts {
    /// An agent for one scenario: the scenario's name goes into its seed, so that no drive depends on another. `None` for
    /// planners that are no agents, and for `plan-agent` without a model.
    pub fn agent(&self, planner: PlannerKind, scenario_id: &str) -> Option<PlanAgent> {
        let code_source = match planner {
            PlannerKind::PlanAgent => self.model.clone()?,
            PlannerKind::RandomCode => CodeSource::Random,
            PlannerKind::FixedCode => CodeSource::Fixed,
            PlannerKind::GridCode => CodeSource::Grid,
            _ => return None,
        };
        Some(PlanAgent::new(planner.as_str(), code_source, self.settings_for(scenario_id)))
    }

    /// LLM-ASSIST in one of its variants for one scenario; `None` for other planners, and without a model.
    pub fn llm_assist(&self, planner: PlannerKind, scenario_id: &str) -> Option<LlmAssist> {
        let variant = match planner {
            PlannerKind::LlmAssistUnc => AssistVariant::Unconstrained,
            PlannerKind::LlmAssistPar => AssistVariant::Parameters,
            _ => return None,
        };
        let Some(CodeSource::Model { model, prompts, reasoning }) = self.model.clone() else { return None };
        let settings = self.settings_for(scenario_id);
        Some(LlmAssist::new(planner.as_str(), variant, (model, prompts, reasoning), settings))
    }

    fn settings_for(&self, scenario_id: &str) -> PlanAgentSettings {
        let mut settings = self.settings.clone();
        let hash = blake3::Hasher::new().update(&settings.seed.to_le_bytes()).update(scenario_id.as_bytes()).finalize();
        settings.seed = hash.as_bytes().iter().take(8).fold(0, |seed, &byte| seed << 8 | u64::from(byte));
        settings
    }
}

/// One drive to be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimulationTask {
    /// What is driven.
    pub source: ScenarioSource,
    /// By whom.
    pub planner: PlannerKind,
    /// Among which traffic.
    pub challenge: Challenge,
}

impl fmt::Display for SimulationTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} by {} in {}", self.source, self.planner, self.challenge)
    }
}

/// A drive that came to its end.
#[derive(Debug, Clone)]
pub struct SimulationOutcome {
    /// What was driven.
    pub scenario: Arc<Scenario>,
    /// What it scored.
    pub score: Score,
    /// All metrics with their statistics and time series, in nuPlan's order.
    pub metrics: Vec<MetricResult>,
    /// The planning calls, for agents.
    pub calls: Vec<PlanningCall>,
    /// What counted as drivable, for `pdm-closed`; for `plan-agent` every reflection says it.
    pub drivable_layers: Option<DrivableLayers>,
    /// What happened.
    pub log: SimulationLog,
}

/// The record of one assignment.
#[derive(Debug, Clone)]
pub struct SimulationRecord {
    /// The source in the words of the command line.
    pub source: String,
    /// Name of the scenario; of the source, when it could not be opened and its name is not known.
    pub scenario: String,
    /// nuPlan's type of the scenario.
    pub scenario_type: String,
    /// Name of the log.
    pub log_name: String,
    /// By whom.
    pub planner: PlannerKind,
    /// Among which traffic.
    pub challenge: Challenge,
    /// When the drive began, seconds since 1970. A measurement.
    pub started_s: f64,
    /// When it ended, seconds since 1970. A measurement.
    pub ended_s: f64,
    /// The drive, or why there is none.
    pub outcome: Result<SimulationOutcome, String>,
}

/// Makes the drives `todo` (places in `assignments`, in growing order) on all threads of the current pool. Each record is
/// given to `on_simulation` as soon as its drive has ended, from any thread and in any order, and is not kept. `on_iteration` is
/// called after every iteration of every drive. A drive that fails or panics is recorded with its error.
///
/// # Errors
/// The first error of `on_simulation`; no further drive begins after it.
pub fn run<E: Send>(
    tasks: &[SimulationTask],
    todo: &[usize],
    agent: Option<&AgentParts>,
    on_iteration: &(dyn Fn(Progress) + Sync),
    on_simulation: &(dyn Fn(usize, SimulationRecord) -> Result<(), E> + Sync),
) -> Result<(), E> {
    let drives: Vec<(usize, &SimulationTask)> = todo.iter().filter_map(|&i| Some((i, tasks.get(i)?))).collect();
    // Neighbours of one source share the scenario: opening a recording can cost more than driving it.
    let groups: Vec<&[(usize, &SimulationTask)]> = drives.chunk_by(|(_, a), (_, b)| a.source == b.source).collect();
    groups.par_iter().try_for_each(|group| {
        let Some((_, first)) = group.first() else { return Ok(()) };
        let opened = catch_panic(|| first.source.open().map(Arc::new).map_err(|error| with_causes(&error)));
        group.par_iter().try_for_each(|&(i, task)| {
            let scenario = opened.as_ref().map_err(String::as_str);
            on_simulation(i, drive(task, scenario, agent, on_iteration))
        })
    })
}

fn drive(
    task: &SimulationTask,
    scenario: Result<&Arc<Scenario>, &str>,
    agent: Option<&AgentParts>,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> SimulationRecord {
    let SimulationTask { source, planner, challenge } = task;
    let started_s = now_s();
    let outcome = scenario
        .map_err(str::to_owned)
        .and_then(|scenario| catch_panic(|| simulate_task(scenario, *planner, *challenge, agent, on_iteration)));
    let opened = scenario.ok();
    SimulationRecord {
        source: source.to_string(),
        scenario: opened
            .map(|scenario| scenario.id.clone())
            .or_else(|| source.id())
            .unwrap_or_else(|| source.to_string()),
        scenario_type: opened
            .map(|scenario| scenario.scenario_type.as_str())
            .or_else(|| source.scenario_type())
            .unwrap_or(UNKNOWN_TYPE)
            .to_owned(),
        log_name: opened.map_or_else(|| source.log_name(), |scenario| scenario.log_name.clone()),
        planner: *planner,
        challenge: *challenge,
        started_s,
        ended_s: now_s(),
        outcome,
    }
}

/// Seconds since 1970.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// One drive with its score.
fn simulate_task(
    scenario: &Arc<Scenario>,
    planner: PlannerKind,
    challenge: Challenge,
    agent: Option<&AgentParts>,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> Result<SimulationOutcome, String> {
    let simulate = |planner: &mut dyn Planner| {
        simulate_with_progress(scenario, planner, challenge, &mut |progress| on_iteration(progress))
            .map_err(|error| with_causes(&error))
    };
    let mut calls = Vec::new();
    let mut drivable_layers = None;
    let log = match planner {
        PlannerKind::PlanAgent | PlannerKind::RandomCode | PlannerKind::FixedCode | PlannerKind::GridCode => {
            let agent = agent.and_then(|parts| parts.agent(planner, &scenario.id));
            let mut planner = agent.ok_or_else(|| format!("{planner} needs a model, or settings"))?;
            let log = simulate(&mut planner)?;
            calls = planner.calls().to_vec();
            log
        }
        PlannerKind::LlmAssistUnc | PlannerKind::LlmAssistPar => {
            let planner = agent.and_then(|parts| parts.llm_assist(planner, &scenario.id));
            let mut planner = planner.ok_or_else(|| "LLM-ASSIST needs a model".to_owned())?;
            let log = simulate(&mut planner)?;
            calls = planner.calls().to_vec();
            log
        }
        PlannerKind::LogReplay => simulate(&mut LogReplay::new(scenario.recorded().copied().collect()))?,
        PlannerKind::Idm => simulate(&mut IdmPlanner::default())?,
        PlannerKind::Simple => simulate(&mut SimplePlanner::default())?,
        PlannerKind::PdmClosed => {
            let mut planner = PdmClosed::new();
            let log = simulate(&mut planner)?;
            drivable_layers = planner.drivable_layers();
            log
        }
    };
    let Evaluation { score, metrics } = log.evaluate(scenario).map_err(|error| with_causes(&error))?;
    Ok(SimulationOutcome { scenario: Arc::clone(scenario), score, metrics, calls, drivable_layers, log })
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
