//! Stage 11: runs. A run simulates every scenario with every planner in every challenge. It keeps each simulation as it
//! ends, resumes after an interruption, and writes its results once all simulations are completed. Experiments are runs
//! on the same scenarios whose scores are compared.

mod commands;
mod config;
mod error;
mod event;
mod experiments;
mod inputs;
mod machine;
mod merge;
mod model;
mod request;
mod result_version;
mod run;
mod sample;
mod selection;
mod shard;
mod simulate;

pub use commands::CommandError;
pub use config::{Config, ConfigError, MllmConfig};
pub use error::{MergeError, RunnerError};
pub use event::{Event, Listener, silent};
pub use experiments::{Experiments, ExperimentsRequest, StudyOutcome, SuiteTokens, TOKENS, TOKENS_TITLE, TWINS};
pub use machine::{build_commit, cpu, memory};
pub use merge::merge;
pub use model::{LoadedModel, load_model, model_registry};
pub use request::Request;
pub use result_version::RESULT_VERSION;
pub use run::RunResults;
pub use sample::NoSuchType;
pub use shard::{NoShard, Shard, ShardEnvironmentError};
pub use simulate::{resume, start};
