//! `CogVLM`, first version (Wang et al., "CogVLM: Visual Expert for Pretrained Language Models", arXiv:2311.03079): an
//! EVA2-CLIP tower and a Llama decoder whose layers have matrices of their own for the image.

mod chat;
mod config;
mod connector;
mod language;
mod preprocess;
mod vision;

#[cfg(test)]
mod reference_tests;

use std::path::Path;

use candle_core::Tensor;
use image::RgbImage;
use serde_json::Value;

use chat::QuestionFormat;
use config::CogVlmConfig;
use connector::GluAdapter;
use language::{ExpertLayer, IMAGE_POSITIONS, positions, vision_rows};
use vision::EvaVisionTower;

use super::MllmError;
use super::checkpoint::{Weights, read_required_json};
use super::decoder::{Decoder, DecoderInput, KvCache, Logits};
use super::local::{Architecture, ChatFormat, ModelFacts, PlacedRows, VisionLanguageModel};
use super::text::ChatTokenizer;

/// A `CogVLM` model. It takes one image, and nothing but the beginning-of-sequence token stands before it.
#[derive(Debug)]
pub(crate) struct CogVlm {
    config: CogVlmConfig,
    tower: EvaVisionTower,
    adapter: GluAdapter,
    decoder: Decoder<ExpertLayer>,
    facts: ModelFacts,
}

impl CogVlm {
    /// Opens the configuration and the weights of a folder.
    ///
    /// # Errors
    /// When one of them is missing or broken.
    pub(crate) fn open(folder: &Path) -> Result<Self, MllmError> {
        let config_json = read_required_json(folder, "config.json")?;
        let config = CogVlmConfig::from_json(&folder.join("config.json"), &config_json)?;
        Self::take(&mut Weights::open(folder)?, config)
    }

    /// A model of this configuration with any weights; `path` is for messages.
    ///
    /// # Errors
    /// When the configuration is broken or a tensor is missing or misshapen.
    pub(crate) fn with_weights(path: &Path, config: &Value, weights: &mut Weights) -> Result<Self, MllmError> {
        Self::take(weights, CogVlmConfig::from_json(path, config)?)
    }

    /// Takes the weights of a configuration.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    fn take(weights: &mut Weights, config: CogVlmConfig) -> Result<Self, MllmError> {
        let tower = EvaVisionTower::take(weights, &config.vision)?;
        let adapter = GluAdapter::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config.text, "", config.tie_word_embeddings)?;
        let facts = ModelFacts {
            architecture: Architecture::CogVlm,
            // No token of the vocabulary stands for an image, so the first number behind it does.
            image_token: config.text.vocabulary as u32,
            image_size: config.vision.image_size,
            most_image_tokens: config.image_tokens(),
            vocabulary: config.text.vocabulary,
            positions: config.text.context,
            parameters: weights.taken() as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { config, tower, adapter, decoder, facts })
    }

    /// Encodes pixel values (3, side, side) to (image tokens, decoder width).
    fn encode_pixels(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        self.adapter.forward(&self.tower.forward(pixels)?)
    }
}

impl VisionLanguageModel for CogVlm {
    fn facts(&self) -> &ModelFacts {
        &self.facts
    }

    fn context(&self, image_tokens: usize) -> usize {
        self.facts.positions + image_tokens.saturating_sub(IMAGE_POSITIONS)
    }

    fn image_tokens(&self, _width: u32, _height: u32) -> Result<usize, MllmError> {
        Ok(self.facts.most_image_tokens)
    }

    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        Ok(self.encode_pixels(&preprocess::pixel_values(image, self.facts.image_size as u32)?)?)
    }

    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        self.decoder.embed(ids)
    }

    fn new_cache(&self) -> KvCache {
        self.decoder.new_cache(self.context(self.facts.most_image_tokens))
    }

    fn forward(&self, rows: &PlacedRows, cache: &mut KvCache, wanted: Logits) -> candle_core::Result<Option<Tensor>> {
        let tokens = rows.start..rows.start + rows.rows.dim(0)?;
        let positions = positions(tokens.clone(), &rows.image);
        if let Some(position) = positions.last().filter(|position| **position as usize >= self.facts.positions) {
            candle_core::bail!("position {position} lies outside the context of {}", self.facts.positions);
        }
        let vision = vision_rows(&tokens, &rows.image);
        self.decoder.forward(&DecoderInput { rows: rows.rows.clone(), positions, vision }, cache, wanted)
    }

    fn chat_format(&self, _folder: &Path, _tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        let format =
            QuestionFormat { bos: self.config.bos, image_token: self.facts.image_token, style: self.config.style };
        Ok(Box::new(format))
    }
}
