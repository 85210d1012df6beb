//! What is kept of a drive when it has ended: `record.toml` of its folder.

use super::number::unsigned_zero;
use super::timing::CallTimes;
use crate::experiment::run::SimulationRecord;
use crate::metrics::ScenarioRow;
use crate::pdm::DrivableLayers;
use crate::planner::PlanningCall;
use crate::reasoning::Interruption;
use crate::simulation::Challenge;
use serde::{Deserialize, Serialize};

/// A drive that was made, or why it could not be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationRow {
    /// Its number in the run, from 0.
    pub number: usize,
    /// The source in the words of the command line.
    pub source: String,
    /// Name of the scenario.
    pub scenario: String,
    /// nuPlan's type.
    pub scenario_type: String,
    /// Name of the log.
    pub log_name: String,
    /// Who drove.
    pub planner: String,
    /// Among which traffic.
    pub challenge: Challenge,
    /// Why there is no result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// nuPlan's score in [0, 1]; none for a failed drive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The multipliers that made the score 0.
    #[serde(default)]
    pub zeroed_by: Vec<String>,
    /// Planning calls that were made.
    pub planning_calls: usize,
    /// Planning calls that the gate saved; they are not among the others.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub gated_calls: usize,
    /// Attempts after the first of their call.
    pub rethinks: usize,
    /// What could not be read of the answers.
    pub parse_errors: usize,
    /// Planning calls that their deadline ended.
    #[serde(default)]
    pub deadlines: usize,
    /// Planning calls that a failure of the model ended.
    #[serde(default)]
    pub failed_calls: usize,
    /// What counted as drivable, for `pdm-closed`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drivable_layers: Option<DrivableLayers>,
    /// What was measured.
    pub time: SimulationTime,
    /// The metrics' scores, in nuPlan's order of computation; their statistics lie in `metrics.toml`.
    #[serde(default)]
    pub metrics: Vec<MetricScore>,
}

/// For fields that most records can do without.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
pub(super) fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// The score of one metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MetricScore {
    /// nuPlan's name.
    pub name: String,
    /// Its score in [0, 1]; none for metrics that do not enter the score.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
}

/// What was measured of a drive.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationTime {
    /// Begin, seconds since 1970.
    pub started_s: f64,
    /// End, seconds since 1970.
    pub ended_s: f64,
    /// Time that the planner took at each iteration, seconds.
    pub planner_s: Vec<f64>,
    /// The planning calls by part.
    pub calls: Vec<CallTimes>,
}

impl SimulationRow {
    /// What is kept of a record.
    pub fn new(number: usize, record: &SimulationRecord) -> Self {
        let driven = record.outcome.as_ref().ok();
        let calls = driven.map_or(&[][..], |driven| driven.calls.as_slice());
        let gated_calls = calls.iter().filter(|call| call.is_gated()).count();
        let score = driven.map(|driven| &driven.score);
        let interrupted =
            |why: fn(&Interruption) -> bool| calls.iter().filter(|call| call.interruption().is_some_and(why)).count();
        let metrics = driven.map_or(&[][..], |driven| driven.metrics.as_slice());
        Self {
            number,
            source: record.source.clone(),
            scenario: record.scenario.clone(),
            scenario_type: record.scenario_type.clone(),
            log_name: record.log_name.clone(),
            planner: record.planner.to_string(),
            challenge: record.challenge,
            error: record.outcome.as_ref().err().cloned(),
            score: score.map(|score| unsigned_zero(score.value)),
            zeroed_by: score.map_or_else(Vec::new, |score| score.zero_multipliers().map(|m| m.to_string()).collect()),
            planning_calls: calls.len() - gated_calls,
            gated_calls,
            rethinks: calls.iter().map(PlanningCall::rethinks).sum(),
            parse_errors: calls.iter().map(PlanningCall::parse_errors).sum(),
            deadlines: interrupted(|why| matches!(why, Interruption::Deadline)),
            failed_calls: interrupted(|why| matches!(why, Interruption::Model(_))),
            drivable_layers: driven.and_then(|driven| driven.drivable_layers),
            time: SimulationTime {
                started_s: record.started_s,
                ended_s: record.ended_s,
                planner_s: driven.map_or_else(Vec::new, |driven| driven.log.runtimes_s.clone()),
                calls: calls.iter().filter(|call| !call.is_gated()).map(CallTimes::of).collect(),
            },
            metrics: metrics
                .iter()
                .map(|m| MetricScore { name: m.name.clone(), score: m.score.map(unsigned_zero) })
                .collect(),
        }
    }

    /// Which drive of a run this is, in words.
    pub fn identity(&self) -> String {
        format!("{} by {} in {}", self.source, self.planner, self.challenge)
    }

    /// The score of a metric.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics.iter().find(|metric| metric.name == name).and_then(|metric| metric.score)
    }

    /// The drive as the aggregation takes it; none for a failed one, which does not count. The metrics of the score come
    /// first and in its order, so that the aggregation's sums are the score's to the last bit.
    pub fn scenario_row(&self) -> Option<ScenarioRow> {
        let scored = self.challenge.metric_list().scored();
        let place = |name: &str| scored.clone().position(|metric| metric.name == name).unwrap_or(usize::MAX);
        let mut metrics: Vec<_> = self.metrics.iter().map(|metric| (metric.name.clone(), metric.score)).collect();
        metrics.sort_by_key(|(name, _)| place(name));
        self.score.map(|_| ScenarioRow {
            scenario: self.scenario.clone(),
            log_name: self.log_name.clone(),
            scenario_type: self.scenario_type.clone(),
            planner: self.planner.clone(),
            metrics,
        })
    }
}
