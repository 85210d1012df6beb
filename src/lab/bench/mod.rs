//! The cost of a planning call, for each model, also compared with other engines.
//!
//! Each model has its own process ([`Engine`]), so that its peak memory is its own. The process is
//! this program, with its own kernels ([`serve`]) or candle's decoders ([`serve_candle`]), or Python
//! with llama.cpp or OpenVINO ([`PythonEngine`]). All use the same [`protocol`] and run the same [`Step`](planagent_mllm::Step)s of a [`Workload`].

mod agreement;
mod budget;
mod candle;
mod engine;
mod estimate;
mod machine_limits;
pub mod protocol;
mod python;
mod row;
mod run;
mod serve;
mod workload;

pub use agreement::{Agreement, PictureAgreement};
pub(crate) use budget::DRAFTED;
#[cfg(test)]
pub(crate) use budget::Layout;
pub use budget::{AnswerPart, CallBudget, RoundBudget};
pub use engine::{Engine, EngineError, EngineName};
pub use estimate::CallEstimate;
pub use machine_limits::machine_limits;
pub use python::{PythonEngine, PythonWorker};
pub use row::{FailedRow, IterationRow, ModelRow, Row, TimedStep};
pub use run::{BenchSettings, Candidate, Other, Progress, run};
pub use serve::{serve, serve_candle};
pub use workload::Workload;
