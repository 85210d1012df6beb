//! The paper's tables and figures, and what goes beyond them, as data: which variants are driven where, what they are compared
//! with, and what the paper has in their place.

mod catalogue;
mod paper;

pub use catalogue::{NAMES, all, named};
pub use paper::{Benchmark, Published, PublishedModel, Scores};

use crate::planner::PlannerName;
use crate::scenario::ScenarioRef;
use serde::Serialize;
use std::collections::BTreeMap;

/// An experiment: variants that drive the same scenes, each compared with one of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it shows, in a line.
    pub title: &'static str,
    /// Where the paper has it.
    pub paper: Option<&'static str>,
    /// Heads of the columns that name a variant.
    pub labels: &'static [&'static str],
    /// What is driven.
    pub variants: Vec<Variant>,
    /// Place of the variant that all are compared with.
    pub reference: usize,
    /// The suites that it is driven on unless others are asked for.
    pub suites: &'static [&'static str],
    /// What the rows of its table stand for.
    pub rows: Rows,
    /// Columns beside the scores.
    pub columns: &'static [Column],
    /// Its figure.
    pub figure: Figure,
    /// What a reader has to know.
    pub remarks: &'static [&'static str],
}

impl Study {
    /// A variant's name in a word or a few: its label; of several, what it goes without, or all.
    pub fn name_of(&self, variant: &Variant) -> String {
        if let [name] = variant.labels {
            return (*name).to_owned();
        }
        if !variant.labels.iter().all(|label| [YES, NO].contains(label)) {
            let labelled = self.labels.iter().zip(variant.labels);
            return labelled.map(|(head, label)| format!("{head}: {label}")).collect::<Vec<_>>().join(", ");
        }
        let labelled = self.labels.iter().zip(variant.labels);
        let missing: Vec<&str> = labelled.filter(|(_, label)| **label == NO).map(|(head, _)| *head).collect();
        if missing.is_empty() { "the whole agent".to_owned() } else { format!("no {}", missing.join(", no ")) }
    }

    /// Whether it is about what models cost.
    pub fn measures_models(&self) -> bool {
        self.columns.iter().any(|column| *column != Column::Calls)
    }
}

/// Labels of what a variant has,
pub(super) const YES: &str = "yes";
/// and of what it goes without.
pub(super) const NO: &str = "no";

/// A planner with settings of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// Its name, a word for each of the study's label columns.
    pub labels: &'static [&'static str],
    /// Who drives.
    pub planner: PlannerName,
    /// TOML that is laid over the configuration.
    pub settings: &'static str,
    /// What the paper has in its place.
    pub published: Published,
    /// Its place on the horizontal axis of a line figure.
    pub x: Option<f64>,
}

/// What the rows of a table stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rows {
    /// The variants, over all scenes.
    Variants,
    /// The scenario types: the variants side by side.
    ScenarioTypes,
}

/// A column beside the scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// Parameters of the language model, ours and the paper's.
    Parameters,
    /// Median time of a planning call, ours and the paper's. A measurement.
    CallTime,
    /// Planning calls in a drive.
    Calls,
}

/// How a study is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// Differences to the reference with their intervals.
    Differences,
    /// Scores over [`Variant::x`], whose meaning this is.
    Lines(&'static str),
    /// A bar a variant in each scenario type.
    Bars,
}

/// The benchmark of the paper that a split stands for; none for scenes of another kind.
pub fn benchmark(split: &str) -> Option<Benchmark> {
    match split {
        "generated-14" | "generated" | "val14" | "reduced-val14" => Some(Benchmark::Val14),
        "generated-14-hard" | "test14-hard" => Some(Benchmark::Test14Hard),
        _ => None,
    }
}

/// How many scenes of each type a quick experiment drives, and of those whose type is not known before they are opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Quick {
    /// Of each type.
    pub per_type: usize,
    /// Without a type.
    pub untyped: usize,
}

impl Quick {
    /// As `--quick` has it: enough to see whether everything works, and large differences.
    pub const DEFAULT: Self = Self { per_type: 2, untyped: 14 };

    /// The first scenes of each type.
    pub fn of(self, mut sources: Vec<ScenarioRef>) -> Vec<ScenarioRef> {
        let mut taken: BTreeMap<Option<String>, usize> = BTreeMap::new();
        sources.retain(|source| {
            let kind = source.scenario_type().map(str::to_owned);
            let most = if kind.is_some() { self.per_type } else { self.untyped };
            let taken = taken.entry(kind).or_default();
            *taken += 1;
            *taken <= most
        });
        sources
    }
}
