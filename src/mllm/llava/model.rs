//! The weights of a LLaVA model and what they compute, without any text around them.

use std::path::Path;

use candle_core::Tensor;

use crate::mllm::MllmError;
use crate::mllm::checkpoint::{LlavaConfig, Weights, read_required_json};
use crate::mllm::decoder::{KvCache, KvPrefix, LlamaDecoder, Logits};
use crate::mllm::vision::ImageEncoder;

/// Vision tower, projector and decoder of a checkpoint.
#[derive(Debug)]
pub(crate) struct LlavaModel {
    config: LlavaConfig,
    encoder: ImageEncoder,
    decoder: LlamaDecoder,
    parameters: u64,
    blake3: String,
}

/// Tokens that the decoder has seen, with their keys and values.
#[derive(Debug)]
pub(crate) struct Sequence {
    ids: Vec<u32>,
    cache: KvCache,
}

/// The beginning of a sequence, copied, to start others from.
#[derive(Debug)]
pub(crate) struct SequencePrefix {
    ids: Vec<u32>,
    cache: KvPrefix,
}

impl LlavaModel {
    /// Reads `config.json` and the weights of a folder.
    ///
    /// # Errors
    /// When the configuration or a weight is broken or missing.
    pub(crate) fn open(folder: &Path) -> Result<Self, MllmError> {
        let config_json = read_required_json(folder, "config.json")?;
        let config = LlavaConfig::from_json(&folder.join("config.json"), &config_json)?;
        let mut weights = Weights::open(folder)?;
        let before = weights.elements();
        let encoder = ImageEncoder::take(&mut weights, &config)?;
        let decoder = LlamaDecoder::take(&mut weights, &config)?;
        Ok(Self {
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
            config,
            encoder,
            decoder,
        })
    }

    /// The configuration.
    pub(crate) fn config(&self) -> &LlavaConfig {
        &self.config
    }

    /// Number of weights that the model is made of.
    pub(crate) fn parameters(&self) -> u64 {
        self.parameters
    }

    /// BLAKE3 of the weight files.
    pub(crate) fn blake3(&self) -> &str {
        &self.blake3
    }

    /// Encodes pixel values (3, side, side) to image features (image tokens, decoder width).
    pub(crate) fn encode_image(&self, pixels: &Tensor) -> Result<Tensor, MllmError> {
        Ok(self.encoder.encode(pixels)?)
    }

    /// A sequence of no tokens.
    pub(crate) fn new_sequence(&self) -> Sequence {
        Sequence { ids: Vec::new(), cache: self.decoder.new_cache() }
    }

    /// Appends tokens to a sequence and gives the wanted logits (wanted positions, vocabulary). Image tokens take their
    /// rows of `features`, in the order in which they stand in the sequence. After an error the sequence is unchanged.
    ///
    /// # Errors
    /// When the sequence grows beyond the context, or an image token has no feature.
    pub(crate) fn append(
        &self,
        sequence: &mut Sequence,
        ids: &[u32],
        features: Option<&Tensor>,
        wanted: Logits,
    ) -> Result<Option<Tensor>, MllmError> {
        if ids.is_empty() {
            return Ok(None);
        }
        let input = self.input_rows(sequence, ids, features)?;
        let logits = self.decoder.forward(&input, &mut sequence.cache, wanted)?;
        sequence.ids.extend_from_slice(ids);
        Ok(logits)
    }

    /// The decoder's input for tokens that follow a sequence.
    fn input_rows(&self, sequence: &Sequence, ids: &[u32], features: Option<&Tensor>) -> Result<Tensor, MllmError> {
        let image_token = self.config.image_token;
        let is_image = |id: &u32| *id == image_token;
        let mut used = sequence.ids.iter().filter(|id| is_image(id)).count();
        let mut rows = Vec::new();
        for run in ids.chunk_by(|a, b| is_image(a) == is_image(b)) {
            if run.first().is_some_and(is_image) {
                let known = features.map_or(Ok(0), |features| features.dim(0))?;
                let Some(features) = features.filter(|_| used + run.len() <= known) else {
                    return Err(MllmError::ImagePlaceholder { expected: known, found: used + run.len() });
                };
                rows.push(features.narrow(0, used, run.len())?);
                used += run.len();
            } else {
                rows.push(self.decoder.embed(run)?);
            }
        }
        Ok(Tensor::cat(&rows, 0)?)
    }
}

impl Sequence {
    /// The tokens.
    pub(crate) fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Forgets the tokens from `len` on.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.ids.truncate(len);
        self.cache.truncate(len);
    }

    /// Copies the whole sequence.
    pub(crate) fn to_prefix(&self) -> Result<SequencePrefix, MllmError> {
        Ok(SequencePrefix { ids: self.ids.clone(), cache: self.cache.prefix(self.cache.len())? })
    }

    /// Replaces the sequence by a copy of a prefix.
    pub(crate) fn restore(&mut self, prefix: &SequencePrefix) -> Result<(), MllmError> {
        self.ids.clear();
        self.cache.restore(&prefix.cache)?;
        self.ids.extend_from_slice(&prefix.ids);
        Ok(())
    }
}
