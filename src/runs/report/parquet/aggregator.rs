//! `aggregator_metric/CHALLENGE_weighted_average_metrics_STAMP.parquet`: scenarios, scenario types
//! and final score of each planner.

use super::table::{Column, Columns, TableWriter};
use crate::report::ReportError;
use planagent_files::OpenFolder;
use planagent_score::metrics::{AggregateRow, MetricList};
use std::collections::BTreeSet;

/// nuPlan's name of its only aggregation.
const AGGREGATOR_TYPE: &str = "weighted_average";

/// Writes the table with the columns of the devkit's `WeightedAverageMetricAggregator`: metrics by
/// name, the score last. A failed simulation has no row; if all failed, the table has its columns
/// and no row, so that readers still work.
pub(in crate::report) fn write_aggregator(
    folder: &OpenFolder,
    name: &str,
    rows: &[AggregateRow],
    list: MetricList,
) -> Result<(), ReportError> {
    TableWriter::begin(folder, name, columns(rows, list))?.finish()
}

fn columns(rows: &[AggregateRow], list: MetricList) -> Columns {
    let text = |of: fn(&AggregateRow) -> &str| Column::text(rows.iter().map(of));
    // A double, because pandas reads integers with gaps as doubles.
    let scenarios = rows
        .iter()
        .map(|row| row.scenarios.map(|count| count as f64));
    let mut all = vec![
        ("scenario".to_owned(), text(|row| &row.scenario)),
        (
            "log_name".to_owned(),
            Column::Text(rows.iter().map(|row| row.log_name.clone()).collect()),
        ),
        ("scenario_type".to_owned(), text(|row| &row.scenario_type)),
        (
            "num_scenarios".to_owned(),
            Column::Float(scenarios.collect()),
        ),
        ("planner_name".to_owned(), text(|row| &row.planner)),
        ("aggregator_type".to_owned(), text(|_| AGGREGATOR_TYPE)),
    ];
    let computed = rows
        .iter()
        .flat_map(|row| row.metrics.iter().map(|(name, _)| name.as_str()));
    let names: BTreeSet<&str> = computed
        .chain(list.scored().map(|metric| metric.name))
        .collect();
    for name in names {
        let value = |row: &AggregateRow| {
            row.metrics
                .iter()
                .find(|(n, _)| n == name)
                .and_then(|(_, value)| *value)
        };
        all.push((
            name.to_owned(),
            Column::numbers(rows.iter().map(value).collect()),
        ));
    }
    all.push((
        "score".to_owned(),
        Column::Float(rows.iter().map(|row| Some(row.score)).collect()),
    ));
    all
}
