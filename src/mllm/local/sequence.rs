//! The tokens of a chat that a model has computed.

use std::ops::Range;

use candle_core::Tensor;

use super::vlm::{InputEmbeddings, VisionLanguageModel};
use crate::mllm::decoder::{KvCache, KvPrefix, Logits};
use crate::mllm::{Deadline, MllmError};

/// Most tokens that are computed in one pass, so that a deadline is looked at in between and activations stay small.
const MAX_TOKENS_IN_PASS: usize = 512;

/// Tokens that the decoder has seen, with their keys and values.
#[derive(Debug)]
pub(crate) struct Sequence {
    ids: Vec<u32>,
    cache: KvCache,
}

/// The beginning of a sequence, to start others from.
#[derive(Debug)]
pub(crate) struct SequencePrefix {
    ids: Vec<u32>,
    cache: KvPrefix,
}

impl Sequence {
    /// A sequence of no tokens.
    pub(crate) fn new(model: &dyn VisionLanguageModel) -> Self {
        Self { ids: Vec::new(), cache: model.new_cache() }
    }

    /// The tokens.
    pub(crate) fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Appends tokens and gives the wanted logits (wanted positions, vocabulary). Image tokens take their rows of
    /// `features`, in the order in which they stand in the sequence. After an error the sequence is unchanged.
    ///
    /// # Errors
    /// When the sequence grows beyond the cache, or an image token has no feature.
    pub(crate) fn append(
        &mut self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&Tensor>,
        wanted: Logits,
    ) -> Result<Option<Tensor>, MllmError> {
        if ids.is_empty() {
            return Ok(None);
        }
        let rows = self.input_embeddings(model, ids, features)?;
        let logits = model.forward(&rows, &mut self.cache, wanted)?;
        self.ids.extend_from_slice(ids);
        Ok(logits)
    }

    /// Appends tokens in as many passes as they need, looks at the deadline before each, and gives the wanted logits of the
    /// last. After an error the passes before it stay appended.
    ///
    /// # Errors
    /// As [`Self::append`], and when the deadline passes.
    pub(crate) fn append_in_passes(
        &mut self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&Tensor>,
        wanted: Logits,
        deadline: Deadline,
    ) -> Result<Option<Tensor>, MllmError> {
        let mut logits = None;
        let mut passes = ids.chunks(MAX_TOKENS_IN_PASS).peekable();
        while let Some(pass) = passes.next() {
            deadline.check()?;
            let wanted = if passes.peek().is_none() { wanted } else { Logits::None };
            logits = self.append(model, pass, features, wanted)?;
        }
        Ok(logits)
    }

    /// The decoder's input for tokens that follow the sequence.
    pub(crate) fn input_embeddings(
        &self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&Tensor>,
    ) -> Result<InputEmbeddings, MllmError> {
        let image_token = model.info().image_token;
        let is_image = |id: &u32| *id == image_token;
        let mut used = self.ids.iter().filter(|id| is_image(id)).count();
        let known = features.map_or(Ok(used), |features| features.dim(0))?;
        let mut rows = Vec::new();
        for run in ids.chunk_by(|a, b| is_image(a) == is_image(b)) {
            if run.first().is_some_and(is_image) {
                let Some(features) = features.filter(|_| used + run.len() <= known) else {
                    return Err(MllmError::ImagePlaceholder { expected: known, found: used + run.len() });
                };
                rows.push(features.narrow(0, used, run.len())?);
                used += run.len();
            } else {
                rows.push(model.embed(run)?);
            }
        }
        let image: Range<usize> = match self.ids.iter().chain(ids).position(is_image) {
            Some(first) => first..first + known,
            None => 0..0,
        };
        Ok(InputEmbeddings { rows: Tensor::cat(&rows, 0)?, start: self.ids.len(), image })
    }

    /// Forgets the tokens from `len` on.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.ids.truncate(len);
        self.cache.truncate(len);
    }

    /// Copies the whole sequence.
    pub(crate) fn to_prefix(&self) -> SequencePrefix {
        SequencePrefix { ids: self.ids.clone(), cache: self.cache.prefix(self.cache.len()) }
    }

    /// Replaces the sequence by a copy of a prefix.
    pub(crate) fn restore(&mut self, prefix: &SequencePrefix) -> Result<(), MllmError> {
        self.ids.clear();
        self.cache.restore(&prefix.cache)?;
        self.ids.extend_from_slice(&prefix.ids);
        Ok(())
    }
}
