//! Multimodal language models, run in this process on the CPU, or asked over HTTP.
//!
//! A model is a [`Mllm`]; a planning call opens a [`Conversation`] with it and asks round after round. [`LocalModel`] opens
//! a Hugging Face folder or GGUF files as they are, of any [`Architecture`]; [`Endpoint`] asks a server with OpenAI's
//! interface. [`ModelRegistry`] finds a model by name, folder, file or hub id.
//!
//! A family of models is a folder: `llava`, `llava_next`, `cogvlm`, each with its configuration, preprocessing, vision
//! tower, connector and language model as far as it does not share them (`vision`, `decoder`). `local` runs whatever
//! implements its `VisionLanguageModel`.

mod attention;
mod checkpoint;
mod cogvlm;
mod conversation;
mod deadline;
mod decoder;
mod endpoint;
mod error;
mod export;
mod families;
mod family;
mod gguf;
mod latency;
mod layer_norm;
mod linear;
mod llava;
mod llava_next;
mod local;
mod matrix;
mod pointwise;
mod registry;
mod rms_norm;
mod sampling;
mod source;
mod text;
mod values;
mod vision;

pub(crate) use checkpoint::in_bytes;
pub use checkpoint::{LlamaConfig, LoadReport, ModelFiles, WeightFormatException, WeightFormatShare, Weights};
pub(crate) use conversation::milliseconds;
pub use conversation::{
    Answer, Constraint, ConstraintUse, Conversation, FinishReason, Mark, Mllm, ModelDescription, PromptPrefix, Request,
    RoundTime, Sampling, Server, TokenCounts, Turn, prompt_hash,
};
pub use deadline::Deadline;
pub use decoder::{DecoderInput, KvCache, Logits};
pub use endpoint::{Endpoint, EndpointSettings, GrammarField, LimitField};
pub use error::{EndpointFailure, MllmError};
pub use export::{CreateFile, GgufPart, export_model};
pub use families::{Architecture, Families};
pub use family::{Chat, ChatFormat, Family, LanguageModel, ModelInfo, Positions, Tiles, VisionLanguageModel};
pub use gguf::{Entries, GgufLayout, Header as GgufHeader, Value as GgufValue};
pub use latency::{LatencyProbe, PassTime, ProbeDescription, Step, StepTime};
pub use local::{Loading, LocalModel, MemoryCheck, MemoryNeed, ModelCheck};
pub use matrix::{Matrix, UnknownWeightFormat, WeightFormat};
pub use registry::{
    FetchListener, FetchProgress, GenerationSettings, HubAccess, HubFiles, ModelRegistry, ModelSource, ModelSpec,
    PromptSet, RoundTokens,
};
pub use source::ModelPlace;
pub use source::ModelShape;
pub use text::ChatTokenizer;
