//! Multimodal language models, run in this process on the CPU, or asked over HTTP.
//!
//! A model is a [`Mllm`]; a planning call opens a [`Conversation`] with it and asks round after round. [`LocalModel`] opens
//! a Hugging Face folder as it is, of any [`Architecture`]; [`Endpoint`] asks a server with OpenAI's interface; [`Replay`]
//! answers from a recording. [`ModelRegistry`] finds a model by name, folder or hub id.
//!
//! A family of models is a folder: `llava`, `llava_next`, `cogvlm`, each with its configuration, preprocessing, vision
//! tower, connector and language model as far as it does not share them (`vision`, `decoder`). `local` runs whatever
//! implements its `VisionLanguageModel`.

mod checkpoint;
mod cogvlm;
mod conversation;
mod deadline;
mod decoder;
mod endpoint;
mod error;
mod layer_norm;
mod linear;
mod llava;
mod llava_next;
mod local;
mod registry;
mod replay;
mod sampling;
mod text;
mod vision;

pub use conversation::{
    Answer, Constraint, ConstraintUse, Conversation, FinishReason, Mark, Mllm, ModelDescription, Opening, Request,
    RoundTime, Sampling, Server, TokenCounts, Turn, prompt_hash,
};
pub use deadline::Deadline;
pub use endpoint::{Endpoint, EndpointSettings, GrammarField, LimitField};
pub use error::{EndpointFailure, MllmError};
pub use local::{Architecture, LocalModel};
pub use registry::{
    GenerationSettings, HubAccess, HubFiles, ModelRegistry, ModelSource, ModelSpec, PromptSet, RoundTokens,
};
pub use replay::{RecordedAnswer, Replay};
