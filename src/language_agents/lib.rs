//! The other language agents of the paper's comparison: GPT-Driver, DiLu and Agent-Driver, ported to
//! nuPlan's closed loop with our own prompts.
//!
//! An agent is an observation, a prompt set, a grammar for its answer, and a way to turn the answer
//! into a trajectory: [`agent::LanguageAgent`]. [`planner::LanguagePlanner`] makes it a planner.
//! What each port changes stands in docs/agents.md.

mod agent;
mod chat;
mod entry;
mod gpt_driver;
mod oracle;
mod planner;
mod waypoints;

pub use entry::entries;

#[cfg(test)]
mod tests;
