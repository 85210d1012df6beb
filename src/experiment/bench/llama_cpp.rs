//! llama.cpp, as the Python package `llama-cpp-python` brings it along.

use std::path::PathBuf;
use std::process::Command;

/// The process that measures: reads requests, drives `llama_cpp`'s low-level interface, writes replies.
const WORKER: &str = include_str!("llama_cpp_worker.py");

/// How llama.cpp is run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LlamaCpp {
    /// A Python interpreter that has `llama_cpp`.
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
