//! The files of a complete run. They are made from the simulation folders, so the number of
//! sessions does not matter.

use super::atomic;
use super::error::ReportError;
use super::layout::{NUPLAN_AGGREGATOR, NUPLAN_METRICS, SUMMARY, TIMING};
use super::manifest::Manifest;
use super::nuboard::write_nuboard;
use super::number::json_value;
use super::parquet::{write_aggregator, write_metric_files, write_runner_report};
use super::run_folder::RunFolder;
use super::simulation_row::SimulationRow;
use super::summary::{Summary, aggregated};
use super::timing::Timing;
use planagent_score::metrics::distinct;
use serde::Serialize;

impl RunFolder {
    /// Writes `timing.json`, `calls.jsonl`, `config.toml`, nuPlan's result tree of each challenge,
    /// and last `summary.json`.
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
            let metrics = folder.join(NUPLAN_METRICS);
            let aggregator = folder.join(NUPLAN_AGGREGATOR);
            for folder in [&metrics, &aggregator] {
                atomic::folder(folder)?;
                atomic::sweep(folder)?;
            }
            write_metric_files(
                &metrics,
                self.metrics(own().filter(|row| row.score.is_some()))?,
            )?;
            let name = format!(
                "{challenge}_weighted_average_metrics_{}.parquet",
                manifest.started
            );
            write_aggregator(
                &aggregator.join(name),
                &aggregated(challenge, own()),
                challenge.metric_list(),
            )?;
            write_runner_report(
                &folder.join("runner_report.parquet"),
                &own().collect::<Vec<_>>(),
            )?;
            write_nuboard(&folder, challenge)?;
        }
        self.write_json(TIMING, timing)?;
        self.write_json(SUMMARY, summary)
    }

    fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), ReportError> {
        let text = json_value(value).and_then(|value| serde_json::to_string_pretty(&value));
        self.write(
            name,
            (text.map_err(ReportError::at(self.path()))? + "\n").as_bytes(),
        )
    }
}
