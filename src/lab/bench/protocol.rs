//! The protocol of a measuring process: requests and replies are lines of JSON.

use super::budget::Layout;
use planagent_mllm::{Limits, Step, StepTime, WeightFormat};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// Writes the files that an engine reads, in a process of its own.
    Prepare(PrepareRequest),
    /// The first request of a measurement.
    Load(LoadRequest),
    Run(Vec<Step>),
    /// Computes a prompt alone and continues it with the likeliest tokens.
    Answer {
        prompt: Vec<u32>,
        count: usize,
    },
    /// Encodes a picture of ramps, of this side in pixels, and gives the numbers of at most so many
    /// of its tokens ([`LatencyProbe::features`](planagent_mllm::LatencyProbe::features)).
    Features {
        side: u32,
        most: usize,
    },
    /// Measures what the processor can do at most; for this program alone.
    Limits,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadRequest {
    pub model: ModelChoice,
    /// Weight format of the matrices; `None` for that of the files.
    pub weight_format: Option<WeightFormat>,
    pub threads: usize,
    /// Side of the image that is drawn for the model, pixels; `None` for the model's own.
    #[serde(default)]
    pub image_size: Option<u32>,
    /// Sizes of the other engine's run; `None` for the model's own.
    pub like: Option<Like>,
    /// Seed of random weights and of the prompt tokens.
    pub seed: u64,
}

/// Sizes that two engines must share.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Like {
    /// Maximum tokens of a sequence.
    pub context: usize,
    /// Side of the square image, pixels.
    pub image_side: u32,
    /// Tokens of the image. An engine that makes more shows the last views that make so many, if
    /// there are such.
    pub image_tokens: usize,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelChoice {
    /// A model of the registry, by name.
    Named(String),
    /// Random weights of a shape, by its name.
    Random(String),
    /// Files that llama.cpp reads too.
    Gguf(GgufPair),
    /// A folder of safetensors, and what another engine made of it.
    Exported(ExportedFolder),
}

/// A model in Hugging Face's layout, and its export for another engine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportedFolder {
    /// The folder that this program reads.
    pub folder: PathBuf,
    /// The folder that the other engine reads.
    pub export: PathBuf,
}

/// What an engine needs to write the files that it reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrepareRequest {
    /// The model in Hugging Face's layout. Without safetensors, it gets `files` and weights: those
    /// of `gguf`, else random ones of `seed`.
    pub folder: PathBuf,
    /// Texts of the model's small files, by name.
    pub files: BTreeMap<String, String>,
    /// The decoder that the weights are from.
    pub gguf: Option<PathBuf>,
    /// Where the export goes. A finished one stays. The folder above it keeps what further
    /// precisions need.
    pub export: PathBuf,
    /// Precision of the decoder's weights.
    pub weights: Precision,
    /// Precision of the vision tower.
    pub tower: Precision,
    pub seed: u64,
}

/// A precision of another engine's weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Also all arithmetic, keys and values.
    F32,
    /// Where the processor has it.
    Bf16,
    Int8,
    Int4,
}

impl Precision {
    pub(crate) const ALL: [Self; 4] = [Self::F32, Self::Bf16, Self::Int8, Self::Int4];

    fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
            Self::Int8 => "int8",
            Self::Int4 => "int4",
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for Precision {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|all| all.name() == name);
        found.ok_or_else(|| format!("'{name}' is no precision; f32, bf16, int8 and int4 are"))
    }
}

/// The files of a model for llama.cpp.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GgufPair {
    pub decoder: PathBuf,
    /// Vision tower and projector; none for a model that reads text alone.
    pub projector: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// The files are there.
    Prepared,
    Loaded(Loaded),
    /// The time of each step.
    Ran(Vec<StepTime>),
    /// The logits behind the prompt, and the tokens.
    Answered {
        logits: Vec<f32>,
        tokens: Vec<u32>,
    },
    /// The number of the picture's tokens, and the numbers of those that were asked for.
    Encoded {
        tokens: usize,
        values: Vec<f32>,
    },
    Limits(Limits),
    Failed(String),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Loaded {
    /// Number of weights.
    pub parameters: u64,
    /// Weight format of most weights.
    pub weight_format: String,
    /// Side of the square image, pixels.
    pub image_side: u32,
    pub image_tokens: usize,
    /// Number of token ids; 0 where the engine does not say.
    #[serde(default)]
    pub vocabulary: usize,
    /// The token that stands for one of the image; none where the engine does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_token: Option<u32>,
    /// Maximum tokens of a sequence, image included.
    pub context: usize,
    pub layout: Layout,
    /// Load time, seconds.
    pub load_s: f64,
    pub version: String,
}
