//! llama.cpp through the Python package `llama-cpp-python`.

use std::path::PathBuf;
use std::process::Command;

/// The measuring process: reads requests, calls the low-level interface of `llama_cpp`, writes replies.
const WORKER: &str = include_str!("llama_cpp_worker.py");

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LlamaCpp {
    /// A Python interpreter with `llama_cpp`.
    pub python: PathBuf,
}

impl LlamaCpp {
    /// The command of the measuring process.
    pub fn command(&self) -> Command {
        let mut command = Command::new(&self.python);
        command.args(["-c", WORKER]);
        command
    }
}
