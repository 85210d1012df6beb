//! `runs/`: the folders of runs that nobody named.

use super::error::{ReportError, ReportFault};
use super::layout::RUNS;
use planagent_files::OpenFolder;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// Creates the first `runs/NNNN` that does not exist. Of processes that start at one time, each
/// gets its own.
pub(super) fn next_free() -> Result<OpenFolder, ReportError> {
    let runs = Path::new(RUNS);
    for number in 1..u32::MAX {
        let path = runs.join(format!("{number:04}"));
        loop {
            fs::create_dir_all(runs).map_err(ReportError::write(runs))?;
            match fs::create_dir(&path) {
                Ok(()) => return OpenFolder::open(&path).map_err(ReportError::write(&path)),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => break,
                // Another process looked whether it can write there, and left nothing behind.
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(ReportError::write(&path)(error)),
            }
        }
    }
    Err(ReportError::at(runs)(ReportFault::TooMany {
        what: "runs",
        limit: u32::MAX as usize,
    }))
}
