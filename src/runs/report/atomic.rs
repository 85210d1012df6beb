//! Files outside of runs that are either complete or absent.

use super::error::ReportError;
use planagent_files::write_whole;
use std::fs;
use std::path::Path;

/// Writes a file that a user names: all of it, or nothing.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    write_whole(path, bytes).map_err(ReportError::write(path))
}

/// Writes a file of a folder of results, which may come from elsewhere: all of it, or nothing. A
/// link of its name is replaced.
pub fn write_within(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    planagent_files::write_within(path, bytes).map_err(ReportError::write(path))
}

/// Creates a folder and its parents.
pub fn folder(path: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(path).map_err(ReportError::write(path))
}
