//! A language model without a vision tower.

use crate::MllmError;
use crate::checkpoint::{LlamaConfig, ModelFiles, Weights};
use crate::decoder::{Decoder, DecoderLayer, LanguageModel};
use crate::family::{
    Chat, ChatFormat, ImageFeatures, ImageLayout, ModelInfo, Tiles, VisionLanguageModel, no_picture,
};
use crate::text::{ChatTemplate, ChatTokenizer};
use image::RgbImage;
use std::fmt::Debug;

/// A decoder that reads text alone.
#[derive(Debug)]
pub(super) struct TextModel<L> {
    decoder: Decoder<L>,
    info: ModelInfo,
}

impl<L: DecoderLayer> TextModel<L> {
    /// Takes the weights of a model of the family `name`.
    pub(super) fn take(
        weights: &mut Weights,
        name: &'static str,
        config: &LlamaConfig,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let decoder = Decoder::take(weights, config, "language_model.")?;
        let info = ModelInfo::new(name, config, None, weights, before);
        Ok(Self { decoder, info })
    }
}

impl<L: DecoderLayer + Debug + Send + Sync> VisionLanguageModel for TextModel<L> {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn image_layout(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Err(no_picture())
    }

    fn preprocess(&self, _image: &RgbImage) -> Result<Tiles, MllmError> {
        Err(no_picture())
    }

    fn encode(&self, _tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        Err(candle_core::Error::wrap(no_picture()))
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        let template = ChatTemplate::open(files, tokenizer.special(), None)?;
        Ok(Box::new(TextFormat(template)))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}

/// Chats of texts, by the model's chat template.
#[derive(Debug)]
struct TextFormat(ChatTemplate);

impl ChatFormat for TextFormat {
    fn let_think(&mut self) -> Result<(), MllmError> {
        self.0.let_think()
    }

    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        if !chat.images.is_empty() {
            return Err(no_picture());
        }
        let rendered = self.0.render(chat.system, &[], chat.turns, chat.prompt)?;
        tokenizer.encode_chat(&rendered)
    }
}
