//! `summary.json`: scores only, no measured times, the same bytes for the same seed.

use crate::experiment::run::DriveRecord;
use crate::metrics::Score;
use crate::mllm::ModelDescription;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

/// One drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScenarioRow {
    /// Name of the scenario.
    pub id: String,
    /// nuPlan's type.
    pub scenario_type: String,
    /// Name of the log.
    pub log_name: String,
    /// Who drove.
    pub planner: String,
    /// Among which traffic.
    pub challenge: String,
    /// Whether the drive came to its end.
    pub succeeded: bool,
    /// Why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// nuPlan's score in [0, 1] with its metrics.
    #[serde(flatten)]
    pub score: Option<ScoreColumns>,
    /// Planning calls that were made.
    pub planning_calls: usize,
    /// Attempts after the first of their call.
    pub rethinks: usize,
    /// What could not be read of the answers.
    pub parse_errors: usize,
}

/// The score, the metrics that it is made of under nuPlan's names, and the multipliers that made it 0 (`zeroed_by`).
#[derive(Debug, Clone, PartialEq)]
pub struct ScoreColumns(Score);

impl From<&Score> for ScoreColumns {
    fn from(score: &Score) -> Self {
        Self(score.clone())
    }
}

impl Serialize for ScoreColumns {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("score", &self.0.value)?;
        for part in &self.0.parts {
            map.serialize_entry(part.name.as_str(), &part.score)?;
        }
        map.serialize_entry("zeroed_by", &self.0.zero_multipliers().collect::<Vec<_>>())?;
        map.end()
    }
}

impl From<&DriveRecord> for ScenarioRow {
    fn from(record: &DriveRecord) -> Self {
        let driven = record.outcome.as_ref().ok();
        let calls = driven.map_or(&[][..], |driven| driven.calls.as_slice());
        Self {
            id: record.scenario.clone(),
            scenario_type: record.scenario_type.clone(),
            log_name: record.log_name.clone(),
            planner: record.planner.to_string(),
            challenge: record.challenge.to_string(),
            succeeded: driven.is_some(),
            error: record.outcome.as_ref().err().cloned(),
            score: driven.map(|driven| ScoreColumns::from(&driven.score)),
            planning_calls: calls.len(),
            rethinks: calls.iter().map(crate::planner::PlanningCall::rethinks).sum(),
            parse_errors: calls.iter().map(crate::planner::PlanningCall::parse_errors).sum(),
        }
    }
}

/// Mean score of one planner in one challenge, over the drives that came to their end (nuPlan's rule).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Aggregate {
    /// Who drove.
    pub planner: String,
    /// Among which traffic.
    pub challenge: String,
    /// Drives that count.
    pub scenarios: usize,
    /// Drives that failed and do not count.
    pub failed: usize,
    /// Mean score in [0, 1]; none without a drive that counts.
    pub score: Option<f64>,
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Version of the program.
    pub planagent: String,
    /// Seed of the run.
    pub seed: u64,
    /// The model, when one was loaded.
    pub model: Option<ModelDescription>,
    /// A row a drive, in the order in which they were asked for.
    pub scenarios: Vec<ScenarioRow>,
    /// A row a planner and challenge.
    pub aggregates: Vec<Aggregate>,
}

impl Summary {
    /// The summary of all drives of a run.
    pub fn new(seed: u64, model: Option<ModelDescription>, records: &[DriveRecord]) -> Self {
        Self {
            planagent: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            model,
            scenarios: records.iter().map(ScenarioRow::from).collect(),
            aggregates: aggregates(records),
        }
    }
}

fn aggregates(records: &[DriveRecord]) -> Vec<Aggregate> {
    let mut rows: Vec<Aggregate> = Vec::new();
    for record in records {
        let (planner, challenge) = (record.planner.to_string(), record.challenge.to_string());
        let known = rows.iter_mut().find(|row| row.planner == planner && row.challenge == challenge);
        let score = record.outcome.as_ref().ok().map(|driven| driven.score.value);
        if let Some(row) = known {
            row.count(score);
        } else {
            let mut row = Aggregate { planner, challenge, scenarios: 0, failed: 0, score: None };
            row.count(score);
            rows.push(row);
        }
    }
    rows
}

impl Aggregate {
    /// Takes one more drive into the mean.
    fn count(&mut self, score: Option<f64>) {
        let Some(score) = score else {
            self.failed += 1;
            return;
        };
        let sum = self.score.unwrap_or(0.0) * self.scenarios as f64 + score;
        self.scenarios += 1;
        self.score = Some(sum / self.scenarios as f64);
    }
}
