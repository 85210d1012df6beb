//! The files of a complete run. They are made from the simulation folders, so the number of
//! sessions does not matter.

use super::error::ReportError;
use super::layout::{NUPLAN_AGGREGATOR, NUPLAN_METRICS, SUMMARY, TIMING};
use super::manifest::Manifest;
use super::nuboard::write_nuboard;
use super::number::json_value;
use super::parquet::{write_aggregator, write_metric_files, write_runner_report};
use super::run_folder::{RunFolder, sweep};
use super::simulation_row::SimulationRow;
use super::summary::{Summary, aggregated};
use super::timing::Timing;
use planagent_files::OpenFolder;
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
            let make = |above: &OpenFolder, name: &str| {
                above
                    .make_subfolder(name)
                    .map_err(ReportError::write(&above.path_of(name)))
            };
            let folder = make(self.root(), challenge.name())?;
            let metrics = make(&folder, NUPLAN_METRICS)?;
            let aggregator = make(&folder, NUPLAN_AGGREGATOR)?;
            for folder in [&folder, &metrics, &aggregator] {
                sweep(folder)?;
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
                &aggregator,
                &name,
                &aggregated(challenge, own()),
                challenge.metric_list(),
            )?;
            write_runner_report(&folder, &own().collect::<Vec<_>>())?;
            write_nuboard(&folder, challenge)?;
        }
        self.write_json(TIMING, timing)?;
        // Last: a folder with a summary counts as a complete run.
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
