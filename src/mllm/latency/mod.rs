//! The time that a model takes for the [`Step`]s of a conversation, given in numbers of tokens.
//!
//! A step has no text, so it can measure models with random weights
//! ([`ModelShape`](super::ModelShape)) and other programs with the same weights. Chat template,
//! tokenizer and grammar are not measured.

mod probe;
mod step;

pub use probe::LatencyProbe;
pub use step::{PassTime, Step, StepTime};
