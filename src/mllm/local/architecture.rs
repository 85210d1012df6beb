//! The families of models, by what a checkpoint's configuration says it is.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::vlm::VisionLanguageModel;
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Checkpoint, LlamaConfig, ModelFiles, Section};
use crate::mllm::cogvlm::{CogVlm, CogVlmConfig};
use crate::mllm::llava::{Llava, LlavaConfig};
use crate::mllm::llava_next::LlavaNext;

/// Families of models that are computed in this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Architecture {
    /// LLaVA 1.5: CLIP vision tower, projector, Llama decoder (`LlavaForConditionalGeneration`).
    Llava,
    /// LLaVA 1.6, LLaVA-NeXT: the same over tiles of the image, with a Llama or Mistral decoder
    /// (`LlavaNextForConditionalGeneration`).
    LlavaNext,
    /// `CogVLM`, first version: EVA2-CLIP vision tower, Llama decoder with visual experts (`CogVLMForCausalLM`).
    #[serde(rename = "cogvlm")]
    CogVlm,
}

impl Architecture {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Llava, Self::LlavaNext, Self::CogVlm];

    /// The name in model descriptions and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Llava => "llava",
            Self::LlavaNext => "llava-next",
            Self::CogVlm => "cogvlm",
        }
    }

    /// `model_type` and class name in Hugging Face configurations.
    fn hugging_face_names(self) -> [&'static str; 2] {
        match self {
            Self::Llava => ["llava", "LlavaForConditionalGeneration"],
            Self::LlavaNext => ["llava_next", "LlavaNextForConditionalGeneration"],
            Self::CogVlm => ["cogvlm", "CogVLMForCausalLM"],
        }
    }

    /// What the `config.json` of a folder says: its `model_type`, else the first of its `architectures`.
    ///
    /// # Errors
    /// When there is no such file, it says nothing, or it names a family that is not supported.
    pub fn detect(folder: &Path) -> Result<Self, MllmError> {
        Self::of(&ModelFiles::folder(folder)?)
    }

    /// What the `config.json` of a model says, as [`Self::detect`].
    ///
    /// # Errors
    /// As [`Self::detect`].
    pub(crate) fn of(files: &ModelFiles) -> Result<Self, MllmError> {
        let json = files.required_json("config.json")?;
        let path = files.path("config.json");
        let root = Section::root(&path, &json)?;
        let (key, found) = match root.text("model_type")? {
            Some(kind) => ("model_type", Some(kind)),
            None => ("architectures", root.get("architectures").and_then(|names| names.get(0)?.as_str())),
        };
        let Some(found) = found else {
            return Err(
                root.error("model_type", "neither it nor architectures says which kind of model this is".into())
            );
        };
        Self::ALL.into_iter().find(|family| family.hugging_face_names().contains(&found)).ok_or_else(|| {
            let known = Self::ALL.map(|family| family.hugging_face_names()[0]).join(", ");
            root.error(key, format!("{found:?} is not supported; supported are {known}"))
        })
    }

    /// Opens the configuration, the preprocessor and the weights of a checkpoint.
    ///
    /// # Errors
    /// When one of them is missing or broken.
    pub(crate) fn open(self, checkpoint: &mut Checkpoint) -> Result<Box<dyn VisionLanguageModel>, MllmError> {
        Ok(match self {
            Self::Llava => Box::new(Llava::open(checkpoint)?),
            Self::LlavaNext => Box::new(LlavaNext::open(checkpoint)?),
            Self::CogVlm => Box::new(CogVlm::open(checkpoint)?),
        })
    }

    /// The configuration of the decoder.
    ///
    /// # Errors
    /// When `config.json` is missing or broken.
    pub(crate) fn decoder(self, files: &ModelFiles) -> Result<LlamaConfig, MllmError> {
        Ok(match self {
            Self::Llava | Self::LlavaNext => LlavaConfig::open(files)?.text,
            Self::CogVlm => CogVlmConfig::open(files)?.text,
        })
    }
}
