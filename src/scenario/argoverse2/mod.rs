//! Argoverse 2 logs as published: a folder of the sensor dataset (boxes at 10 Hz, ego poses, vector map), or one of the
//! motion-forecasting dataset (tracks over 11 s, vector map).
//!
//! [`open`] makes a drive of a log folder, [`summary`] only counts what is there, [`logs_in`] lists the logs of a folder.
//! Everything that is derived is derived by a documented rule:
//!
//! * `files`, `table` (with `ipc_bounds`), `map_file`: where a log has what, and its cells and fields as they are;
//! * `poses`, `annotations`, `category`: ego and objects of a sensor log; `forecasting`: those of a motion-forecasting scenario;
//! * `map`: lanes, areas and crosswalks; `drive`: the part that is driven.
//!
//! nuPlan's other layers and the route come from the rules for every recording, in `scenario::recording`. What a file holds
//! that cannot be trusted is an error that names file, column and row, or place in the map.

mod annotations;
mod category;
mod error;
mod files;
mod forecasting;
mod ipc_bounds;
mod log;
mod map;
mod map_file;
mod poses;
mod reader;
mod sensor;
mod table;

#[cfg(test)]
mod broken_tests;
#[cfg(test)]
mod forecasting_tests;
#[cfg(test)]
mod test_log;
#[cfg(test)]
mod tests;

pub use error::{Argoverse2Error, LogFault};
pub use files::{is_log, logs_in};
pub use reader::Argoverse2Reader;

use super::Scenario;
use super::recording::window::window;
use crate::world::MICROS_PER_SECOND;
use files::LogFiles;
use sensor::SensorFiles;
use std::path::Path;

/// What a log holds, without deriving anything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Name of the log: its folder's.
    pub id: String,
    /// Recorded steps at 10 Hz.
    pub steps: usize,
    /// Iterations that a simulation drives.
    pub iterations: usize,
    /// Recorded objects; the recording car is one where the file lists it.
    pub tracks: usize,
    /// Lanes for motor vehicles, lane connectors included: as many as the map of the opened scenario has.
    pub lanes: usize,
}

/// Opens the log in a folder.
///
/// # Errors
/// When the folder is no log, a file of it is missing or unsound, or it is too short to be driven.
pub fn open(folder: &Path) -> Result<Scenario, Argoverse2Error> {
    let id = name(folder);
    match LogFiles::of(folder)? {
        LogFiles::Sensor { poses, annotations, map } => {
            let log = sensor::log(SensorFiles { poses: &poses, annotations: &annotations, map: &map }, id)?;
            within(&annotations, log.scenario())
        }
        LogFiles::Forecasting { tracks, map } => within(&tracks, forecasting::log(&tracks, &map, id)?.scenario()),
    }
}

/// What the log in a folder holds.
///
/// # Errors
/// When the folder is no log, or a file of it is missing or unreadable.
pub fn summary(folder: &Path) -> Result<Summary, Argoverse2Error> {
    let contents = match LogFiles::of(folder)? {
        LogFiles::Sensor { poses, annotations, map } => {
            sensor::contents(SensorFiles { poses: &poses, annotations: &annotations, map: &map })?
        }
        LogFiles::Forecasting { tracks, map } => forecasting::contents(&tracks, &map)?,
    };
    let times_us: Vec<i64> = contents.seconds.iter().map(|t| (t * MICROS_PER_SECOND) as i64).collect();
    Ok(Summary {
        id: name(folder),
        steps: times_us.len(),
        iterations: window(&times_us).len(),
        tracks: contents.tracks,
        lanes: contents.lanes,
    })
}

/// What is counted of a log.
#[derive(Debug)]
struct Contents {
    /// Seconds of each step from the first.
    seconds: Vec<f64>,
    tracks: usize,
    lanes: usize,
}

/// Name of the log in a folder: the folder's.
pub fn name(folder: &Path) -> String {
    // `.` and `..` have no name of their own.
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Says in which file a fault was found.
fn within<T>(path: &Path, found: Result<T, LogFault>) -> Result<T, Argoverse2Error> {
    found.map_err(|fault| Argoverse2Error::Content { path: path.to_owned(), fault })
}
