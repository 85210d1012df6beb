//! The completed simulations of a run that a command reads.

use super::Printer;
use planagent_files::{quoted, word_of};
use planagent_runs::report::{RunFolder, SimulationRow};
use std::path::{Path, PathBuf};

/// The completed simulations of a run. Says which are damaged, and so left out.
pub(super) fn completed(run: &Path, printer: Printer) -> anyhow::Result<Vec<SimulationRow>> {
    RunFolder::manifest(run)?;
    let completed = RunFolder::read_completed(run)?;
    note_damage(&completed.damaged, printer);
    Ok(completed.rows)
}

/// Names the folders of damaged simulations.
pub(super) fn note_damage(folders: &[PathBuf], printer: Printer) {
    for folder in folders {
        // The folder of a simulation is RUN/simulations/NAME.
        let run = folder.ancestors().nth(2).unwrap_or(folder.as_path());
        let run = quoted(&word_of(run.as_os_str()));
        let folder = folder.display();
        printer.failure(format!(
            "{folder} is damaged and left out; `planagent simulate --resume {run}` repeats it"
        ));
    }
}
