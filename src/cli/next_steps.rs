//! What a person may do after a run: lines for stderr, each with a command or a file to open.

use planagent_files::{quoted, word_of};
use planagent_runs::report::table::terminal::LineWidth;
use planagent_runs::report::{SimulationRow, TRANSCRIPT, simulation_folders};
use std::path::{Path, PathBuf};

/// Columns before a command or a file.
const INDENT: &str = "  ";

/// The folders that a path may be relative to.
#[derive(Debug, Clone, Default)]
pub(super) struct Here {
    /// The working directory.
    pub(super) work: Option<PathBuf>,
    /// The home folder, which a shell calls `~`.
    pub(super) home: Option<PathBuf>,
}

impl Here {
    /// Those of this process.
    pub(super) fn of_process() -> Self {
        Self {
            work: std::env::current_dir().ok(),
            home: std::env::var_os("HOME").map(PathBuf::from),
        }
    }

    /// A path as a word for a shell: from the working directory, else from the home folder.
    fn word(&self, path: &Path) -> String {
        let relative = |folder: &Option<PathBuf>| {
            let rest = path.strip_prefix(folder.as_ref()?).ok()?;
            (!rest.as_os_str().is_empty()).then(|| quoted(&word_of(rest.as_os_str())))
        };
        relative(&self.work)
            .or_else(|| relative(&self.home).map(|rest| format!("~/{rest}")))
            .unwrap_or_else(|| quoted(&word_of(path.as_os_str())))
    }
}

/// The lines after a run with these simulations, at most `columns` wide as far as the name of the
/// folder allows. A run without a completed simulation has none.
pub(super) fn next_steps(
    run: &Path,
    rows: &[SimulationRow],
    here: &Here,
    columns: u16,
) -> Vec<String> {
    let completed = || rows.iter().filter(|row| row.error.is_none());
    if completed().next().is_none() {
        return Vec::new();
    }
    let step = |command: String, purpose: &str| {
        let indent = INDENT.repeat(2);
        let width = LineWidth::terminal(columns.saturating_sub(indent.len() as u16));
        let purpose = width.wrapped(purpose);
        let purpose = purpose.iter().map(|line| format!("\n{indent}{line}"));
        format!("{INDENT}{command}{}", purpose.collect::<String>())
    };
    let mut lines = vec!["next:".to_owned()];
    lines.push(step(
        format!("planagent report {} --open", here.word(run)),
        "the page: replays, metrics and transcripts",
    ));
    // Only a simulation with planning calls has a transcript.
    let asked = completed().find(|row| row.planning_calls > 0);
    let width = usize::from(columns).saturating_sub(INDENT.len());
    if let Some(transcript) = asked.and_then(|row| transcript(run, row.number, here, width)) {
        lines.push(step(
            transcript,
            "the transcript: what the model read and answered",
        ));
        lines.push(step(
            "planagent models list".to_owned(),
            "models to compare: simulate --model NAME, then compare both runs",
        ));
    }
    lines
}

/// The transcript of a simulation, as a word for a shell. Where the word is wider, the name of the
/// simulation's folder is a pattern: its number is enough.
fn transcript(run: &Path, number: usize, here: &Here, width: usize) -> Option<String> {
    let folder = simulation_folders(run).ok()?.remove(&number)?;
    let file = folder.path().join(TRANSCRIPT);
    if !file.is_file() {
        return None;
    }
    let word = here.word(&file);
    // Other shells do not fill in patterns.
    if word.chars().count() <= width || !cfg!(unix) {
        return Some(word);
    }
    let folder = folder.path();
    let name = folder.file_name()?.to_str()?;
    let digits = name.split('-').next()?;
    let parent = here.word(folder.parent()?);
    Some(format!("{parent}/{digits}-*/{TRANSCRIPT}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::simulation::Challenge;

    const SIMULATION: &str = "000000-generated_near_multiple_vehicles_2_approaching_construction_zone-plan-agent-nonreactive";

    fn row() -> SimulationRow {
        SimulationRow {
            planning_calls: 3,
            error: None,
            ..SimulationRow::example("t", 0, "plan-agent", Challenge::NonReactive, None)
        }
    }

    /// A run with a transcript in a folder of a working directory.
    fn run_in(work: &Path, run: &str) -> PathBuf {
        let run = work.join(run);
        let simulation = run.join("simulations").join(SIMULATION);
        std::fs::create_dir_all(&simulation).unwrap();
        std::fs::write(simulation.join(TRANSCRIPT), "# Transcript").unwrap();
        run
    }

    #[test]
    fn the_lines_fit_every_terminal() {
        let work = tempfile::tempdir().unwrap();
        let folder = run_in(work.path(), "runs/0001");
        let here = Here {
            work: Some(work.path().to_owned()),
            home: None,
        };
        for columns in [60, 80, 160] {
            let text = next_steps(&folder, &[row()], &here, columns).join("\n");
            let widest = text.lines().map(str::len).max().unwrap();
            assert!(widest <= usize::from(columns), "{columns}: {text}");
            let whole = format!("  runs/0001/simulations/{SIMULATION}/{TRANSCRIPT}\n");
            let pattern = format!("  runs/0001/simulations/000000-*/{TRANSCRIPT}\n");
            assert_eq!(text.contains(&whole), columns == 160, "{text}");
            assert_eq!(text.contains(&pattern), columns < 160, "{text}");
            assert!(text.contains("  planagent report runs/0001 --open\n"));
        }
    }

    #[test]
    fn a_path_is_as_short_as_a_shell_takes_it() {
        let here = Here {
            work: Some(PathBuf::from("/home/u/work")),
            home: Some(PathBuf::from("/home/u")),
        };
        let word = |path: &str| here.word(Path::new(path));
        assert_eq!(word("/home/u/work/runs/1"), "runs/1");
        assert_eq!(word("/home/u/a b/1"), "~/'a b/1'");
        assert_eq!(word("/home/u"), "/home/u");
        assert_eq!(word("/data/1"), "/data/1");
        assert_eq!(word("runs/1"), "runs/1");
        assert_eq!(Here::default().word(Path::new("/data/1")), "/data/1");
    }
}
