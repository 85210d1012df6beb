//! `summary.json`: the scores, without wall times; equal seeds give equal bytes.

use super::simulation_row::{SimulationRow, is_zero};
use planagent_agent::planner::Unreadable;
use planagent_agent::simulation::Challenge;
use planagent_mllm::ModelDescription;
use planagent_scenario::MissingTokens;
use planagent_score::metrics::{AggregateRow, FINAL_SCORE, Weighting, aggregate, distinct};
use planagent_score::pdm::DrivableLayers;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// One simulation.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ScenarioSummary {
    /// Name of the scenario.
    pub id: String,
    /// nuPlan's scenario type.
    pub scenario_type: String,
    /// Name of the log.
    pub log_name: String,
    /// Name of the planner.
    pub planner: String,
    /// nuPlan's challenge.
    pub challenge: Challenge,
    /// Whether the simulation completed.
    pub succeeded: bool,
    /// Why the simulation failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// nuPlan's score in [0, 1].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The scored metrics by nuPlan's names, multipliers first.
    #[serde(flatten)]
    pub metrics: Map<String, Value>,
    /// The multipliers that made the score 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zeroed_by: Option<Vec<String>>,
    /// Planning calls, without the gated ones.
    pub planning_calls: usize,
    /// Planning calls that the gate skipped.
    #[serde(skip_serializing_if = "is_zero")]
    pub gated_calls: usize,
    /// Planning calls in which Reflection refused all attempts.
    pub refused_calls: usize,
    /// Attempts after the first of their call.
    pub rethinks: usize,
    /// Parse errors of the answers.
    pub parse_errors: usize,
    /// Planning calls that ended at their deadline.
    pub deadlines: usize,
    /// Planning calls that ended by an error of the model.
    pub failed_calls: usize,
    /// Planning calls whose answers gave no plan, by what was wrong with the last of them.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub unreadable_calls: BTreeMap<Unreadable, usize>,
    /// Whether it had planning calls and none gave a plan.
    #[serde(skip_serializing_if = "is_false")]
    pub without_plan: bool,
    /// What `pdm-closed` counted as drivable.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drivable_layers: Option<DrivableLayers>,
}

impl From<&SimulationRow> for ScenarioSummary {
    fn from(row: &SimulationRow) -> Self {
        let scored = row.score.into_iter().flat_map(|_| row.scored());
        Self {
            id: row.scenario.clone(),
            scenario_type: row.scenario_type.clone(),
            log_name: row.log_name.clone(),
            planner: row.planner.clone(),
            challenge: row.challenge,
            succeeded: row.error.is_none(),
            error: row.error.clone(),
            score: row.score,
            metrics: scored
                .filter_map(|name| Some((name.to_owned(), json!(row.metric(name)?))))
                .collect(),
            zeroed_by: row.score.map(|_| row.zeroed_by.clone()),
            planning_calls: row.planning_calls,
            gated_calls: row.gated_calls,
            refused_calls: row.refused_calls,
            rethinks: row.rethinks,
            parse_errors: row.parse_errors,
            deadlines: row.deadlines,
            failed_calls: row.failed_calls,
            unreadable_calls: row.unreadable_calls.clone(),
            without_plan: row.is_without_plan(),
            drivable_layers: row.drivable_layers,
        }
    }
}

/// Lets serde omit what is true of few simulations.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_false(flag: &bool) -> bool {
    !*flag
}

/// Mean score of one planner in one challenge over the completed simulations (nuPlan's rule).
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Aggregate {
    /// Name of the planner.
    pub planner: String,
    /// nuPlan's challenge.
    pub challenge: Challenge,
    /// nuPlan's scenario type; none for all scenarios.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenario_type: Option<String>,
    /// Simulations that completed and count.
    pub scenarios: usize,
    /// Simulations that failed and do not count.
    pub failed: usize,
    /// Simulations that count although no planning call gave a plan.
    #[serde(skip_serializing_if = "is_zero")]
    pub without_plan: usize,
    /// Mean score in [0, 1]; none if no simulation counts.
    pub score: Option<f64>,
}

/// The scores of a run.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Summary {
    /// Version of the program.
    pub planagent: String,
    /// Seed of the run.
    pub seed: u64,
    /// The model; none if no planner needs one.
    #[schemars(with = "Option<Map<String, Value>>")]
    pub model: Option<ModelDescription>,
    /// Scenarios that a split names but no log holds; the means do not include them.
    pub missing: Vec<MissingTokens>,
    /// The simulations in the order of the run.
    pub scenarios: Vec<ScenarioSummary>,
    /// Means by planner and challenge.
    pub aggregates: Vec<Aggregate>,
    /// Means by scenario type, planner and challenge.
    pub scenario_types: Vec<Aggregate>,
}

impl Summary {
    /// The summary of the simulations of a run; `missing` scenarios have none.
    pub fn new(
        seed: u64,
        model: Option<ModelDescription>,
        missing: &[MissingTokens],
        rows: &[SimulationRow],
    ) -> Self {
        let mut aggregates = Vec::new();
        let mut scenario_types = Vec::new();
        for planner in distinct(rows.iter().map(|row| &row.planner)) {
            for challenge in distinct(rows.iter().map(|row| &row.challenge)) {
                let own: Vec<&SimulationRow> = rows
                    .iter()
                    .filter(|row| row.planner == *planner && row.challenge == *challenge)
                    .collect();
                // A planner need not be in each challenge.
                if own.is_empty() {
                    continue;
                }
                let table = aggregated(*challenge, own.iter().copied());
                aggregates.push(mean(&table, &own, planner, *challenge, None));
                for scenario_type in distinct(own.iter().map(|row| &row.scenario_type)) {
                    scenario_types.push(mean(
                        &table,
                        &own,
                        planner,
                        *challenge,
                        Some(scenario_type),
                    ));
                }
            }
        }
        Self {
            planagent: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            model,
            missing: missing.to_vec(),
            scenarios: rows.iter().map(ScenarioSummary::from).collect(),
            aggregates,
            scenario_types,
        }
    }
}

/// nuPlan's aggregation of the simulations of one challenge.
pub(super) fn aggregated<'a>(
    challenge: Challenge,
    rows: impl Iterator<Item = &'a SimulationRow>,
) -> Vec<AggregateRow> {
    let scored: Vec<_> = rows.filter_map(SimulationRow::scenario_row).collect();
    aggregate(&scored, &Weighting::for_list(challenge.metric_list()))
}

fn mean(
    table: &[AggregateRow],
    own: &[&SimulationRow],
    planner: &str,
    challenge: Challenge,
    scenario_type: Option<&String>,
) -> Aggregate {
    let wanted = scenario_type.map_or(FINAL_SCORE, String::as_str);
    let row = table
        .iter()
        .find(|row| row.scenarios.is_some() && row.scenario_type == wanted);
    let counted = own
        .iter()
        .filter(|row| scenario_type.is_none_or(|wanted| row.scenario_type == *wanted));
    let failed = counted.clone().filter(|row| row.score.is_none()).count();
    let without_plan = counted.clone().filter(|row| row.is_without_plan());
    let without_plan = without_plan.count();
    Aggregate {
        planner: planner.to_owned(),
        challenge,
        scenario_type: scenario_type.cloned(),
        scenarios: counted.count() - failed,
        failed,
        without_plan,
        score: row.map(|row| row.score),
    }
}
