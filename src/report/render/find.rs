//! Which drive of a run is meant.

use super::error::RenderError;
use crate::report::run_folder::{RunFolder, folders};
use crate::report::simulation_row::SimulationRow;
use crate::simulation::Challenge;
use std::path::{Path, PathBuf};

/// Most drives that an error lists.
const MOST_LISTED: usize = 10;

/// A drive, by the words of the command line.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SimulationChoice {
    /// Its number in the run, or the name of its scenario.
    pub simulation: String,
    /// By whom, if that is to be said.
    pub planner: Option<String>,
    /// Among which traffic, if that is to be said.
    pub challenge: Option<Challenge>,
}

impl SimulationChoice {
    /// The one drive that is meant, and its folder.
    ///
    /// # Errors
    /// When the run cannot be read, or none or several of its drives are meant.
    pub(super) fn find(&self, run: &Path) -> Result<(SimulationRow, PathBuf), RenderError> {
        // A folder without a run says so better than one without drives.
        RunFolder::manifest(run)?;
        let mut rows = RunFolder::ended(run)?.rows;
        rows.retain(|row| self.means(row));
        let folder = |row: &SimulationRow| Ok::<_, RenderError>(folders(run)?.remove(&row.number));
        match rows.as_slice() {
            [row] => match folder(row)? {
                Some(folder) => Ok((row.clone(), folder)),
                None => Err(RenderError::NoSimulation(self.simulation.clone())),
            },
            [] => Err(RenderError::NoSimulation(self.simulation.clone())),
            several => Err(RenderError::SeveralSimulations {
                wanted: self.simulation.clone(),
                simulations: several.iter().take(MOST_LISTED).map(|r| format!("{}  {}", r.number, words(r))).collect(),
            }),
        }
    }

    fn means(&self, row: &SimulationRow) -> bool {
        let named = match self.simulation.parse::<usize>() {
            Ok(number) => row.number == number,
            Err(_) => row.scenario == self.simulation || row.scenario.ends_with(&format!("/{}", self.simulation)),
        };
        named
            && self.planner.as_ref().is_none_or(|planner| row.planner == *planner)
            && self.challenge.is_none_or(|challenge| row.challenge == challenge)
    }
}

/// A drive in words.
pub(super) fn words(row: &SimulationRow) -> String {
    format!("{} by {}, {}", row.scenario, row.planner, row.challenge.short_name())
}
