//! Finds simulations of a run by the words of the command line.

use super::error::RenderError;
use crate::report::run_files::{RunFiles, SimulationFolder};
use crate::report::run_folder::RunFolder;
use crate::report::simulation_row::SimulationRow;
use planagent_agent::simulation::Challenge;
use std::collections::BTreeSet;
use std::path::Path;

/// Maximum number of simulations in an error.
const MAX_LISTED: usize = 10;

/// A simulation, by the words of the command line.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SimulationChoice {
    /// Its number in the run, the name of its scenario, or a part of the name.
    pub simulation: String,
    /// Its planner, if the name is not enough.
    pub planner: Option<String>,
    /// Its challenge, if the name is not enough.
    pub challenge: Option<Challenge>,
}

impl SimulationChoice {
    /// The row and the folder of the simulation.
    pub(super) fn find(
        &self,
        run: &Path,
    ) -> Result<(SimulationRow, SimulationFolder), RenderError> {
        let files = RunFiles::open(run)?;
        // The error for a folder without a run is clearer than that for a missing simulation.
        RunFolder::manifest_in(&files)?;
        let completed = RunFolder::completed_in(&files)?;
        let mut rows = named(&completed.rows, &self.simulation, run)?;
        rows.retain(|row| {
            self.planner
                .as_ref()
                .is_none_or(|planner| row.planner == *planner)
        });
        rows.retain(|row| {
            self.challenge
                .is_none_or(|challenge| row.challenge == challenge)
        });
        let folder =
            |row: &SimulationRow| Ok::<_, RenderError>(files.folders()?.remove(&row.number));
        match rows.as_slice() {
            [row] => match folder(row)? {
                Some(folder) => Ok((row.clone(), folder)),
                None => Err(no_simulation(&self.simulation, run, &rows)),
            },
            [] => Err(no_simulation(&self.simulation, run, &rows)),
            several => Err(RenderError::SeveralSimulations {
                wanted: self.simulation.clone(),
                simulations: several
                    .iter()
                    .take(MAX_LISTED)
                    .map(|r| format!("{}  {}", r.number, words(r)))
                    .collect(),
            }),
        }
    }
}

/// The simulations that a word names, of those of the run in a folder: by number, by the name of
/// their scenario, or by a part of that name which no other scenario has.
///
/// # Errors
/// When no scenario has the word in its name, or several have.
pub fn named(
    rows: &[SimulationRow],
    word: &str,
    run: &Path,
) -> Result<Vec<SimulationRow>, RenderError> {
    let number = word.parse::<usize>().ok();
    let end = format!("/{word}");
    let by_number = |row: &SimulationRow| number == Some(row.number);
    let by_name = |row: &SimulationRow| row.scenario == word || row.scenario.ends_with(&end);
    let by_part = |row: &SimulationRow| !word.is_empty() && row.scenario.contains(word);
    let rules: [&dyn Fn(&SimulationRow) -> bool; 3] = [&by_number, &by_name, &by_part];
    let Some(is_meant) = rules.into_iter().find(|is_meant| rows.iter().any(is_meant)) else {
        return Err(no_simulation(word, run, rows));
    };
    let meant: Vec<SimulationRow> = rows.iter().filter(|row| is_meant(row)).cloned().collect();
    let scenarios: BTreeSet<&str> = meant.iter().map(|row| row.scenario.as_str()).collect();
    if scenarios.len() > 1 {
        let scenarios = scenarios.into_iter().map(str::to_owned).collect();
        return Err(RenderError::SeveralScenarios {
            wanted: word.to_owned(),
            scenarios,
        });
    }
    Ok(meant)
}

fn no_simulation(word: &str, run: &Path, rows: &[SimulationRow]) -> RenderError {
    let known: BTreeSet<&str> = rows.iter().map(|row| row.scenario.as_str()).collect();
    let known = known.into_iter().map(str::to_owned).collect();
    RenderError::NoSimulation {
        run: run.to_owned(),
        wanted: word.to_owned(),
        known,
    }
}

/// Scenario, planner and challenge of a simulation.
pub fn words(row: &SimulationRow) -> String {
    format!(
        "{} by {}, {}",
        row.scenario,
        row.planner,
        row.challenge.short_name()
    )
}
