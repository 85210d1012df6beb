//! Stage 11: runs. A run simulates every scenario with every planner in every challenge. It keeps
//! each simulation as it ends, resumes after an interruption, and writes its results once all
//! simulations are completed. Studies are runs on the same scenarios whose scores are compared.

mod agent_tables;
pub mod commands;
mod config;
mod error;
mod event;
#[cfg(test)]
mod hostile_folder_tests;
pub mod inputs;
mod machine;
mod merge;
pub mod model;
#[cfg(test)]
mod moved_folder_tests;
mod of_run;
mod probe;
mod request;
mod result_version;
pub mod run;
pub mod sample;
pub mod selection;
mod shard;
pub mod simulate;
mod tables;
mod watch;

pub use agent_tables::{agent_tables, language_agents};
pub use commands::CommandError;
pub use config::{Config, ConfigError, MllmConfig};
pub use error::{MergeError, RunnerError};
pub use event::{Event, Listener, silent};
pub use machine::{build_commit, cpu, memory, set_build_commit};
pub use merge::merge;
pub use model::{LoadedModel, load_model, model_registry};
pub use of_run::{NotNamed, OfRun};
pub use request::Request;
pub use result_version::RESULT_VERSION;
pub use run::RunResults;
pub use sample::NoSuchType;
pub use shard::{NoShard, Shard, ShardEnvironmentError};
pub use simulate::{resume, start};
