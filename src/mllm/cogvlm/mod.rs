//! `CogVLM`, first version (Wang et al., "CogVLM: Visual Expert for Pretrained Language Models",
//! arXiv:2311.03079): an EVA2-CLIP tower and a Llama decoder whose layers have matrices of their
//! own for the image.

mod chat;
mod config;
mod connector;
mod language;
mod preprocess;
mod vision;

#[cfg(test)]
mod reference_tests;

pub(crate) use config::CogVlmConfig;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel};
use super::family::{
    About, ChatFormat, Family, ImageFeatures, ImageInfo, ImageLayout, ModelInfo, PlacedImage,
    Positions, Tiles, VisionLanguageModel, one_picture,
};
use super::text::ChatTokenizer;
use chat::QuestionFormat;
use connector::GluAdapter;
use image::RgbImage;
use language::{ExpertLayer, IMAGE_POSITIONS, positions, vision_rows};
use std::ops::Range;
use vision::EvaVisionTower;

const NAME: &str = "cogvlm";

/// `CogVLM`, first version.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["cogvlm", "CogVLMForCausalLM"],
    canonical_name: |stored| Some(stored.strip_prefix("model.").unwrap_or(stored).to_string()),
    gguf: Err("visual experts"),
    missing_tokenizer: "tokenizer.json (CogVLM's repositories have none; that of a LLaMA fits: copy it here, or name it \
                        under tokenizer in the model's description)",
    decoder_config: |files| Ok(CogVlmConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(CogVlm::take(weights, CogVlmConfig::open(files)?)?)),
    about: About {
        models: "CogVLM, first version",
        gguf: &[],
        tested: "its own code: tests/fixtures/tiny_cogvlm",
        example: "cogvlm-chat-17b",
    },
};

/// A `CogVLM` model. It takes one image, and nothing but the beginning-of-sequence token stands
/// before it.
#[derive(Debug)]
pub(crate) struct CogVlm {
    config: CogVlmConfig,
    tower: EvaVisionTower,
    adapter: GluAdapter,
    decoder: Decoder<ExpertLayer>,
    info: ModelInfo,
}

impl CogVlm {
    fn take(weights: &mut Weights, config: CogVlmConfig) -> Result<Self, MllmError> {
        let before = weights.elements();
        let tower = EvaVisionTower::take(weights, &config.vision)?;
        let adapter = GluAdapter::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config.text, "")?;
        let image = ImageInfo {
            // No token of the vocabulary stands for an image, so the first number behind it does.
            token: config.text.vocabulary as u32,
            side: config.vision.image_size,
            max_tokens: config.image_tokens(),
        };
        let info = ModelInfo {
            image_first: true,
            ..ModelInfo::new(NAME, &config.text, Some(image), weights, before)
        };
        Ok(Self {
            config,
            tower,
            adapter,
            decoder,
            info,
        })
    }
}

impl VisionLanguageModel for CogVlm {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn context(&self, image_tokens: usize) -> usize {
        self.info.positions + image_tokens.saturating_sub(IMAGE_POSITIONS)
    }

    fn image_layout(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Ok(ImageLayout::whole(self.info.max_image_tokens))
    }

    fn layout_of_several(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Err(one_picture())
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        let pixels = vec![preprocess::pixel_values(
            image,
            self.config.vision.image_size as u32,
        )?];
        Ok(Tiles {
            pixels,
            width: image.width(),
            height: image.height(),
        })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let Some(pixels) = tiles.pixels.first() else {
            candle_core::bail!("there is no tile")
        };
        ImageFeatures::whole(self.adapter.forward(&self.tower.forward(pixels)?)?)
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        let image = images.first().map_or(0..0, PlacedImage::tokens);
        let rows = vision_rows(&tokens, &image);
        let vision = if rows.is_empty() { vec![] } else { vec![rows] };
        Positions {
            vision,
            ..Positions::plain(positions(tokens, &image))
        }
    }

    fn chat_format(
        &self,
        _files: &ModelFiles,
        _tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        let format = QuestionFormat {
            bos: self.config.bos,
            image_token: self.info.image_token,
            style: self.config.style,
        };
        Ok(Box::new(format))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.decoder
    }
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    Ok(format!("{:?}", CogVlmConfig::open(files)?))
}
