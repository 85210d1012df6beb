//! The program `planagent` inside the package.

use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the program with arguments, the first of which is its name; `launcher` starts it again.
/// Gives the exit code. It writes to the file descriptors of the process.
#[pyfunction]
pub(crate) fn command(py: Python<'_>, arguments: Vec<OsString>, launcher: Vec<OsString>) -> u8 {
    let commit = option_env!("PLANAGENT_COMMIT");
    py.detach(|| planagent_cli::run_inside(arguments, launcher, commit))
}
