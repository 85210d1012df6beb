//! Errors of the library as exceptions of `planagent.errors`.

use planagent::planning::PlannerError;
use planagent::sources::ReaderError;
use planagent::traffic::SimulationError;
use planagent_mllm::MllmError;
use planagent_runs::report::ReportFault;
use planagent_runs::runner::RunnerError;
use planagent_runs::worker::run::with_causes;
use pyo3::prelude::*;
use std::io::{Error as IoError, ErrorKind};

/// An error with the name of its class in `planagent.errors`. It needs no interpreter until it is
/// raised.
#[derive(Debug)]
pub(crate) struct Failure {
    class: &'static str,
    text: String,
}

/// A result of work without the GIL.
pub(crate) type Outcome<T> = Result<T, Failure>;

impl Failure {
    pub(crate) fn new(class: &'static str, text: impl Into<String>) -> Self {
        Self {
            class,
            text: in_words_of_python(text.into()),
        }
    }

    /// An argument that cannot be used.
    pub(crate) fn argument(text: impl Into<String>) -> Self {
        Self::new("ArgumentError", text)
    }

    /// A panic of the library.
    pub(crate) fn panic(text: impl Into<String>) -> Self {
        Self::new("InternalError", text)
    }

    /// The exception.
    pub(crate) fn raised(self, py: Python<'_>) -> PyErr {
        let class = py
            .import("planagent.errors")
            .and_then(|module| module.getattr(self.class));
        match class.and_then(|class| class.call1((self.text,))) {
            Ok(instance) => PyErr::from_value(instance),
            Err(error) => error,
        }
    }
}

/// What the errors of the library say of the command line, and what a user of Python does.
const WORDS: &[(&str, &str)] = &[
    ("resume it with --resume", "resume it with planagent.resume"),
    (
        "repeat it with --resume",
        "repeat it with planagent.resume:",
    ),
    (
        "start it again with --out",
        "start it again with planagent.simulate",
    ),
    (
        "continue with `planagent simulate --resume",
        "continue with `planagent.resume",
    ),
    (
        "resume it with --accept-changes",
        "resume it with accept_changes=True",
    ),
    (
        "`planagent scenarios list` names them",
        "planagent.scenario_types() names them",
    ),
    (
        "`planagent models fetch`",
        "planagent.Model with its hub id",
    ),
    (
        "is --data-root the folder",
        "is NUPLAN_DATA_ROOT the folder",
    ),
    (
        "give --data-root or set NUPLAN_DATA_ROOT",
        "set NUPLAN_DATA_ROOT",
    ),
    ("--data-root or NUPLAN_DATA_ROOT", "NUPLAN_DATA_ROOT"),
    (
        "give --maps-root or set NUPLAN_MAPS_ROOT",
        "set NUPLAN_MAPS_ROOT",
    ),
    ("--maps-root or NUPLAN_MAPS_ROOT", "NUPLAN_MAPS_ROOT"),
    ("--checkpoint FILE, or by the setting", "the setting"),
    ("or use simulate_with_agents", "as exec:COMMAND"),
    ("--scenario", "scenarios"),
    ("--planner", "planners"),
    ("--challenge", "challenge"),
    ("--type", "types"),
    ("--quantize", "the setting mllm.quantize"),
    ("--trust-model or `trusted = true`", "`trusted = true`"),
    (
        "AgentBuilder::trust_model does, or `trusted = true` in the model's description",
        "`trusted = true` in the model's description does",
    ),
    ("(--prompt-set)", "by the setting reasoning.prompt_set"),
    ("--prompt-set", "the setting reasoning.prompt_set"),
    ("--context", "the setting mllm.context"),
    ("--ignore-memory", "the setting mllm.ignore_memory"),
];

/// An error in the words of Python: what is left of options becomes names of arguments.
fn in_words_of_python(text: String) -> String {
    let text = WORDS
        .iter()
        .fold(text, |text, (before, after)| text.replace(before, after));
    let mut words = text.split(' ').map(|word| match word.strip_prefix("--") {
        Some(option) if option.starts_with(|c: char| c.is_ascii_lowercase()) => {
            option.replace('-', "_")
        }
        _ => word.to_owned(),
    });
    let first = words.next().unwrap_or_default();
    words.fold(first, |text, word| format!("{text} {word}"))
}

/// Whether a missing file is among the causes.
fn is_missing(error: &(dyn std::error::Error + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if error
            .downcast_ref::<IoError>()
            .is_some_and(|io| io.kind() == ErrorKind::NotFound)
        {
            return true;
        }
        cause = error.source();
    }
    false
}

impl From<ReaderError> for Failure {
    fn from(error: ReaderError) -> Self {
        let missing = matches!(error, ReaderError::Missing(_)) || is_missing(&error);
        Self::new(
            if missing {
                "ScenarioNotFoundError"
            } else {
                "ScenarioError"
            },
            with_causes(&error),
        )
    }
}

impl From<SimulationError> for Failure {
    fn from(error: SimulationError) -> Self {
        Self::new("SimulationError", with_causes(&error))
    }
}

impl From<PlannerError> for Failure {
    fn from(error: PlannerError) -> Self {
        Self::new("PlannerError", with_causes(&error))
    }
}

impl From<MllmError> for Failure {
    fn from(error: MllmError) -> Self {
        let class = if is_missing(&error) {
            "ModelNotFoundError"
        } else {
            "ModelError"
        };
        Self::new(class, with_causes(&error))
    }
}

impl From<RunnerError> for Failure {
    fn from(error: RunnerError) -> Self {
        let class = match &error {
            RunnerError::Scenario(error) => match error {
                ReaderError::Missing(_) => "ScenarioNotFoundError",
                _ => "ScenarioError",
            },
            RunnerError::Report(error) if matches!(error.fault, ReportFault::Locked(_)) => {
                "RunLockedError"
            }
            RunnerError::LoadModel { .. } | RunnerError::FindModel(_) if is_missing(&error) => {
                "ModelNotFoundError"
            }
            RunnerError::LoadModel { .. }
            | RunnerError::FindModel(_)
            | RunnerError::AskModel { .. } => "ModelError",
            RunnerError::Planner(_)
            | RunnerError::Challenge { .. }
            | RunnerError::Config(_)
            | RunnerError::Command(_)
            | RunnerError::Exec(_)
            | RunnerError::Split(_)
            | RunnerError::NoSuchType(_)
            | RunnerError::NoScenario
            | RunnerError::LimitZero
            | RunnerError::Unsupported { .. } => "ArgumentError",
            _ if is_missing(&error) => "RunNotFoundError",
            _ => "RunError",
        };
        Self::new(class, with_causes(&error))
    }
}

/// Raises failures.
pub(crate) trait Raise<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> Raise<T> for Outcome<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|failure| failure.raised(py))
    }
}
