//! The other language agents of the paper's comparison: GPT-Driver, DiLu and Agent-Driver, ported to
//! nuPlan's closed loop with our own prompts.
//!
//! An agent is an observation, a prompt set, a grammar for its answer, and a way to turn the answer
//! into a trajectory: [`agent::LanguageAgent`]. [`planner::LanguagePlanner`] makes it a planner.
//! What each port changes stands in docs/agents.md.

mod agent;
mod agent_driver;
mod chat;
mod described;
mod dilu;
mod entry;
mod fill;
mod gpt_driver;
mod made;
mod memory;
mod oracle;
mod planner;
mod teaching;
mod waypoints;

pub use described::DescribedText;
pub use entry::{described_texts, entries, fillers, taught_agents, teacher};
pub use fill::{LeftDrive, LeftItems, MemoryFiller, MemorySource};
pub use memory::Memory;
pub use teaching::{SearchedState, TaughtAnswer, Teacher};

#[cfg(test)]
mod agent_driver_tests;
#[cfg(test)]
mod dilu_tests;
#[cfg(test)]
mod teaching_tests;
#[cfg(test)]
mod tests;
