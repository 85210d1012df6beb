//! nuPlan's result tables as Parquet, with the columns that the devkit writes (`MetricsEngine`,
//! `WeightedAverageMetricAggregator`, `save_runner_reports`), so that its readers work on them.

mod aggregator;
mod metric_files;
mod runner_report;
mod table;

pub(super) use aggregator::write_aggregator;
pub(super) use metric_files::write_metric_files;
pub(super) use runner_report::write_runner_report;
