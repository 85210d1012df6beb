//! `runner_report.parquet`: a row for each simulation, also for failed ones.

use super::table::{Column, Columns, TableWriter};
use crate::report::{ReportError, SimulationRow, Spread};
use planagent_files::OpenFolder;

/// Name of the table.
const RUNNER_REPORT: &str = "runner_report.parquet";

/// Writes the table with the columns of the devkit's `save_runner_reports`. Times are in seconds,
/// `start_time` and `end_time` since 1970.
pub(in crate::report) fn write_runner_report(
    folder: &OpenFolder,
    rows: &[&SimulationRow],
) -> Result<(), ReportError> {
    TableWriter::begin(folder, RUNNER_REPORT, columns(rows))?.finish()
}

fn columns(rows: &[&SimulationRow]) -> Columns {
    let text = |of: fn(&SimulationRow) -> &str| Column::text(rows.iter().map(|row| of(row)));
    let float = |of: fn(&SimulationRow) -> Option<f64>| {
        Column::Float(rows.iter().map(|row| of(row)).collect())
    };
    // Names and order are those of nuPlan's runner report, which nuBoard reads.
    let all = [
        (
            "succeeded",
            Column::Boolean(rows.iter().map(|row| Some(row.error.is_none())).collect()),
        ),
        (
            "error_message",
            Column::Text(rows.iter().map(|row| row.error.clone()).collect()),
        ),
        ("start_time", float(|row| Some(row.time.started_s))),
        ("end_time", float(|row| Some(row.time.ended_s))),
        ("scenario_name", text(|row| &row.scenario)),
        ("planner_name", text(|row| &row.planner)),
        ("log_name", text(|row| &row.log_name)),
        (
            "compute_trajectory_runtimes_mean",
            float(|row| mean(&row.time.planner_s)),
        ),
        (
            "compute_trajectory_runtimes_median",
            float(|row| {
                Spread::from_values(row.time.planner_s.clone()).map(|spread| spread.median)
            }),
        ),
        (
            "compute_trajectory_runtimes_std",
            float(|row| deviation(&row.time.planner_s)),
        ),
        (
            "duration",
            float(|row| Some(row.time.ended_s - row.time.started_s)),
        ),
    ];
    all.into_iter()
        .map(|(name, column)| (name.to_owned(), column))
        .collect()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The standard deviation of the population, as in numpy.
fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    Some(
        (values
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>()
            / values.len() as f64)
            .sqrt(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_numpys() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(mean(&values), Some(2.5));
        assert!((deviation(&values).unwrap() - 1.25f64.sqrt()).abs() < 1e-15);
        assert_eq!((mean(&[]), deviation(&[])), (None, None));
    }
}
