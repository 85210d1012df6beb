//! Studies: the paper's tables and figures, and others beyond them, as data. A study is a TOML file
//! of variants that simulate the same scenes, each compared with one of them. The built-in ones lie
//! in `studies/`.

mod catalogue;
mod paper;

pub use catalogue::{StudyError, all, find, names};
pub use paper::{Benchmark, Published, PublishedModel, Reported};
pub(crate) use paper::{benchmark, reported_benchmarks};

use planagent_scenario::ScenarioRef;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Variants that simulate the same scenes, each compared with one of them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Its name, which is that of the folder of its results.
    pub name: String,
    /// The word that finds it: its name, or the path of a user's file.
    #[serde(skip)]
    pub word: String,
    pub title: String,
    /// Where the paper has it.
    #[serde(default)]
    pub paper: Option<String>,
    /// Heads of the columns that name a variant.
    pub labels: Vec<String>,
    /// Place of the variant that the others are compared with, from 0.
    #[serde(default)]
    pub reference: usize,
    /// Its suites, as `--suite` takes them.
    pub suites: Vec<String>,
    /// What a row of its table is.
    #[serde(default)]
    pub rows: Rows,
    /// How the suite `recorded` is taken: once, or from several start times.
    #[serde(default)]
    pub starts: Option<Starts>,
    /// Columns beside the scores.
    #[serde(default)]
    pub columns: Vec<Column>,
    #[serde(default)]
    pub figure: Figure,
    /// Notes below its table.
    #[serde(default)]
    pub remarks: Vec<String>,
    /// What is compared.
    pub variants: Vec<Variant>,
}

/// A planner with its settings.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variant {
    /// Its name, a text for each of the study's labels.
    pub labels: Vec<String>,
    #[serde(default = "plan_agent")]
    pub planner: String,
    /// Configuration keys that it replaces.
    #[serde(default)]
    pub settings: toml::Table,
    /// The paper's numbers of it.
    #[serde(default)]
    pub published: Published,
    /// What READMEs of planners report of it.
    #[serde(default)]
    pub reported: Reported,
    /// Its place on the horizontal axis of a line figure.
    #[serde(default)]
    pub x: Option<f64>,
}

fn plan_agent() -> String {
    planagent_agent::planner::PlannerName::PLAN_AGENT.to_string()
}

/// The start times of a recording: the usual one, and later ones while enough is left.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Starts {
    /// Time between two of them, seconds.
    pub every_s: f64,
    /// Time that is left behind the last, seconds.
    pub least_s: f64,
}

/// What a row of a table is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rows {
    /// A variant, over all scenes.
    #[default]
    Variants,
    /// A scenario type, with the variants side by side.
    ScenarioTypes,
    /// A variant, and in further tables a recording. Intervals are over recordings: scenes of one
    /// recording are drawn together.
    Recordings,
}

/// A column beside the scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// Parameters of the model, ours and the paper's.
    Parameters,
    /// Median time of a planning call, ours and the paper's. A measurement.
    CallTime,
    /// Planning calls in a simulation.
    Calls,
    /// Simulations with a collision that is the ego's fault.
    Collisions,
    /// Questions to the model in a planning call.
    Questions,
    /// Tokens that the model reads and writes in a planning call.
    Tokens,
    /// Planning calls whose answers gave no plan, and those that were refused.
    NoPlan,
    /// For each metric, what the score would gain if that metric alone were perfect.
    Lost,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// Differences to the reference with their intervals.
    #[default]
    Differences,
    /// Scores over [`Variant::x`], with the title of that axis.
    Lines(String),
    /// A bar for each variant and scenario type.
    Bars,
}

impl Study {
    /// A variant's name: its label; of several yes-or-no labels, those that it lacks; of other
    /// ones, all that say something.
    pub fn name_of(&self, variant: &Variant) -> String {
        if let [name] = &variant.labels[..] {
            return name.clone();
        }
        let labelled = || self.labels.iter().zip(&variant.labels);
        if !variant
            .labels
            .iter()
            .all(|label| [YES, NO].contains(&label.as_str()))
        {
            let said = labelled().filter(|(_, label)| !label.is_empty());
            return said
                .map(|(head, label)| format!("{head}: {label}"))
                .collect::<Vec<_>>()
                .join(", ");
        }
        let missing: Vec<&str> = labelled()
            .filter(|(_, label)| *label == NO)
            .map(|(head, _)| head.as_str())
            .collect();
        if missing.is_empty() {
            "the whole agent".to_owned()
        } else {
            format!("no {}", missing.join(", no "))
        }
    }

    /// Whether it compares the cost of models.
    pub(crate) fn measures_models(&self) -> bool {
        let is_of_models =
            |column: &Column| matches!(column, Column::Parameters | Column::CallTime);
        self.columns.iter().any(is_of_models)
    }

    /// Refuses a study whose parts do not fit together.
    fn check(&self) -> Result<(), String> {
        let safe = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(safe) {
            return Err(format!(
                "name is {:?}; it must be a folder name of letters, digits, '-', '_' and '.'",
                self.name
            ));
        }
        if self.suites.is_empty() || self.labels.is_empty() {
            return Err("suites and labels must not be empty".to_owned());
        }
        let count = self.variants.len();
        if self.reference >= count {
            return Err(format!(
                "reference is {}; there are {count} variants, counted from 0",
                self.reference
            ));
        }
        if self
            .starts
            .is_some_and(|starts| !(starts.every_s > 0.0 && starts.least_s > 0.0))
        {
            return Err("starts.every_s and starts.least_s must be above 0".to_owned());
        }
        let mut seen = BTreeSet::new();
        let needs_x = matches!(self.figure, Figure::Lines(_));
        // A table has a cell for each label, and a row for each variant.
        for Variant { labels, x, .. } in &self.variants {
            if labels.len() != self.labels.len() {
                return Err(format!(
                    "variant {labels:?} has {} labels; the study has {}",
                    labels.len(),
                    self.labels.len()
                ));
            }
            if !seen.insert(labels) {
                return Err(format!("two variants have the labels {labels:?}"));
            }
            let fault = match (x.is_some(), needs_x) {
                (false, true) => "x is missing, its place on the axis of figure.lines",
                (true, false) => "x is given, but the study has no figure.lines; leave it out",
                _ => continue,
            };
            return Err(format!("variant {labels:?}: {fault}"));
        }
        Ok(())
    }
}

/// Labels of what a variant has,
const YES: &str = "yes";
/// and of what it lacks.
const NO: &str = "no";

/// How many scenes of each type a quick study takes, and how many whose type is not known
/// before they are opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Quick {
    /// Of each type.
    pub per_type: usize,
    /// Without a type.
    pub untyped: usize,
}

impl Quick {
    /// The numbers of `--quick`: enough to see whether everything works, and large differences.
    pub const DEFAULT: Self = Self {
        per_type: 2,
        untyped: 14,
    };

    /// The first scenes of each type.
    pub fn select(self, mut sources: Vec<ScenarioRef>) -> Vec<ScenarioRef> {
        let mut taken: BTreeMap<Option<String>, usize> = BTreeMap::new();
        sources.retain(|source| {
            let kind = source.scenario_type().map(str::to_owned);
            let max = if kind.is_some() {
                self.per_type
            } else {
                self.untyped
            };
            let taken = taken.entry(kind).or_default();
            *taken += 1;
            *taken <= max
        });
        sources
    }
}
