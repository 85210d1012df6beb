//! Commands that stand for planners or for the other agents of a run.

use planagent_agent::planner::{ExecCommand, ExecError};
use planagent_agent::simulation::{AgentCommand, AgentPolicyName};
use std::collections::BTreeMap;
use std::time::Duration;

/// Why a command cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum CommandError {
    #[error(
        "'{0}' is no command; expected exec:COMMAND or NAME=exec:COMMAND. Agents that replay the log, or follow IDM, are those of \
         --challenge nonreactive and reactive"
    )]
    NoCommand(String),
    #[error("'{0}' is the name of a challenge; name the command as NAME=exec:COMMAND")]
    Reserved(String),
    #[error(transparent)]
    Exec(#[from] ExecError),
}

/// The commands of a request.
#[derive(Debug, Clone, Default)]
pub struct Commands {
    /// Those of planners, by name.
    pub planners: BTreeMap<String, String>,
    /// That of the other agents.
    pub(super) agents: Option<AgentCommand>,
}

impl Commands {
    /// The policy of the other agents.
    pub(super) fn policy(&self) -> Option<AgentPolicyName> {
        self.agents.as_ref().map(|agents| agents.name)
    }

    /// The commands of agents, by name.
    pub(super) fn of_agents(&self) -> BTreeMap<String, String> {
        self.agents
            .iter()
            .map(|agents| (agents.name.to_string(), agents.command.clone()))
            .collect()
    }
}

/// The command of a word of `--agents`.
pub(super) fn agent_command(word: &str, timeout: Duration) -> Result<AgentCommand, CommandError> {
    let Some(parsed) = ExecCommand::parse(word) else {
        return Err(CommandError::NoCommand(word.to_owned()));
    };
    let ExecCommand { name, command } = parsed?;
    let name = AgentPolicyName::new(name.as_str())
        .ok_or_else(|| CommandError::Reserved(name.to_string()))?;
    Ok(AgentCommand {
        name,
        command,
        timeout,
    })
}
