//! `record.toml`: the row of one simulation.

use super::decision::{all_are_zero, all_refused, first_refused};
use super::file_names::name_part;
use super::number::positive_zero;
use super::recorded;
use super::times::{CallTimes, SimulationTime};
use crate::worker::run::SimulationRecord;
use planagent_agent::planner::{NoPlan, PlanningCall, Unreadable};
use planagent_agent::reasoning::Interruption;
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::{
    METRICS, MetricSpec, ScenarioRow, Weighting, combine, scored_metrics,
};
use planagent_score::pdm::DrivableLayers;
use planagent_world::InteractionKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The result of a simulation, or why it failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulationRow {
    /// Its number in the run, from 0.
    pub number: usize,
    /// The scenario's source as on the command line.
    #[serde(deserialize_with = "recorded::name")]
    pub source: String,
    /// Name of the scenario.
    #[serde(deserialize_with = "recorded::name")]
    pub scenario: String,
    /// nuPlan's scenario type.
    #[serde(deserialize_with = "recorded::name")]
    pub scenario_type: String,
    /// Name of the log.
    #[serde(deserialize_with = "recorded::name")]
    pub log_name: String,
    /// Name of the planner.
    #[serde(deserialize_with = "name_part")]
    pub planner: String,
    /// nuPlan's challenge.
    pub challenge: Challenge,
    /// Why the simulation failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// nuPlan's score in [0, 1]; none if the simulation failed.
    #[serde(
        default,
        deserialize_with = "recorded::score",
        skip_serializing_if = "Option::is_none"
    )]
    pub score: Option<f64>,
    /// The multipliers that made the score 0.
    #[serde(default)]
    pub zeroed_by: Vec<String>,
    /// Planning calls, without the gated ones.
    #[serde(deserialize_with = "recorded::count")]
    pub planning_calls: usize,
    /// Planning calls that the gate skipped.
    #[serde(
        default,
        deserialize_with = "recorded::count",
        skip_serializing_if = "is_zero"
    )]
    pub gated_calls: usize,
    /// Planning calls in which Reflection refused all attempts.
    #[serde(default, deserialize_with = "recorded::count")]
    pub refused_calls: usize,
    /// Planning calls in which Reflection refused the first attempt.
    #[serde(
        default,
        deserialize_with = "recorded::count",
        skip_serializing_if = "is_zero"
    )]
    pub first_refused_calls: usize,
    /// Planning calls in which every plan leaves the drivable area.
    #[serde(
        default,
        deserialize_with = "recorded::count",
        skip_serializing_if = "is_zero"
    )]
    pub off_area_calls: usize,
    /// Planning calls in which every plan leaves the route for more than 6 m.
    #[serde(
        default,
        deserialize_with = "recorded::count",
        skip_serializing_if = "is_zero"
    )]
    pub off_route_calls: usize,
    /// Attempts after the first of their call.
    #[serde(deserialize_with = "recorded::count")]
    pub rethinks: usize,
    /// Parse errors of the answers.
    #[serde(deserialize_with = "recorded::count")]
    pub parse_errors: usize,
    /// Planning calls that ended at their deadline.
    #[serde(default, deserialize_with = "recorded::count")]
    pub deadlines: usize,
    /// Planning calls that ended by an error of the model.
    #[serde(default, deserialize_with = "recorded::count")]
    pub failed_calls: usize,
    /// Planning calls in a scene without a lane graph.
    #[serde(
        default,
        deserialize_with = "recorded::count",
        skip_serializing_if = "is_zero"
    )]
    pub unmapped_calls: usize,
    /// What `pdm-closed` counted as drivable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drivable_layers: Option<DrivableLayers>,
    /// Planning calls whose answers gave no plan, by what was wrong with the last of them.
    #[serde(
        default,
        deserialize_with = "recorded::counts",
        skip_serializing_if = "BTreeMap::is_empty"
    )]
    pub unreadable_calls: BTreeMap<Unreadable, usize>,
    /// BLAKE3 of the other files of the simulation, by name: a damaged one counts as no simulation.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
    /// Wall times.
    pub time: SimulationTime,
    /// The metrics' scores, in nuPlan's order of computation; `metrics.toml` has their statistics.
    #[serde(default)]
    pub metrics: Vec<MetricScore>,
}

/// Lets serde omit fields that most records do not need.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
pub(super) fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// How many calls gave no plan for each cause.
fn counted(calls: &[PlanningCall]) -> BTreeMap<Unreadable, usize> {
    let mut counts = BTreeMap::new();
    for why in calls.iter().filter_map(PlanningCall::unreadable) {
        *counts.entry(why).or_default() += 1;
    }
    counts
}

/// The score of one metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MetricScore {
    /// nuPlan's name.
    #[serde(deserialize_with = "name_part")]
    pub name: String,
    /// The score in [0, 1]; none for metrics outside the score.
    #[serde(
        default,
        deserialize_with = "recorded::score",
        skip_serializing_if = "Option::is_none"
    )]
    pub score: Option<f64>,
}

impl SimulationRow {
    /// The row of a record.
    pub fn new(number: usize, record: &SimulationRecord) -> Self {
        let outcome = record.outcome.as_ref().ok();
        let calls = outcome.map_or(&[][..], |outcome| outcome.calls.as_slice());
        let gated_calls = calls.iter().filter(|call| call.is_gated()).count();
        let score = outcome.map(|outcome| &outcome.score);
        // All counts come from the same calls, so that table, page and exit code never disagree.
        let interrupted = |why: fn(&Interruption) -> bool| {
            calls
                .iter()
                .filter(|call| call.interruption().is_some_and(why))
                .count()
        };
        let metrics = outcome.map_or(&[][..], |outcome| outcome.metrics.as_slice());
        Self {
            number,
            source: record.source.clone(),
            scenario: record.scenario.clone(),
            scenario_type: record.scenario_type.clone(),
            log_name: record.log_name.clone(),
            planner: record.planner.to_string(),
            challenge: record.challenge,
            error: record.outcome.as_ref().err().cloned(),
            score: score.map(|score| positive_zero(score.value)),
            zeroed_by: score.map_or_else(Vec::new, |score| {
                score.zero_multipliers().map(ToString::to_string).collect()
            }),
            planning_calls: calls.len() - gated_calls,
            gated_calls,
            refused_calls: calls.iter().filter(|call| all_refused(call)).count(),
            first_refused_calls: calls.iter().filter(|call| first_refused(call)).count(),
            off_area_calls: calls
                .iter()
                .filter(|call| all_are_zero(call, |parts| parts.drivable_area))
                .count(),
            off_route_calls: calls
                .iter()
                .filter(|call| all_are_zero(call, |parts| parts.driving_direction))
                .count(),
            rethinks: calls.iter().map(PlanningCall::rethinks).sum(),
            parse_errors: calls.iter().map(PlanningCall::parse_errors).sum(),
            deadlines: interrupted(|why| matches!(why, Interruption::Deadline)),
            failed_calls: interrupted(|why| matches!(why, Interruption::Model(_))),
            unreadable_calls: counted(calls),
            unmapped_calls: calls
                .iter()
                .filter(|call| matches!(call.decision.no_plan(), Some(NoPlan::NoLaneGraph(_))))
                .count(),
            drivable_layers: outcome.and_then(|outcome| outcome.drivable_layers),
            files: BTreeMap::new(),
            time: SimulationTime {
                started_s: record.started_s,
                ended_s: record.ended_s,
                planner_s: outcome.map_or_else(Vec::new, |outcome| outcome.log.runtimes_s.clone()),
                calls: calls
                    .iter()
                    .filter(|call| !call.is_gated())
                    .map(CallTimes::from_call)
                    .collect(),
            },
            metrics: metrics
                .iter()
                .map(|m| MetricScore {
                    name: m.name.clone(),
                    score: m.score.map(positive_zero),
                })
                .collect(),
        }
    }

    /// Planning calls whose answers gave no plan.
    pub fn unreadable(&self) -> usize {
        self.unreadable_calls.values().sum()
    }

    /// Whether it had planning calls, and none gave a plan. Calls that ended at their deadline and
    /// gated ones do not count.
    pub fn is_without_plan(&self) -> bool {
        let asked = self.planning_calls.saturating_sub(self.deadlines);
        asked > 0 && asked <= self.failed_calls + self.unreadable() + self.unmapped_calls
    }

    /// Source, planner and challenge in words.
    pub fn identity(&self) -> String {
        format!("{} by {} in {}", self.source, self.planner, self.challenge)
    }

    /// The score of a metric.
    pub fn metric(&self, name: &str) -> Option<f64> {
        self.metrics
            .iter()
            .find(|metric| metric.name == name)
            .and_then(|metric| metric.score)
    }

    /// The kind by whose metrics it is scored: interPlan's in a modified scenario of its kinds.
    pub(crate) fn scored_kind(&self) -> Option<InteractionKind> {
        InteractionKind::named(&self.scenario_type)
            .filter(|_| self.metric("lane_changes_to_goal").is_some())
    }

    fn scored_metrics(&self) -> Vec<MetricSpec> {
        scored_metrics(self.challenge.metric_list(), self.scored_kind())
    }

    /// The names of the metrics of its score, in the order of that.
    pub fn scored(&self) -> Vec<&'static str> {
        self.scored_metrics()
            .iter()
            .map(|metric| metric.name)
            .collect()
    }

    /// What the score would gain, in [0, 1], if one metric were perfect and the others as they are:
    /// for each metric of the score, in the order of that. Empty for a failed simulation.
    pub fn lost(&self) -> Vec<(MetricSpec, f64)> {
        if self.score.is_none() {
            return Vec::new();
        }
        let weighting = match self.scored_kind() {
            Some(kind) => Weighting::of_kind(kind, &METRICS),
            None => Weighting::for_list(self.challenge.metric_list()),
        };
        let metrics = self.scored_metrics();
        let score = |perfect: Option<&str>| {
            let scores = metrics.iter().map(|metric| {
                let own = self.metric(metric.name);
                let is_perfect = perfect == Some(metric.name);
                (
                    metric.name,
                    own.map(|own| if is_perfect { 1.0 } else { own }),
                )
            });
            combine(scores, &weighting)
        };
        let now = score(None);
        let gain = |metric: &MetricSpec| (*metric, score(Some(metric.name)) - now);
        metrics.iter().map(gain).collect()
    }

    /// The input of nuPlan's aggregation; none for a failed simulation, which does not count. The
    /// scored metrics come first, in the order of the score, so that the aggregation sums in the
    /// same order to the last bit.
    pub fn scenario_row(&self) -> Option<ScenarioRow> {
        let scored = self.scored();
        let place = |name: &str| {
            scored
                .iter()
                .position(|metric| *metric == name)
                .unwrap_or(usize::MAX)
        };
        let mut metrics: Vec<_> = self
            .metrics
            .iter()
            .map(|metric| (metric.name.clone(), metric.score))
            .collect();
        metrics.sort_by_key(|(name, _)| place(name));
        self.score.map(|_| ScenarioRow {
            scenario: self.scenario.clone(),
            log_name: self.log_name.clone(),
            scenario_type: self.scenario_type.clone(),
            planner: self.planner.clone(),
            metrics,
        })
    }

    /// A row without metrics, as tests need it.
    #[doc(hidden)]
    pub fn example(
        kind: &str,
        seed: usize,
        planner: &str,
        challenge: Challenge,
        score: Option<f64>,
    ) -> Self {
        // The source is the name, as it is for generated scenarios.
        let source = format!("generated/{kind}/{seed}");
        Self {
            number: seed,
            scenario: source.clone(),
            source,
            scenario_type: kind.to_owned(),
            log_name: "generated".to_owned(),
            planner: planner.to_owned(),
            challenge,
            error: score.is_none().then(|| "it broke".to_owned()),
            score,
            zeroed_by: Vec::new(),
            planning_calls: 8,
            gated_calls: 0,
            refused_calls: 0,
            first_refused_calls: 0,
            off_area_calls: 0,
            off_route_calls: 0,
            rethinks: 0,
            parse_errors: 0,
            deadlines: 0,
            failed_calls: 0,
            unreadable_calls: BTreeMap::new(),
            unmapped_calls: 0,
            drivable_layers: None,
            files: BTreeMap::new(),
            time: SimulationTime::default(),
            metrics: Vec::new(),
        }
    }
}
