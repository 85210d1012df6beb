//! The files of a run that has ended: made of the drives' folders, so that it does not matter in how many sessions the
//! drives were made.

use super::atomic;
use super::error::ReportError;
use super::manifest::Manifest;
use super::number::json_value;
use super::parquet::{write_aggregator, write_metric_files, write_runner_report};
use super::run_folder::RunFolder;
use super::simulation_row::SimulationRow;
use super::summary::{Summary, aggregated, distinct};
use super::timing::Timing;

/// The file that is written last: where it is, the run has ended.
pub const SUMMARY: &str = "summary.json";

impl RunFolder {
    /// Writes `summary.json`, `timing.json`, `calls.jsonl`, `config.toml`, and for each challenge nuPlan's result tree.
    ///
    /// # Errors
    /// When a file cannot be written, or a drive's metrics cannot be read.
    pub fn finish(
        &self,
        manifest: &Manifest,
        summary: &Summary,
        timing: &Timing,
        rows: &[SimulationRow],
    ) -> Result<(), ReportError> {
        self.write_config(manifest)?;
        self.join_calls()?;
        for challenge in distinct(rows.iter().map(|row| row.challenge)) {
            let own = || rows.iter().filter(|row| row.challenge == challenge);
            let folder = self.path().join(challenge.to_string());
            let metrics = folder.join("metrics");
            let aggregator = folder.join("aggregator_metric");
            for folder in [&metrics, &aggregator] {
                atomic::folder(folder)?;
                atomic::sweep(folder)?;
            }
            write_metric_files(&metrics, self.metrics(own().filter(|row| row.score.is_some()))?)?;
            let name = format!("{challenge}_weighted_average_metrics_{}.parquet", manifest.started);
            write_aggregator(&aggregator.join(name), &aggregated(challenge, own()), challenge.metric_list())?;
            write_runner_report(&folder.join("runner_report.parquet"), &own().collect::<Vec<_>>())?;
        }
        self.write("timing.json", pretty(timing)?.as_bytes())?;
        self.write(SUMMARY, pretty(summary)?.as_bytes())
    }
}

fn pretty(value: &impl serde::Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(&json_value(value)?).map(|text| text + "\n")
}
