//! Finds a simulation of a run by the words of the command line.

use super::error::RenderError;
use crate::report::run_folder::{RunFolder, folders};
use crate::report::simulation_row::SimulationRow;
use crate::simulation::Challenge;
use std::path::{Path, PathBuf};

/// Maximum number of simulations in an error.
const MAX_LISTED: usize = 10;

/// A simulation, by the words of the command line.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SimulationChoice {
    /// Its number in the run, or the name of its scenario.
    pub simulation: String,
    /// Its planner, if the name is not enough.
    pub planner: Option<String>,
    /// Its challenge, if the name is not enough.
    pub challenge: Option<Challenge>,
}

impl SimulationChoice {
    /// The row and the folder of the simulation.
    pub(super) fn find(&self, run: &Path) -> Result<(SimulationRow, PathBuf), RenderError> {
        // The error for a folder without a run is clearer than that for a missing simulation.
        RunFolder::manifest(run)?;
        let mut rows = RunFolder::read_completed(run)?.rows;
        rows.retain(|row| self.matches(row));
        let folder = |row: &SimulationRow| Ok::<_, RenderError>(folders(run)?.remove(&row.number));
        match rows.as_slice() {
            [row] => match folder(row)? {
                Some(folder) => Ok((row.clone(), folder)),
                None => Err(RenderError::NoSimulation(self.simulation.clone())),
            },
            [] => Err(RenderError::NoSimulation(self.simulation.clone())),
            several => Err(RenderError::SeveralSimulations {
                wanted: self.simulation.clone(),
                simulations: several.iter().take(MAX_LISTED).map(|r| format!("{}  {}", r.number, words(r))).collect(),
            }),
        }
    }

    fn matches(&self, row: &SimulationRow) -> bool {
        let named = match self.simulation.parse::<usize>() {
            Ok(number) => row.number == number,
            Err(_) => row.scenario == self.simulation || row.scenario.ends_with(&format!("/{}", self.simulation)),
        };
        named
            && self.planner.as_ref().is_none_or(|planner| row.planner == *planner)
            && self.challenge.is_none_or(|challenge| row.challenge == challenge)
    }
}

/// Scenario, planner and challenge of a simulation.
pub(super) fn words(row: &SimulationRow) -> String {
    format!("{} by {}, {}", row.scenario, row.planner, row.challenge.short_name())
}
