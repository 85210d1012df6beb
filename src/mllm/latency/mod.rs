//! What a model costs, token by token and without words: the same [`Step`]s as a conversation takes, on numbers of tokens.
//!
//! A step has no text in it, so any model can be measured, one with random weights too ([`ModelShape`]), and so can
//! another program that holds the same weights. Left out is what needs words: chat template, tokenizer, grammar.

mod probe;
mod shape;
mod step;

pub use probe::{LatencyProbe, ProbeDescription};
pub use shape::ModelShape;
pub use step::{PassTime, Step, StepTime};
