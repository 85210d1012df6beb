//! What a measuring process is asked and what it answers: a line of JSON each.

use super::budget::Layout;
use crate::mllm::{Step, StepTime, WeightFormat};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// Load a model; the first request.
    Load(LoadRequest),
    /// Do these steps.
    Run(Vec<Step>),
}

/// Which model, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadRequest {
    /// Which.
    pub model: ModelChoice,
    /// How its matrices are to be held; none for as they are.
    pub weight_format: Option<WeightFormat>,
    /// Threads to compute with.
    pub threads: usize,
    /// What the other engine measures with; none for the model's own.
    pub like: Option<Like>,
    /// Seed of weights and words.
    pub seed: u64,
}

/// What two engines must have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Like {
    /// Tokens that a sequence may hold.
    pub context: usize,
    /// Side of the square image, pixels.
    pub image_side: u32,
}

/// A model that is to be loaded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelChoice {
    /// A model that the registry knows, by its name.
    Named(String),
    /// Random weights in a known shape.
    Random(String),
    /// Files as llama.cpp reads them.
    Gguf(GgufPair),
}

/// A model in llama.cpp's two files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GgufPair {
    /// The decoder.
    pub decoder: PathBuf,
    /// Vision tower and projector.
    pub projector: PathBuf,
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// The model is there.
    Loaded(Loaded),
    /// The steps are done: a time for each.
    Ran(Vec<StepTime>),
    /// It did not work.
    Failed(String),
}

/// What was loaded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Loaded {
    /// Number of weights.
    pub parameters: u64,
    /// How most of them are held.
    pub weight_format: String,
    /// Side of the square image that it is shown, pixels.
    pub image_side: u32,
    /// Tokens that the image becomes.
    pub image_tokens: usize,
    /// Most tokens of a sequence with the image in it.
    pub context: usize,
    /// Where the system prompt stands.
    pub layout: Layout,
    /// Time to load, seconds.
    pub load_s: f64,
    /// Version of the engine.
    pub version: String,
}
