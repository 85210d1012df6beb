//! What a person may do after a run: lines for stderr, each with a command or a file to open.

use planagent_files::{quoted, word_of};
use planagent_runs::report::{SimulationRow, TRANSCRIPT, simulation_folders};
use std::path::Path;

/// The lines after a run with these simulations. A run without a completed one has none.
pub(super) fn next_steps(run: &Path, rows: &[SimulationRow]) -> Vec<String> {
    let completed = || rows.iter().filter(|row| row.error.is_none());
    if completed().next().is_none() {
        return Vec::new();
    }
    let word = quoted(&word_of(run.as_os_str()));
    let mut lines = vec!["next:".to_owned()];
    lines.push(format!(
        "  planagent report {word} --open\n    the page: replays, metrics and transcripts"
    ));
    let asked = completed().find(|row| row.planning_calls > 0);
    if let Some(transcript) = asked.and_then(|row| transcript(run, row.number)) {
        lines.push(format!(
            "  {transcript}\n    the transcript: what the model read and answered"
        ));
        lines.push(
            "  planagent models list\n    \
             models to compare: simulate --model NAME, then compare both runs"
                .to_owned(),
        );
    }
    lines
}

/// The transcript of a simulation, as a word for a shell.
fn transcript(run: &Path, number: usize) -> Option<String> {
    let folder = simulation_folders(run).ok()?.remove(&number)?;
    let file = folder.path().join(TRANSCRIPT);
    file.is_file().then(|| quoted(&word_of(file.as_os_str())))
}
