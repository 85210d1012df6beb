//! Argoverse 2 logs as published: a folder of the sensor dataset (boxes at 10 Hz, ego poses, vector
//! map), or of the motion-forecasting dataset (tracks over 11 s, vector map).
//!
//! [`open`] opens a log folder, [`contents`] counts what it holds, [`logs_in`] lists the logs of a
//! folder.
//!
//! * `files`, `table` (with `ipc_bounds`), `map_file`: the files of a log, and checked cells and
//!   fields;
//! * `poses`, `annotations`, `category`: ego and objects of a sensor log; `forecasting`: those of a
//!   motion-forecasting scenario;
//! * `map`: lanes, areas and crosswalks.
//!
//! `scenario::recording` derives nuPlan's other layers and the route as for every recording. Errors
//! name file, column and row, or the feature of the map.

mod annotations;
mod category;
mod cells;
mod error;
mod files;
mod forecasting;
mod ipc_bounds;
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
pub(crate) use files::is_log;
pub use files::logs_in;
pub(crate) use reader::Argoverse2Reader;

use super::{Contents, Scenario};
use files::LogFiles;
use std::path::Path;

pub fn open(folder: &Path) -> Result<Scenario, Argoverse2Error> {
    let id = name(folder);
    match LogFiles::in_folder(folder)? {
        LogFiles::Sensor(files) => sensor::scenario(&files, id),
        LogFiles::Forecasting { tracks, map } => forecasting::scenario(&tracks, &map, id),
    }
}

pub fn contents(folder: &Path) -> Result<Contents, Argoverse2Error> {
    match LogFiles::in_folder(folder)? {
        LogFiles::Sensor(files) => sensor::contents(&files),
        LogFiles::Forecasting { tracks, map } => forecasting::contents(&tracks, &map),
    }
}

/// Name of the log in a folder: that of the folder.
pub fn name(folder: &Path) -> String {
    // `.` and `..` have no name.
    let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    folder
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}
