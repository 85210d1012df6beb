//! Aggregation of the scores of many scenarios by scenario type and by planner (devkit
//! `weighted_average_metric_aggregator.py`).

use super::METRICS;
use super::score::{Weighting, combine};
use planagent_world::InteractionKind;
use std::borrow::Cow;

/// The metric scores of one simulated scenario. A scenario whose simulation failed has no row at
/// all.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioRow {
    /// Name of the scenario.
    pub scenario: String,
    /// Its log.
    pub log_name: String,
    /// nuPlan's scenario type.
    pub scenario_type: String,
    /// The planner.
    pub planner: String,
    /// Metric scores by name; `None` where a metric gives none.
    pub metrics: Vec<(String, Option<f64>)>,
}

/// nuPlan's name of the last row of a planner.
pub const FINAL_SCORE: &str = "final_score";

/// One row of the aggregate: a scenario, the scenarios of a type, or all of a planner. The metric
/// columns of a type are sums, its score is a mean: nuPlan's behavior.
#[derive(Debug, Clone, PartialEq)]
pub struct AggregateRow {
    /// Name of a single scenario, else the type or [`FINAL_SCORE`].
    pub scenario: String,
    /// Log of a single scenario.
    pub log_name: Option<String>,
    /// nuPlan's scenario type, or [`FINAL_SCORE`].
    pub scenario_type: String,
    /// Number of scenarios; `None` for a single one.
    pub scenarios: Option<usize>,
    /// The planner.
    pub planner: String,
    /// Metric values, sorted by name; `None` where no scenario has one.
    pub metrics: Vec<(String, Option<f64>)>,
    /// The weighted score, in [0, 1].
    pub score: f64,
}

/// Rows of every planner by name: its scenarios, then its scenario types, both in order of first
/// appearance, then its final score. Metric columns go by name, as nuPlan's do.
pub fn aggregate(rows: &[ScenarioRow], weighting: &Weighting) -> Vec<AggregateRow> {
    let mut columns = distinct(
        rows.iter()
            .flat_map(|r| r.metrics.iter().map(|(name, _)| name)),
    );
    columns.sort();
    let mut planners = distinct(rows.iter().map(|r| &r.planner));
    planners.sort();
    let mut table = Vec::new();
    for planner in planners {
        let own: Vec<&ScenarioRow> = rows.iter().filter(|r| r.planner == *planner).collect();
        let scenarios: Vec<AggregateRow> = own
            .iter()
            .map(|row| scenario_row(row, &columns, weighting))
            .collect();
        let mut types = Vec::new();
        for scenario_type in distinct(own.iter().map(|r| &r.scenario_type)) {
            let of_type: Vec<&AggregateRow> = scenarios
                .iter()
                .zip(&own)
                .filter(|(_, r)| r.scenario_type == *scenario_type)
                .map(|(s, _)| s)
                .collect();
            types.push(type_row(scenario_type, &of_type, &columns));
        }
        // The final score is the mean over types, weighted by their scenarios, as nuPlan computes
        // it.
        let last = final_row(planner, scenarios.len(), &types, &columns);
        table.extend(scenarios);
        table.extend(types);
        table.push(last);
    }
    table
}

/// The values in the order of their first occurrence.
pub fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut seen: Vec<T> = Vec::new();
    for value in values {
        if !seen.contains(&value) {
            seen.push(value);
        }
    }
    seen
}

/// The weighting of a row. Modified scenarios of interPlan's kinds have interPlan's; they alone
/// have that metric.
fn weighting_of<'a>(row: &ScenarioRow, weighting: &'a Weighting) -> Cow<'a, Weighting> {
    let is_scored = row
        .metrics
        .iter()
        .any(|(name, score)| name == "lane_changes_to_goal" && score.is_some());
    match InteractionKind::named(&row.scenario_type).filter(|_| is_scored) {
        Some(kind) => Cow::Owned(Weighting::of_kind(kind, &METRICS)),
        None => Cow::Borrowed(weighting),
    }
}

fn scenario_row(row: &ScenarioRow, columns: &[&String], weighting: &Weighting) -> AggregateRow {
    let weighting = &weighting_of(row, weighting);
    let value = |column: &str| {
        row.metrics
            .iter()
            .find(|(name, _)| name == column)
            .and_then(|&(_, score)| score)
    };
    AggregateRow {
        scenario: row.scenario.clone(),
        log_name: Some(row.log_name.clone()),
        scenario_type: row.scenario_type.clone(),
        scenarios: None,
        planner: row.planner.clone(),
        metrics: columns.iter().map(|&c| (c.clone(), value(c))).collect(),
        score: combine(
            row.metrics
                .iter()
                .map(|(name, score)| (name.as_str(), *score)),
            weighting,
        ),
    }
}

/// The sum of a column over rows that have a value; `None` when none has.
fn column_sum<'a>(rows: impl Iterator<Item = &'a AggregateRow>, column: usize) -> Option<f64> {
    rows.filter_map(|row| row.metrics.get(column).and_then(|&(_, value)| value))
        .fold(None, |sum, value| Some(sum.unwrap_or(0.0) + value))
}

fn type_row(scenario_type: &str, rows: &[&AggregateRow], columns: &[&String]) -> AggregateRow {
    let metrics = columns.iter().enumerate();
    AggregateRow {
        scenario: scenario_type.to_owned(),
        log_name: None,
        scenario_type: scenario_type.to_owned(),
        scenarios: Some(rows.len()),
        planner: rows
            .first()
            .map(|row| row.planner.clone())
            .expect("a type is that of a row"),
        metrics: metrics
            .map(|(i, &c)| (c.clone(), column_sum(rows.iter().copied(), i)))
            .collect(),
        score: rows.iter().map(|row| row.score).sum::<f64>() / rows.len() as f64,
    }
}

fn final_row(
    planner: &str,
    scenarios: usize,
    types: &[AggregateRow],
    columns: &[&String],
) -> AggregateRow {
    let total = scenarios as f64;
    let mean = |i| column_sum(types.iter(), i).map(|sum| sum / total);
    AggregateRow {
        scenario: FINAL_SCORE.to_owned(),
        log_name: None,
        scenario_type: FINAL_SCORE.to_owned(),
        scenarios: Some(scenarios),
        planner: planner.to_owned(),
        metrics: columns
            .iter()
            .enumerate()
            .map(|(i, &c)| (c.clone(), mean(i)))
            .collect(),
        score: types
            .iter()
            .map(|row| row.score * row.scenarios.unwrap_or(1) as f64)
            .sum::<f64>()
            / total,
    }
}
