//! Names of the files and folders of a run.

/// Parent of the run folders that get a number instead of a name.
pub(super) const RUNS: &str = "runs";
/// What the run consists of; written first.
pub(super) const MANIFEST: &str = "manifest.toml";
/// The configuration in the form that `--config` takes.
pub(super) const CONFIG: &str = "config.toml";
/// The scores; written last, so the run is complete if the file exists.
pub(super) const SUMMARY: &str = "summary.json";
/// Wall times and the machine.
pub(super) const TIMING: &str = "timing.json";
/// The planning calls: of one simulation in its folder, of all in the folder of the run.
pub(super) const CALLS: &str = "calls.jsonl";
/// The page of the run.
pub(crate) const PAGE: &str = "report.html";
/// File that a running process holds locked.
pub(super) const LOCK: &str = ".lock";

/// nuPlan's metric files, in the folder of a challenge.
pub(super) const NUPLAN_METRICS: &str = "metrics";
/// nuPlan's aggregated scores, in the folder of a challenge.
pub(super) const NUPLAN_AGGREGATOR: &str = "aggregator_metric";
/// nuPlan's simulation logs, in the folder of a challenge. Only the devkit can write them.
pub(super) const NUPLAN_SIMULATION_LOGS: &str = "simulation_log";
/// What nuBoard opens, in the folder of a challenge. It finds the file by its extension.
pub(super) const NUBOARD: &str = "run.nuboard";

/// Parent of the simulation folders.
pub(super) const SIMULATIONS: &str = "simulations";
/// The row of the simulation.
pub(super) const RECORD: &str = "record.toml";
/// Its metrics with statistics and time series.
pub(super) const METRICS: &str = "metrics.toml";
/// Tracks, map and plans.
pub(super) const REPLAY: &str = "replay.json.gz";
/// The planning calls as Markdown.
pub const TRANSCRIPT: &str = "transcript.md";
/// Parent of the BEV maps.
pub(super) const BEV: &str = "bev";

/// The name of the BEV map of a planning call in its folder.
pub(super) fn bev_name(iteration: usize) -> String {
    format!("{iteration:03}{BEV_ENDING}")
}

/// Whether a file is the BEV map of a planning call.
pub(super) fn is_bev_name(name: &str) -> bool {
    name.strip_suffix(BEV_ENDING)
        .and_then(|digits| digits.parse().ok())
        .is_some_and(|iteration| bev_name(iteration) == name)
}

const BEV_ENDING: &str = ".png";
