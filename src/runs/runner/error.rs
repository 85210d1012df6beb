//! Errors of runs.

use super::commands::CommandError;
use super::config::ConfigError;
use super::of_run::NotNamed;
use super::sample::NoSuchType;
use crate::report::ReportError;
use crate::worker::split::SplitError;
use planagent_agent::planner::{ExecError, PlannerError, PlannerName};
use planagent_agent::planner_registry::UnknownPlanner;
use planagent_agent::reasoning::PromptError;
use planagent_agent::simulation::UnknownChallenge;
use planagent_files::{quoted, word_of};
use planagent_mllm::MllmError;
use planagent_scenario::ReaderError;
use std::path::PathBuf;

/// Why runs cannot be merged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum MergeError {
    #[error("no run to merge; name the folders of the shards")]
    NoRun,
    #[error(
        "cannot merge {} with {}, because it was started with other settings:\n  {}", other.display(), first.display(),
        differences.join("\n  ")
    )]
    Differs {
        first: PathBuf,
        other: PathBuf,
        differences: Vec<String>,
    },
    #[error("{}: the record of a simulation is damaged; `planagent simulate --resume {}` repeats it", record.display(), quoted(&word_of(run.as_os_str())))]
    Damaged { record: PathBuf, run: PathBuf },
    #[error(
        "{}: the folder of simulation {number} vanished while it was read; merge again when nothing else writes there",
        run.display()
    )]
    Vanished { number: usize, run: PathBuf },
    #[error(
        "{} and {} both hold simulation {number} ({simulation}), with different results; leave one of them out",
        first.display(), other.display()
    )]
    Overlap {
        first: PathBuf,
        other: PathBuf,
        number: usize,
        simulation: String,
    },
    #[error("{}: simulation {number} is {found}, expected {expected}", run.display())]
    Unexpected {
        run: PathBuf,
        number: usize,
        found: String,
        expected: String,
    },
    #[error("the simulations are not those of the scenarios in the manifest of {}", run.display())]
    OtherScenarios { run: PathBuf },
    #[error("{missing} of {total} simulations are in none of the runs; {advice}")]
    Incomplete {
        missing: usize,
        total: usize,
        advice: String,
    },
}

/// Why a run cannot start, resume or end. A failed simulation is no such error: the run records it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum RunnerError {
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error(transparent)]
    Split(#[from] SplitError),
    #[error(transparent)]
    Scenario(#[from] ReaderError),
    #[error(transparent)]
    Lab(Box<dyn std::error::Error + Send + Sync>),
    #[error(transparent)]
    Planner(#[from] UnknownPlanner),
    #[error(transparent)]
    Exec(#[from] ExecError),
    #[error(
        "the planner {planner} of this run is the command '{command}', which a run never starts by itself; name all planners of \
         the run again, this one by --planner '{planner}=exec:{command}'"
    )]
    CommandNotGiven { planner: String, command: String },
    #[error(transparent)]
    NotNamed(#[from] NotNamed),
    #[error(transparent)]
    Command(#[from] CommandError),
    #[error(
        "the other agents of this run are controlled by the command '{command}', which a run never starts by itself; name it again \
         by --agents '{policy}=exec:{command}'"
    )]
    AgentsNotGiven { policy: String, command: String },
    #[error("{source}; 'both' stands for the first two")]
    Challenge { source: UnknownChallenge },
    #[error(transparent)]
    Prompts(#[from] PromptError),
    #[error(transparent)]
    FindModel(Box<MllmError>),
    #[error("cannot load the model '{name}'")]
    LoadModel {
        name: String,
        source: Box<MllmError>,
    },
    #[error("the model '{name}' cannot be asked, so nothing is simulated")]
    AskModel {
        name: String,
        source: Box<MllmError>,
    },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("cannot make {} absolute: {source}", path.display())]
    Absolute {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("cannot serialize the configuration or the model")]
    Toml(#[from] toml::ser::Error),
    #[error("cannot serialize the results")]
    Json(#[from] serde_json::Error),
    #[error("the model of the run in {} is not what this program writes: {source}", folder.display())]
    ManifestModel {
        folder: PathBuf,
        source: toml::de::Error,
    },
    #[error(
        "{}: config.seed in manifest.toml is {found}, expected a whole number from 0 on; restore the file, or start a new run",
        folder.display()
    )]
    ManifestSeed { folder: PathBuf, found: String },
    #[error(
        "two scenarios have the id {id}: {first} and {second}; simulate them in two runs, or, of modifications, give one a key name"
    )]
    SameId {
        id: String,
        first: String,
        second: String,
    },
    #[error("there is no scenario to simulate")]
    NoScenario,
    #[error(transparent)]
    NoSuchType(#[from] NoSuchType),
    #[error("--limit is 0; it must be at least 1")]
    LimitZero,
    #[error(transparent)]
    Prepare(Box<PlannerError>),
    #[error("{key} is not supported by {planner}; remove one of them")]
    Unsupported {
        key: &'static str,
        planner: PlannerName,
    },
    #[error(
        "the scenario set changed since the run started: {then} then, {now} now, named by {words}"
    )]
    ScenariosChanged {
        then: usize,
        now: usize,
        words: String,
    },
    #[error(
        "{}: the run cannot be resumed, because it was started with other settings:\n  {}", folder.display(),
        differences.join("\n  ")
    )]
    OtherSettings {
        folder: PathBuf,
        differences: Vec<String>,
    },
    #[error("cannot resume the run in {} ({completed} of {total} simulations completed)", folder.display())]
    CannotResume {
        folder: PathBuf,
        completed: usize,
        total: usize,
        source: Box<Self>,
    },
    #[error("{missing} of {total} simulations left no record in {}", folder.display())]
    Unrecorded {
        missing: usize,
        total: usize,
        folder: PathBuf,
    },
    #[error("suite {name}")]
    Suite { name: String, source: Box<Self> },
    #[error("unknown list of text twins '{name}'; there are {known}")]
    UnknownPairs { name: String, known: String },
    #[error(
        "no recordings: name some by --scenario, or name a folder that holds {folders} by ${variable}"
    )]
    NoRecordings {
        folders: String,
        variable: &'static str,
    },
    #[error("the run in {} was stopped; resume it to simulate the rest", folder.display())]
    Stopped { folder: PathBuf },
    #[error(transparent)]
    Merge(#[from] MergeError),
    #[error("the bench in {} measured no model", .0.display())]
    EmptyBench(PathBuf),
}
