//! The program `planagent` inside the package.

use planagent_mllm::Trust;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::sync::OnceLock;

/// What starts the program of the package: the interpreter and its first arguments.
static LAUNCHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Keeps the interpreter of this process, which tries the files of models in a process of its own.
pub(crate) fn remember_interpreter(py: Python<'_>) -> PyResult<()> {
    let interpreter: Option<OsString> = py.import("sys")?.getattr("executable")?.extract()?;
    // A program that embeds Python may have none.
    if let Some(interpreter) = interpreter.filter(|path| !path.is_empty()) {
        let first = ["-m", "planagent"].map(OsString::from);
        let launcher = [interpreter].into_iter().chain(first).collect();
        // Another import of the module came first.
        let _ = LAUNCHER.set(launcher);
    }
    Ok(())
}

/// Who vouches for the files of models: a trial in a process of the interpreter.
pub(crate) fn trial() -> Trust {
    planagent_cli::trial_by(LAUNCHER.get().map_or(&[][..], Vec::as_slice))
}

/// Runs the program with arguments, the first of which is its name; `launcher` starts it again.
/// Gives the exit code. It writes to the file descriptors of the process.
#[pyfunction]
pub(crate) fn command(py: Python<'_>, arguments: Vec<OsString>, launcher: Vec<OsString>) -> u8 {
    let commit = option_env!("PLANAGENT_COMMIT");
    py.detach(|| planagent_cli::run_inside(arguments, launcher, commit))
}
