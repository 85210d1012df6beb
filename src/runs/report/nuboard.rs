//! `CHALLENGE/run.nuboard`: the file by which nuBoard, the devkit's viewer, opens the results of a
//! challenge.

use super::error::ReportError;
use super::layout::{NUBOARD, NUPLAN_AGGREGATOR, NUPLAN_METRICS, NUPLAN_SIMULATION_LOGS};
use super::run_folder::write_in;
use planagent_agent::simulation::Challenge;
use planagent_files::OpenFolder;
use serde::Serialize;
use serde_pickle::SerOptions;
use std::io;

/// The dictionary that the devkit's `NuBoardFile` pickles.
///
/// nuBoard looks for the three folders beside the file first. Absolute main paths would name this
/// machine, and would be wrong once the run is moved; relative ones are right wherever the run is.
#[derive(Serialize)]
struct NuBoardFile {
    /// Where nuBoard puts `video_screenshot`, relative to its working directory.
    simulation_main_path: String,
    /// nuBoard's name of the experiment is its last part. A file that is loaded in the browser has
    /// no place, so nuBoard takes this path, needs two parts of it, and finds it when started in a
    /// folder of the run.
    metric_main_path: String,
    metric_folder: &'static str,
    aggregator_metric_folder: &'static str,
    simulation_folder: &'static str,
}

impl NuBoardFile {
    fn for_challenge(challenge: Challenge) -> Self {
        Self {
            simulation_main_path: challenge.to_string(),
            metric_main_path: format!("../{challenge}"),
            metric_folder: NUPLAN_METRICS,
            aggregator_metric_folder: NUPLAN_AGGREGATOR,
            simulation_folder: NUPLAN_SIMULATION_LOGS,
        }
    }
}

/// Writes the file into the folder of a challenge. An experiment of nuBoard is one challenge, as it
/// is one `run_simulation` of the devkit.
pub(super) fn write_nuboard(folder: &OpenFolder, challenge: Challenge) -> Result<(), ReportError> {
    let bytes = serde_pickle::to_vec(&NuBoardFile::for_challenge(challenge), SerOptions::new());
    let bytes = bytes
        .map_err(io::Error::other)
        .map_err(ReportError::write(&folder.path_of(NUBOARD)))?;
    write_in(folder, NUBOARD, &bytes)
}
