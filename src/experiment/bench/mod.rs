//! What a planning call costs, model by model, and beside llama.cpp.
//!
//! Every model is measured in a process of its own ([`Engine`]), so that its peak of memory is its own. The process is this
//! program again ([`serve`]) or Python with llama.cpp in it ([`LlamaCpp`]); both speak the same [`protocol`] and work off
//! the same [`Step`](crate::mllm::Step)s, which a [`Workload`] lists.

mod budget;
mod engine;
mod llama_cpp;
pub mod protocol;
mod row;
mod run;
mod serve;
mod workload;

pub use budget::{AnswerPart, CallBudget, RoundBudget};
pub use engine::{Engine, EngineError, EngineName};
pub use llama_cpp::LlamaCpp;
pub use row::{FailedRow, IterationRow, ModelRow, Row, TimedStep};
pub use run::{BenchSettings, Candidate, Progress, run};
pub use serve::serve;
pub use workload::Workload;
