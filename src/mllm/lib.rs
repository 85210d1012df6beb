//! Multimodal language models, on the CPU of this process or on an HTTP server.
//!
//! A planning call opens a [`Conversation`] with an [`Mllm`] and asks round after round.
//! [`ModelRegistry`] finds a model by name, folder, file or hub id. `Endpoint` asks a server with
//! `OpenAI`'s interface. A [`LocalModel`] runs here:
//! 1. `source` opens the files of a model: safetensors, GGUF or random weights ([`ModelPlace`]).
//! 2. A [`Family`] turns them into a [`VisionLanguageModel`]. `families` lists them; they share
//!    `vision` and `decoder`.
//! 3. `local` tokenizes a chat, computes what is new of it, and generates the answer under a
//!    grammar.
//!
//! Below them, `checkpoint` and `gguf` read weights and configurations, and `adapter` merges an
//! adapter into the weights. The arithmetic is that of
//! [`planagent_kernels`].

#![allow(
    missing_docs,
    reason = "many names say all; the root describes what users see"
)]

mod adapter;
mod checkpoint;
#[cfg(test)]
mod class_keys;
mod cogvlm;
mod conversation;
mod deadline;
mod decoder;
#[cfg(feature = "endpoint")]
mod endpoint;
mod endpoint_settings;
mod error;
mod export;
mod families;
mod family;
mod gemma3;
mod gemma3n;
mod gemma4;
mod gguf;
mod internvl;
mod key_variable;
mod latency;
mod lfm2_vl;
mod llava;
mod llava_next;
mod llava_onevision;
mod local;
mod qwen2_5_vl;
mod qwen2_vl;
mod qwen3_5;
mod qwen3_vl;
mod registry;
mod sampling;
mod smolvlm;
mod source;
mod template_format;
mod text;
mod text_only;
mod tiled;
pub mod trial;
mod vision;

pub use adapter::AdapterSpec;
pub use checkpoint::{
    LlamaConfig, LoadReport, MergedAdapter, ModelFiles, WeightFormatException, WeightFormatShare,
    Weights,
};
pub use checkpoint::{in_bytes, parameter_count};
pub use conversation::milliseconds;
pub use conversation::{
    Answer, AnswerTime, Constraint, ConstraintUse, Conversation, FinishReason, Mark, Mllm,
    ModelDescription, ProbeQuestion, PromptPrefix, Request, RoundTime, Sampling, Server,
    TokenCounts, Turn, image_hash, prompt_hash,
};
pub use deadline::Deadline;
pub use decoder::{DecoderCache, DecoderInput, LanguageModel, Logits, Position};
#[cfg(feature = "endpoint")]
pub use endpoint::Endpoint;
pub use endpoint_settings::{EndpointSettings, GrammarField, LimitField};
pub use error::{EndpointFailure, MllmError};
pub use export::{CreateFile, GgufPart, export_model, small_files};
pub use families::{Architecture, Families};
pub use family::{
    About, Chat, ChatFormat, ChatImage, Family, ImageFeatures, ImageLayout, ImageRange,
    ImageSettings, ModelInfo, OpenedModel, PlacedImage, Positions, Tiles, VisionLanguageModel,
};
pub use gguf::{GgufLayout, Header as GgufHeader};
pub use latency::{LatencyProbe, PassTime, Step, StepTime};
pub use local::{
    FormatOutline, Loading, LocalModel, MemoryCheck, MemoryNeed, ModelCheck, ModelOutline,
    ModelWork,
};
pub use planagent_kernels::matrix::{Instructions, Matrix, UnknownWeightFormat, WeightFormat};
pub use planagent_kernels::{Limits, Work};
pub use registry::{
    Asking, DescribedPrompts, FetchListener, FetchProgress, GenerationSettings, HubAccess,
    ModelInputs, ModelRegistry, ModelSource, ModelSpec, NamedBy, PromptSet, RoundTokens,
};
pub use registry::{data_folder, models_folder, offline_variable};
pub use source::{EmbeddedModel, ModelPlace, ModelShape};
pub use text::{ChatTokenizer, TemplateEngine};
pub use trial::Trust;
