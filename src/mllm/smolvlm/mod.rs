//! `SmolVLM` and `SmolVLM2` (Marafioti et al., arXiv:2504.05299), and Idefics3 (Laurençon et al., arXiv:2408.12637), which is
//! the same model for an image: tiles through a `SigLIP` tower, blocks of patches merged by one matrix, a Llama decoder.

mod chat;
mod config;
mod gguf;
mod tiles;

#[cfg(test)]
mod reference_tests;

use candle_core::Tensor;
use image::RgbImage;

use chat::image_text;
use config::SmolVlmConfig;
use gguf::SmolVlmGguf;
use tiles::TileProcessor;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel, LlamaLayer};
use super::family::{
    ChatFormat, Family, ImageFeatures, ImageLayout, ImageSettings, ModelInfo, Tiles, VisionLanguageModel,
};
use super::linear::Linear;
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use super::vision::{SiglipVisionTower, merge_blocks};

const NAME: &str = "smolvlm";

/// `SmolVLM`, `SmolVLM2` and Idefics3.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["smolvlm", "SmolVLMForConditionalGeneration", "idefics3", "Idefics3ForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&SmolVlmGguf),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(SmolVlmConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(SmolVlm::open(files, weights)?)),
};

fn canonical_name(stored: &str) -> String {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    let renamed = [
        ("vision_model.", "vision_tower."),
        ("connector.modality_projection.", "multi_modal_projector."),
        ("text_model.", "language_model."),
    ]
    .into_iter()
    .find_map(|(from, to)| name.strip_prefix(from).map(|rest| format!("{to}{rest}")));
    renamed.unwrap_or_else(|| name.to_string())
}

/// A `SmolVLM`.
#[derive(Debug)]
pub(crate) struct SmolVlm {
    config: SmolVlmConfig,
    processor: TileProcessor,
    tower: SiglipVisionTower,
    projection: Linear,
    decoder: Decoder<LlamaLayer>,
    info: ModelInfo,
}

impl SmolVlm {
    fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = SmolVlmConfig::open(files)?;
        let processor = TileProcessor::open(files, config.vision.image_size as u32)?;
        Self::take(weights, config, processor)
    }

    fn take(weights: &mut Weights, config: SmolVlmConfig, processor: TileProcessor) -> Result<Self, MllmError> {
        let before = weights.elements();
        let tower = SiglipVisionTower::take(weights, &config.vision)?;
        let merged = config.vision.hidden * config.scale * config.scale;
        let projection = Linear::take(weights, "multi_modal_projector.proj", merged, config.text.hidden, false)?;
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
        Ok(Self { config, processor, tower, projection, decoder, info })
    }

    /// Encodes the views of an image, pixel values (3, side, side) each, to (views · tokens of a tile, decoder width).
    fn encode_views(&self, views: &[Tensor]) -> candle_core::Result<Tensor> {
        let side = self.config.vision.image_size / self.config.vision.patch_size;
        let tokens = views.iter().map(|pixels| {
            let merged = merge_blocks(&self.tower.forward(pixels)?, [side, side], self.config.scale)?;
            self.projection.forward(&merged)
        });
        Tensor::cat(&tokens.collect::<candle_core::Result<Vec<_>>>()?, 0)
    }
}

impl VisionLanguageModel for SmolVlm {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        self.processor.set_tiles(settings.tiles)?;
        self.info.max_image_tokens = self.processor.max_views() * self.config.tile_tokens();
        settings.check_size(self.info.image_size)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        let tiling = self.processor.tiling(width, height)?;
        let tokens = tiling.views() * self.config.tile_tokens();
        Ok(ImageLayout { tokens, rows: tiling.rows as usize, columns: tiling.columns as usize })
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        Ok(Tiles { pixels: self.processor.process(image)?, width: image.width(), height: image.height() })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let layout = self.image_layout(tiles.width, tiles.height).map_err(candle_core::Error::wrap)?;
        Ok(ImageFeatures { rows: self.encode_views(&tiles.pixels)?, deep: Vec::new(), layout })
    }

    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError> {
        let image = ImageText::Written(image_text);
        Ok(Box::new(TemplateFormat::open(files, tokenizer, self.info.image_token, image)?))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}
