//! Many simulations on all cores: scenarios x planners x challenges, each with its score or its
//! error.

use super::failed_call::{FailedCallListener, Reporting};
use super::panic_guard::catch_panic;
use super::shuffled_bev;
use super::stoppable::Stoppable;
use planagent_agent::planner::{
    AgentLayer, BevSource, CodeSource, PlanAgent, PlanAgentSettings, Planner, PlannerError,
    PlannerName, PlanningCall, StopSwitch,
};
use planagent_agent::planner_registry::{
    PlannerNeeds, PlannerParts, PlannerRegistry, UnknownPlanner,
};
use planagent_agent::simulation::{
    AgentCommand, Challenge, ClosedLoop, Progress, SimulationLog, simulate_prepared,
};
use planagent_files::shortened;
use planagent_planners::all_planners;
use planagent_scenario::{HeldScenario, Scenario, ScenarioRef, UNKNOWN_TYPE};
use planagent_score::metrics::{Evaluation, MetricResult, Score};
use planagent_score::pdm::DrivableLayers;
use planagent_world::EgoState;
use rayon::prelude::*;
use std::fmt;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// What the planners of a run are built from.
#[derive(Clone)]
pub struct AgentParts {
    pub registry: PlannerRegistry,
    /// The model, for planners that need one.
    pub model: Option<CodeSource>,
    pub settings: PlanAgentSettings,
    /// The command that controls the other agents, for simulations under its policy.
    pub agents: Option<AgentCommand>,
    /// Ends the simulations early.
    pub stop: Option<StopSwitch>,
    /// Hears of planning calls that give no plan, as they happen.
    pub on_failed_call: Option<FailedCallListener>,
}

impl Default for AgentParts {
    fn default() -> Self {
        let (model, settings, agents, stop, on_failed_call) = Default::default();
        Self {
            registry: all_planners(),
            model,
            settings,
            agents,
            stop,
            on_failed_call,
        }
    }
}

impl AgentParts {
    /// The planner of one scenario. The scenario's name goes into the seed, so that no simulation
    /// depends on another.
    pub fn planner(
        &self,
        name: PlannerName,
        scenario: &Scenario,
    ) -> Result<Box<dyn Planner>, BuildError> {
        self.planner_in(name, scenario, None)
    }

    /// The same, for a simulation that the planner may look ahead in.
    fn planner_in(
        &self,
        name: PlannerName,
        scenario: &Scenario,
        simulation: Option<&ClosedLoop<'static>>,
    ) -> Result<Box<dyn Planner>, BuildError> {
        let entry = self.registry.find(name.as_str())?;
        let recording: Vec<EgoState> = match entry.needs {
            PlannerNeeds::Recording => scenario.recorded().copied().collect(),
            _ => Vec::new(),
        };
        let settings = self.settings_for(&scenario.id);
        let shuffled_bev = self.shuffled_bev();
        let planner = entry.build(&PlannerParts {
            name,
            settings: &settings,
            model: self.model.as_ref(),
            recording: &recording,
            simulation,
            shuffled_bev: shuffled_bev.as_ref(),
        })?;
        Ok(self.wrapped(planner, &scenario.id))
    }

    /// PlanAgent for one scenario; `None` without a model.
    pub fn agent(&self, scenario_id: &str) -> Option<Box<dyn AgentLayer>> {
        let settings = self.settings_for(scenario_id);
        let agent = PlanAgent::new(PlannerName::PLAN_AGENT, self.model.clone()?, settings);
        Some(agent.with_shuffled_bev(self.shuffled_bev()).layered())
    }

    /// The planner under the switch of the run, and with reports of its failed calls.
    fn wrapped(&self, planner: Box<dyn Planner>, scenario: &str) -> Box<dyn Planner> {
        let planner: Box<dyn Planner> = match &self.on_failed_call {
            Some(listener) => Box::new(Reporting::new(planner, scenario, Arc::clone(listener))),
            None => planner,
        };
        match &self.stop {
            Some(switch) => Box::new(Stoppable {
                planner,
                switch: switch.clone(),
            }),
            None => planner,
        }
    }

    fn shuffled_bev(&self) -> Option<BevSource> {
        self.settings
            .environment
            .shuffled_bev
            .then(shuffled_bev::source)
    }

    fn settings_for(&self, scenario_id: &str) -> PlanAgentSettings {
        let mut settings = self.settings.clone();
        let hash = blake3::Hasher::new()
            .update(&settings.seed.to_le_bytes())
            .update(scenario_id.as_bytes())
            .finalize();
        settings.seed = hash
            .as_bytes()
            .iter()
            .take(8)
            .fold(0, |seed, &byte| seed << 8 | u64::from(byte));
        settings
    }
}

#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    #[error(transparent)]
    Unknown(#[from] UnknownPlanner),
    #[error(transparent)]
    Planner(#[from] PlannerError),
}

/// One planner on one scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimulationTask {
    pub source: ScenarioRef,
    pub planner: PlannerName,
    pub challenge: Challenge,
}

impl fmt::Display for SimulationTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} by {} in {}",
            self.source, self.planner, self.challenge
        )
    }
}

/// A simulation that ended.
#[derive(Debug, Clone)]
pub struct SimulationOutcome {
    pub scenario: Arc<Scenario>,
    pub score: Score,
    /// All metrics with their statistics and time series, in nuPlan's order.
    pub metrics: Vec<MetricResult>,
    /// The planning calls, for agents.
    pub calls: Vec<PlanningCall>,
    /// The map layers that counted as drivable, for `pdm-closed`; for `plan-agent` they are in
    /// every reflection.
    pub drivable_layers: Option<DrivableLayers>,
    pub log: SimulationLog,
}

#[derive(Debug, Clone)]
pub struct SimulationRecord {
    /// The word of the command line that names the scenario.
    pub source: String,
    /// Name of the scenario; the word, where the name is not known before opening.
    pub scenario: String,
    /// nuPlan's type of the scenario.
    pub scenario_type: String,
    pub log_name: String,
    pub planner: PlannerName,
    pub challenge: Challenge,
    /// Start, seconds since 1970. A measurement.
    pub started_s: f64,
    /// End, seconds since 1970. A measurement.
    pub ended_s: f64,
    /// The simulation, or why it failed.
    pub outcome: Result<SimulationOutcome, String>,
}

/// Simulates the tasks of these numbers (places in `tasks`, ascending) on all threads of the
/// current pool. `on_simulation` gets each record when its simulation ends, from any thread and in
/// any order. `on_iteration` is called after every iteration of every simulation. A simulation that
/// fails or panics is recorded with its error. The first error of `on_simulation` is returned, and
/// no further simulation starts.
pub fn run<E: Send>(
    tasks: &[SimulationTask],
    numbers: &[usize],
    parts: &AgentParts,
    on_iteration: &(dyn Fn(Progress) + Sync),
    on_simulation: &(dyn Fn(usize, SimulationRecord) -> Result<(), E> + Sync),
) -> Result<(), E> {
    let numbered: Vec<(usize, &SimulationTask)> = numbers
        .iter()
        .filter_map(|&i| Some((i, tasks.get(i)?)))
        .collect();
    // Neighboring tasks of one source share the scenario: opening a recording can take longer than
    // simulating it.
    let groups: Vec<&[(usize, &SimulationTask)]> = numbered
        .chunk_by(|(_, a), (_, b)| a.source == b.source)
        .collect();
    groups.par_iter().try_for_each(|group| {
        let Some((_, first)) = group.first() else {
            return Ok(());
        };
        let opened = catch_panic(|| {
            first
                .source
                .open()
                .map(Arc::new)
                .map_err(|error| with_causes(&error))
        });
        group.par_iter().try_for_each(|&(i, task)| {
            let scenario = opened.as_ref().map_err(String::as_str);
            on_simulation(i, record(task, scenario, parts, on_iteration))
        })
    })
}

fn record(
    task: &SimulationTask,
    scenario: Result<&Arc<Scenario>, &str>,
    parts: &AgentParts,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> SimulationRecord {
    let SimulationTask {
        source,
        planner,
        challenge,
    } = task;
    let started_s = now_s();
    let outcome = scenario.map_err(str::to_owned).and_then(|scenario| {
        // One simulation that panics must not end the others of the run.
        catch_panic(|| simulate_task(scenario, *planner, *challenge, parts, on_iteration))
    });
    let opened = scenario.ok();
    SimulationRecord {
        source: source.to_string(),
        scenario: opened
            .map(|scenario| scenario.id.clone())
            .or_else(|| source.id().map(str::to_owned))
            .unwrap_or_else(|| source.to_string()),
        scenario_type: opened
            .map(|scenario| scenario.scenario_type.as_str())
            .or_else(|| source.scenario_type())
            .unwrap_or(UNKNOWN_TYPE)
            .to_owned(),
        log_name: opened
            .map_or_else(|| source.log_name(), |scenario| &scenario.log_name)
            .to_owned(),
        planner: *planner,
        challenge: *challenge,
        started_s,
        ended_s: now_s(),
        outcome,
    }
}

/// Seconds since 1970.
fn now_s() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

fn simulate_task(
    scenario: &Arc<Scenario>,
    planner: PlannerName,
    challenge: Challenge,
    parts: &AgentParts,
    on_iteration: &(dyn Fn(Progress) + Sync),
) -> Result<SimulationOutcome, String> {
    // Only a policy that was given is started; without it, the first step fails.
    let own = parts
        .agents
        .as_ref()
        .filter(|agents| Some(agents.name) == challenge.own_agents());
    let held = || HeldScenario::Shared(Arc::clone(scenario));
    let prepared = || match own {
        Some(agents) => ClosedLoop::with_agents(held(), challenge, |first| {
            agents.policy(scenario, first, parts.stop.as_ref())
        }),
        None => ClosedLoop::new(held(), challenge),
    };
    let entry = parts.registry.find(planner.as_str());
    let ahead = match entry.map_err(|error| with_causes(&error))?.needs {
        PlannerNeeds::Simulation => Some(prepared().map_err(|error| with_causes(&error))?),
        _ => None,
    };
    let mut planner = parts
        .planner_in(planner, scenario, ahead.as_ref())
        .map_err(|error| with_causes(&error))?;
    let log = prepared()
        .and_then(|simulation| {
            simulate_prepared(simulation, planner.as_mut(), challenge, &mut |p| {
                on_iteration(p);
            })
        })
        .map_err(|error| with_causes(&error))?;
    let (calls, drivable_layers) = (planner.take_calls(), planner.drivable_layers());
    let Evaluation { score, metrics, .. } = log
        .evaluate(scenario)
        .map_err(|error| with_causes(&error))?;
    Ok(SimulationOutcome {
        scenario: Arc::clone(scenario),
        score,
        metrics,
        calls,
        drivable_layers,
        log,
    })
}

/// An error with all its causes in one line, without the middle of a long one.
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
    shortened(&text).into_owned()
}
