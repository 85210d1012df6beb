//! How a model is loaded: the choices of the user, and the files that they lead to.

use super::memory::{self, MemoryCheck};
use super::picture::PictureNeed;
use crate::MllmError;
use crate::adapter::AdapterSpec;
use crate::checkpoint::ModelFiles;
use crate::families::{Architecture, Families};
use crate::family::ImageSettings;
use crate::source::{Checkpoint, ModelPlace};
use planagent_kernels::matrix::WeightFormat;
use std::path::PathBuf;

/// How a model is loaded.
#[derive(Debug, Clone, Default)]
pub struct Loading {
    /// Format of the weights in memory; none for that of the files.
    pub quantize: Option<WeightFormat>,
    /// What is merged into the weights.
    pub adapter: Option<AdapterSpec>,
    /// The folder of the tokenizer, for models whose files have none.
    pub tokenizer: Option<PathBuf>,
    /// What to do when memory seems too small.
    pub memory: MemoryCheck,
    /// The family that the model must have, and the description that requires it; none for any.
    pub expected: Option<(Architecture, String)>,
    /// The families that it may have.
    pub families: Families,
    /// How images are shown to it.
    pub image: ImageSettings,
    /// Longest chat, tokens, which bounds the memory of keys and values; none for that of the
    /// model.
    pub context: Option<usize>,
    /// Most tokens of thinking before an answer; none for answers without thinking.
    pub thinking: Option<usize>,
}

impl Loading {
    /// Opens a model's small files and the headers of its weights and of its adapter.
    pub(crate) fn open(&self, place: &ModelPlace) -> Result<Checkpoint, MllmError> {
        Checkpoint::open(place, self.quantize, &self.families)?.adapted(self.adapter.as_ref())
    }

    /// As [`Self::open`]; checks the family and the memory.
    pub(crate) fn checkpoint(&self, place: &ModelPlace) -> Result<Checkpoint, MllmError> {
        let checkpoint = self.open(place)?;
        self.check_family(&checkpoint)?;
        if self.memory == MemoryCheck::Refuse {
            let decoder = checkpoint.decoder_config()?;
            let picture = PictureNeed::estimate(&checkpoint, self.image);
            memory::check(&checkpoint, &decoder, picture, self.quantize, self.context)?;
        }
        Ok(checkpoint)
    }

    pub(crate) fn check_family(&self, checkpoint: &Checkpoint) -> Result<(), MllmError> {
        let found = checkpoint.family;
        match &self.expected {
            Some((expected, by)) if *expected != found => Err(MllmError::Config {
                path: checkpoint.files.path("config.json"),
                key: "model_type".into(),
                problem: format!(
                    "this is a {} model, but the description '{by}' says {}",
                    found.name(),
                    expected.name()
                ),
            }),
            _ => Ok(()),
        }
    }

    /// The files of a model's tokenizer.
    pub(crate) fn tokenizer(
        &self,
        files: &ModelFiles,
        family: Architecture,
    ) -> Result<ModelFiles, MllmError> {
        let tokenizer = match &self.tokenizer {
            Some(folder) => ModelFiles::folder(folder)?,
            None => files.clone(),
        };
        if tokenizer.text("tokenizer.json")?.is_some() {
            return Ok(tokenizer);
        }
        Err(tokenizer.missing(family.family().missing_tokenizer))
    }
}
