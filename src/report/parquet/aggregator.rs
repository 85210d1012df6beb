//! `aggregator_metric/CHALLENGE_weighted_average_metrics_STAMP.parquet`: scenarios, scenario types and final score of each
//! planner.

use super::table::{Column, Columns, TableWriter};
use crate::metrics::{AggregateRow, MetricList, RowKind};
use crate::report::ReportError;
use std::collections::BTreeSet;
use std::path::Path;

/// nuPlan's name of its only aggregation.
const AGGREGATOR_TYPE: &str = "weighted_average";
/// nuPlan's name of the last row of a planner.
const FINAL_SCORE: &str = "final_score";

/// Writes the table with the columns of the devkit's `WeightedAverageMetricAggregator`: metrics by name, the score last. A failed
/// simulation has no row; if all failed, the table has its columns and no row, so that readers still work.
pub(in crate::report) fn write_aggregator(
    path: &Path,
    rows: &[AggregateRow],
    list: MetricList,
) -> Result<(), ReportError> {
    TableWriter::begin(path, columns(rows, list))?.finish()
}

fn columns(rows: &[AggregateRow], list: MetricList) -> Columns {
    let text = |of: fn(&AggregateRow) -> &str| Column::text(rows.iter().map(of));
    let mut all = vec![
        ("scenario".to_owned(), text(scenario)),
        ("log_name".to_owned(), Column::Text(rows.iter().map(log_name).collect())),
        ("scenario_type".to_owned(), text(scenario_type)),
        ("num_scenarios".to_owned(), Column::Float(rows.iter().map(num_scenarios).collect())),
        ("planner_name".to_owned(), text(|row| &row.planner)),
        ("aggregator_type".to_owned(), text(|_| AGGREGATOR_TYPE)),
    ];
    let computed = rows.iter().flat_map(|row| row.metrics.iter().map(|(name, _)| name.as_str()));
    let names: BTreeSet<&str> = computed.chain(list.scored().map(|metric| metric.name)).collect();
    for name in names {
        let value = |row: &AggregateRow| row.metrics.iter().find(|(n, _)| n == name).and_then(|(_, value)| *value);
        all.push((name.to_owned(), Column::Float(rows.iter().map(value).collect())));
    }
    all.push(("score".to_owned(), Column::Float(rows.iter().map(|row| Some(row.score)).collect())));
    all
}

fn scenario(row: &AggregateRow) -> &str {
    match &row.kind {
        RowKind::Scenario { scenario, .. } => scenario,
        RowKind::ScenarioType { scenario_type, .. } => scenario_type,
        RowKind::FinalScore { .. } => FINAL_SCORE,
    }
}

fn log_name(row: &AggregateRow) -> Option<String> {
    match &row.kind {
        RowKind::Scenario { log_name, .. } => Some(log_name.clone()),
        RowKind::ScenarioType { .. } | RowKind::FinalScore { .. } => None,
    }
}

fn scenario_type(row: &AggregateRow) -> &str {
    match &row.kind {
        RowKind::Scenario { scenario_type, .. } | RowKind::ScenarioType { scenario_type, .. } => scenario_type,
        RowKind::FinalScore { .. } => FINAL_SCORE,
    }
}

/// A double, because pandas reads integers with gaps as doubles.
fn num_scenarios(row: &AggregateRow) -> Option<f64> {
    match &row.kind {
        RowKind::Scenario { .. } => None,
        RowKind::ScenarioType { scenarios, .. } | RowKind::FinalScore { scenarios } => Some(*scenarios as f64),
    }
}
