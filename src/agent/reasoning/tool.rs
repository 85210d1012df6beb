//! The record of a tool that a model called.

use serde::{Deserialize, Serialize};

/// A tool that a model called in a round, and what it got.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolUse {
    /// Name of the tool, as far as the call names one.
    pub function: String,
    /// The arguments as the model wrote them.
    pub arguments: String,
    /// The text that the tool gave, or what is wrong with the call.
    pub result: String,
    /// Whether the call was wrong.
    pub failed: bool,
}
