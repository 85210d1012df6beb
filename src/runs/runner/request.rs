//! What a run is asked to simulate.

use super::commands::{CommandError, Commands, agent_command};
use super::config::Config;
use super::error::RunnerError;
use super::event::Listener;
use super::model::{LoadedModel, load_model};
use super::shard::Shard;
use crate::worker::StopSwitch;
use planagent_agent::planner::{DEFAULT_EXEC_TIMEOUT, ExecCommand};
use planagent_agent::planner_registry::PlannerRegistry;
use planagent_planners::all_planners;
use planagent_scenario::{DataRoots, Readers};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// What to simulate, in the words of the command line. An empty field takes the value of the run
/// that is resumed, else the default: one generated scenario, `plan-agent`, non-reactive agents.
#[derive(Debug, Clone)]
pub struct Request {
    /// Files, folders, `LOG.db#TOKEN`, `generated/TYPE/SEED`.
    pub scenarios: Vec<String>,
    /// Names of splits, or filter files.
    pub splits: Vec<String>,
    /// Only scenarios of these types; without any, all.
    pub types: Vec<String>,
    /// Whether the scenarios are taken in an order that the seed draws.
    pub shuffle: bool,
    /// Maximum number of scenarios, taken evenly from the types.
    pub limit: Option<usize>,
    /// Only one part of the scenarios; other processes simulate the others.
    pub shard: Option<Shard>,
    /// Names of planners, or commands as `exec:COMMAND` or `NAME=exec:COMMAND`.
    pub planners: Vec<String>,
    /// Time that a command may take for a step.
    pub exec_timeout: Duration,
    /// Names of challenges; `both` stands for the closed-loop ones.
    pub challenges: Vec<String>,
    /// A command that controls the other agents, as `exec:COMMAND` or `NAME=exec:COMMAND`.
    pub agents: Option<String>,
    /// The planners that names refer to.
    pub registry: PlannerRegistry,
    /// Makes the readers that scenario words refer to.
    pub readers: fn(&DataRoots) -> Readers,
    /// Loads the model, once one of the planners needs it. A process of several runs may keep it.
    pub loader: fn(&Config, &Listener) -> Result<Arc<LoadedModel>, RunnerError>,
    /// Folders of nuPlan's data.
    pub roots: DataRoots,
    /// Whether to repeat the failed simulations of the run that is resumed.
    pub retry_failed: bool,
    /// Whether the run is resumed although what it reads changed; its manifest then says so.
    pub accept_changes: bool,
    /// Ends the run early; what is completed by then can be resumed.
    pub stop: Option<StopSwitch>,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            scenarios: Vec::new(),
            splits: Vec::new(),
            types: Vec::new(),
            shuffle: false,
            limit: None,
            shard: None,
            planners: Vec::new(),
            exec_timeout: DEFAULT_EXEC_TIMEOUT,
            challenges: Vec::new(),
            agents: None,
            registry: all_planners(),
            readers: Readers::new,
            loader: |config, listener| load_model(config, listener).map(Arc::new),
            roots: DataRoots::default(),
            retry_failed: false,
            accept_changes: false,
            stop: None,
        }
    }
}

impl Request {
    /// Whether it says which scenarios are meant.
    pub(super) fn names_scenarios(&self) -> bool {
        !self.scenarios.is_empty()
            || !self.splits.is_empty()
            || self.draws()
            || self.shard.is_some()
    }

    /// Whether it selects from what words and splits name.
    pub(super) fn draws(&self) -> bool {
        !self.types.is_empty() || self.shuffle || self.limit.is_some()
    }

    /// The request with its commands in the registry and by their names, and the commands by these.
    pub(super) fn with_commands(&self) -> Result<(Self, Commands), CommandError> {
        let (mut request, mut commands) = (self.clone(), BTreeMap::new());
        for word in &mut request.planners {
            let Some(command) = ExecCommand::parse(word).transpose()? else {
                continue;
            };
            *word = command.name.to_string();
            if commands.get(word.as_str()) == Some(&command.command) {
                continue;
            }
            request.registry = request.registry.with_stoppable_command(
                &command,
                self.exec_timeout,
                self.stop.as_ref(),
            )?;
            commands.insert(word.clone(), command.command);
        }
        let agents = self
            .agents
            .as_deref()
            .map(|word| agent_command(word, self.exec_timeout))
            .transpose()?;
        Ok((
            request,
            Commands {
                planners: commands,
                agents,
            },
        ))
    }

    /// Whether it only resumes a run, as that was started.
    pub(super) fn is_plain_resume(&self) -> bool {
        !self.names_scenarios()
            && self.planners.is_empty()
            && self.challenges.is_empty()
            && self.agents.is_none()
            && !self.retry_failed
    }
}
