//! What a run reports while it works.

use crate::worker::FailedCall;
use planagent_mllm::FetchProgress;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// A message of a run to its caller. The command line shows it; a library user may ignore it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A remark that every user should see.
    Note(String),
    /// A remark for users who ask for details.
    Detail(String),
    /// How many of a split's logs have been searched.
    LogsSearched {
        /// Logs that have been searched.
        done: usize,
        /// Logs of the split.
        total: usize,
    },
    /// How much of a model's file has been downloaded.
    Fetched(FetchProgress),
    /// How many scenes of a suite have been counted.
    ScenesCounted {
        /// Scenes that have been counted.
        done: usize,
        /// Scenes of the suite.
        total: usize,
    },
    /// The folder of a run is open: what is completed stays in it.
    Opened {
        /// The folder.
        folder: PathBuf,
        /// Whether a command is a planner of the run, or controls its agents. A run that is resumed
        /// takes commands from its user alone.
        has_commands: bool,
        /// Options with their values that a run which is resumed takes from its user alone, such
        /// as `--model org/model`.
        named_again: Vec<[String; 2]>,
    },
    /// So many simulations start.
    Started {
        /// How many.
        total: usize,
    },
    /// A simulation advanced by one step of 0.1 s. Sent from every thread.
    Stepped,
    /// The first planning call of a run that got no answer, or the first whose answer gave no plan.
    /// Sent at once, from any thread.
    CallFailed(FailedCall),
    /// The first simulation of a run that failed in a way of its own, while others are left. Sent at
    /// once, from any thread.
    SimulationFailed {
        /// The scenario, the planner, the challenge and the error, in a line.
        failure: String,
    },
    /// A simulation ended.
    Ended {
        /// Whether it failed.
        failed: bool,
    },
    /// All simulations of the last [`Event::Started`] ended, or a write error stopped them.
    Finished,
    /// The runs of studies are open.
    Planned {
        /// Runs.
        runs: usize,
        /// Simulations that are completed.
        completed: usize,
        /// Simulations that are left.
        left: usize,
    },
    /// Simulations are left, and their time is known.
    Estimated {
        /// Simulations that are left.
        left: usize,
        /// Time that they take on the threads of the current pool.
        time: Duration,
    },
}

/// Receives the events of a run, from several threads.
pub type Listener = Arc<dyn Fn(Event) + Send + Sync>;

/// A listener that ignores every event.
pub fn silent() -> Listener {
    Arc::new(|_| ())
}
