//! `InternVL` 2.5, 3 and 3.5 (Zhu et al., arXiv:2504.10479): tiles through `InternViT`, blocks of patches merged by a two-layer
//! projector, a Qwen decoder. Both layouts of the repositories are read, that of the authors and that of transformers (`-hf`).

mod config;
mod gguf;
mod names;
mod tiles;
mod vision;

#[cfg(test)]
mod reference_tests;

use candle_core::Tensor;
use image::RgbImage;

use config::InternVlConfig;
use gguf::InternVlGguf;
use names::canonical_name;
use tiles::TileProcessor;
use vision::ImageEncoder;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel, LlamaLayer};
use super::family::{
    ChatFormat, Family, ImageFeatures, ImageLayout, ImageSettings, ModelInfo, Tiles, VisionLanguageModel,
};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;

const NAME: &str = "internvl";

/// `InternVL` 2.5, 3 and 3.5.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["internvl", "InternVLForConditionalGeneration", "internvl_chat", "InternVLChatModel"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&InternVlGguf),
    missing_tokenizer: "tokenizer.json (some of InternVL's repositories have none; that of the same model's -hf repository \
                        fits: copy it here, or name it under tokenizer in the model's description)",
    decoder_config: |files| Ok(InternVlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(InternVl::open(files, weights)?)),
};

/// An `InternVL`.
#[derive(Debug)]
pub(crate) struct InternVl {
    config: InternVlConfig,
    processor: TileProcessor,
    encoder: ImageEncoder,
    decoder: Decoder<LlamaLayer>,
    info: ModelInfo,
}

impl InternVl {
    fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = InternVlConfig::open(files)?;
        let processor = TileProcessor::open(files, config.vision.image_size as u32)?;
        Self::take(weights, config, processor)
    }

    fn take(weights: &mut Weights, config: InternVlConfig, processor: TileProcessor) -> Result<Self, MllmError> {
        let before = weights.elements();
        let encoder = ImageEncoder::take(weights, &config)?;
        // Without an output layer in the files, the embedding is it, whatever the configuration says.
        let tied = config.text.tie_word_embeddings || weights.lacks("lm_head.weight");
        let decoder = Decoder::take(weights, &config.text, "language_model.", tied)?;
        let info = ModelInfo {
            architecture: NAME,
            image_token: config.image_token,
            image_first: false,
            image_size: config.vision.image_size,
            max_image_tokens: processor.max_views() * config.tile_tokens(),
            vocabulary: config.text.vocabulary,
            positions: config.text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        };
        Ok(Self { config, processor, encoder, decoder, info })
    }
}

/// All tokens in one run, framed.
fn image_text(placeholder: &str, layout: ImageLayout) -> String {
    format!("<img>{}</img>", placeholder.repeat(layout.tokens))
}

impl VisionLanguageModel for InternVl {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        if let Some(tiles) = settings.tiles {
            self.processor.set_tiles(tiles)?;
        }
        self.info.max_image_tokens = self.processor.max_views() * self.config.tile_tokens();
        settings.check_size(self.info.image_size)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        let grid = self.processor.grid(width, height)?;
        let tokens = grid.views() * self.config.tile_tokens();
        Ok(ImageLayout { tokens, rows: grid.rows as usize, columns: grid.columns as usize })
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        Ok(Tiles { pixels: self.processor.process(image)?, width: image.width(), height: image.height() })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let layout = self.image_layout(tiles.width, tiles.height).map_err(candle_core::Error::wrap)?;
        let rows = tiles.pixels.iter().map(|pixels| self.encoder.encode(pixels));
        let rows = Tensor::cat(&rows.collect::<candle_core::Result<Vec<_>>>()?, 0)?;
        Ok(ImageFeatures { rows, deep: Vec::new(), layout })
    }

    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        let image = ImageText::Written(image_text);
        Ok(Box::new(TemplateFormat::open(files, tokenizer, self.info.image_token, image)?))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
