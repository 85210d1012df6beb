//! Descriptions of a scene that an agent's model reads, for tables of their tokens.

use planagent_agent::environment::GraphedScene;

/// A description of a scene.
#[derive(Debug)]
pub struct DescribedText {
    /// Its name in files.
    pub key: &'static str,
    /// Its name in tables.
    pub name: &'static str,
    /// What it has, in words.
    pub definition: &'static str,
    /// What the paper counts for it on nuPlan, tokens.
    pub published: Option<f64>,
    /// Describes a scene.
    pub describe: fn(GraphedScene<'_>) -> String,
}
