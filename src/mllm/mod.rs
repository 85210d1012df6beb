//! Multimodal language models, run in this process on the CPU.
//!
//! A model is a [`Mllm`]; a planning call opens a [`Conversation`] with it and asks round after round. [`Llava`] opens a
//! Hugging Face `LlavaForConditionalGeneration` folder as it is; [`Replay`] answers from a recording.
//! [`ModelRegistry`] finds a model by name, folder or hub id.

mod checkpoint;
mod conversation;
mod decoder;
mod error;
mod linear;
mod llava;
mod registry;
mod replay;
mod sampling;
mod text;
mod vision;

pub use conversation::{
    Answer, Constraint, Conversation, FinishReason, Mark, Mllm, ModelDescription, Opening, Request, RoundTime,
    Sampling, TokenCounts, Turn, prompt_hash,
};
pub use error::MllmError;
pub use llava::Llava;
pub use registry::{
    Architecture, GenerationSettings, HubAccess, ModelRegistry, ModelSource, ModelSpec, PromptSet, RoundTokens,
};
pub use replay::{RecordedAnswer, Replay};
