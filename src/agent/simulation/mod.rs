//! Stage 7: the closed loop at 10 Hz. [`simulate`] runs a [`Planner`](crate::planner::Planner) on a
//! [`Scenario`](planagent_scenario::Scenario) and returns a [`SimulationLog`].
//!
//! One iteration k, as in the nuPlan devkit: the planner sees the history up to k and the logged
//! lights of k and returns a trajectory; the sample of k is saved; the two-stage controller moves
//! the ego to k+1 in the log's own time; the agents move to k+1 while they still see the ego at k.
//!
//! A [`Challenge`] names who controls the agents. To control them otherwise, implement
//! [`AgentPolicy`] and run [`simulate_with_agents`], or write a command in any language
//! ([`AgentCommand`]).

mod agent_name;
mod agents;
mod challenge;
mod closed_loop;
mod controller;
mod error;
mod exec_agents;
mod run;

#[cfg(test)]
mod tests;

pub use agent_name::AgentPolicyName;
pub use agents::{AGENT_POLICIES, AgentPolicy, AgentPolicyError, AgentPolicySpec};
pub use challenge::{Challenge, UnknownChallenge};
pub use closed_loop::ClosedLoop;
pub use error::SimulationError;
pub use exec_agents::AgentCommand;
pub use run::{Progress, SimulationLog, simulate, simulate_prepared, simulate_with_agents};
