//! How the memories of agents are filled. An agent says what a log or a drive leaves; who reads the logs
//! and drives stands outside of this crate.

use planagent_agent::planner::{AgentKeys, AgentSettings, AskedModel, PlannerError, PlanningCall};
use planagent_world::{EgoState, SceneView};
use serde::Serialize;
use serde_json::Value;

/// How the memory of an agent is filled.
#[derive(Debug, Clone, Copy)]
pub struct MemoryFiller {
    /// The agent, with its settings.
    pub keys: AgentKeys,
    /// A line about what is kept.
    pub about: &'static str,
    /// What it is filled from.
    pub source: MemorySource,
}

/// What a memory is filled from. Items are those of the agent's memory, as JSON.
#[derive(Debug, Clone, Copy)]
pub enum MemorySource {
    /// Logs, without a model.
    Logs {
        /// Frames between two items.
        every: usize,
        /// Length of what follows an item, frames.
        future: usize,
        /// What a scene of a scenario and the ego's next states leave.
        item: fn(&str, &SceneView<'_>, &[EgoState]) -> Option<Value>,
    },
    /// Drives of the agent.
    Drives(fn(&LeftDrive<'_>) -> Result<LeftItems, PlannerError>),
}

/// What a drive leaves: items, or why there are none.
pub type LeftItems = Result<Vec<Value>, String>;

/// A drive that has ended.
pub struct LeftDrive<'a> {
    /// The scenario.
    pub scenario: &'a str,
    /// The planning calls.
    pub calls: &'a [PlanningCall],
    /// The iteration at which the ego first touched something.
    pub collided_at: Option<usize>,
    /// The model that drove, which may be asked for a lesson.
    pub asked: &'a AskedModel,
    /// What is set of the agent's settings.
    pub settings: &'a AgentSettings,
    /// Seed of what is drawn.
    pub seed: u64,
}

/// An item as JSON.
pub(crate) fn item(value: impl Serialize) -> Option<Value> {
    serde_json::to_value(value).ok()
}
