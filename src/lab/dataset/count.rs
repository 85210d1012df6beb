//! Counts over a dataset: how often a state shows what a model must not overlook.

use super::shard::{self, ShardError};
use planagent_agent::environment::facts::Question;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

/// Questions whose other answers than `none` are rare.
const RARE: [Question; 5] = [
    Question::Blocked,
    Question::Pedestrian,
    Question::CrossingVehicle,
    Question::OncomingVehicle,
    Question::PersonOnPath,
];

/// What is counted of a state.
#[derive(Deserialize)]
struct Row {
    state: String,
    facts: BTreeMap<String, String>,
    #[serde(default)]
    twin: Option<String>,
}

/// Counts of one split with all its shards.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    pub states: usize,
    /// States of modified scenarios.
    pub modified: usize,
    /// States of scenarios that are drawn from wider ranges.
    pub wide: usize,
    /// States of text twins.
    pub twins: usize,
    /// States of each lateral instruction.
    pub lateral: BTreeMap<String, usize>,
    /// States that have what a question asks for: another answer than `none`.
    pub asked: BTreeMap<String, usize>,
}

impl Counts {
    /// Reads all shards of a split: `train`, `validation`.
    ///
    /// # Errors
    /// When a shard cannot be read.
    pub fn read(folder: &Path, split: &str) -> Result<Self, ShardError> {
        let mut counts = Self::default();
        for line in shard::lines(folder, split)? {
            counts.add(&serde_json::from_str(&line)?);
        }
        Ok(counts)
    }

    fn add(&mut self, row: &Row) {
        self.states += 1;
        self.modified += usize::from(
            row.state.contains(planagent_scenario::modified::MARK) && row.twin.is_none(),
        );
        self.wide += usize::from(row.state.contains("/wide/"));
        self.twins += usize::from(row.twin.is_some());
        if let Some(lateral) = row.facts.get("lateral") {
            *self.lateral.entry(lateral.clone()).or_default() += 1;
        }
        for question in RARE.map(|question| question.to_string()) {
            if let Some(answer) = row.facts.get(&question) {
                *self.asked.entry(question).or_default() += usize::from(answer != "none");
            }
        }
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = |count: usize| {
            format!(
                "{count} ({:.1} %)",
                100.0 * count as f64 / self.states.max(1) as f64
            )
        };
        let Self {
            states,
            modified,
            wide,
            twins,
            ..
        } = *self;
        write!(
            f,
            "{states} states: {} modified, {} wide, {} of twins",
            share(modified),
            share(wide),
            share(twins)
        )?;
        let counted = self.lateral.iter().chain(&self.asked);
        counted
            .into_iter()
            .try_for_each(|(name, &count)| write!(f, "\n  {name}: {}", share(count)))
    }
}
