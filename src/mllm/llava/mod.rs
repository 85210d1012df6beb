//! LLaVA 1.5 (Liu et al., "Improved Baselines with Visual Instruction Tuning"): the patches of one
//! image through a CLIP tower and a two-layer projector into a Llama decoder.

mod config;
mod connector;
mod gguf;
mod vision;

#[cfg(test)]
mod candle_tests;
#[cfg(test)]
mod reference_tests;

pub(crate) use config::{FeatureSelect, LlavaConfig};
pub(crate) use gguf::LlavaGguf;
pub(crate) use vision::ImageEncoder;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::{Decoder, LanguageModel, LlamaLayer};
use super::family::{
    About, ChatFormat, Family, ImageFeatures, ImageInfo, ImageLayout, ModelInfo, Tiles,
    VisionLanguageModel,
};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use super::vision::ClipImageProcessor;
use image::RgbImage;

const NAME: &str = "llava";

/// LLaVA 1.5.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["llava", "LlavaForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&LlavaGguf {
        next: false,
        model_type: "llava",
        image_processor: "CLIPImageProcessor",
        config: |files| Ok((LlavaConfig::open(files)?, None)),
    }),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(LlavaConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(Llava::open(files, weights)?)),
    about: About {
        models: "LLaVA 1.5, also with a SigLIP tower or a Qwen 2 decoder",
        gguf: &[("llama", Some("mlp"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_llava",
        example: "llava-1.5-7b",
    },
};

/// The names of all layouts that transformers has written, as those of its version 5 without the
/// `model.` prefix.
pub(crate) fn canonical_name(stored: &str) -> String {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    let renamed = [
        ("vision_tower.vision_model.", "vision_tower."),
        ("language_model.model.", "language_model."),
        ("language_model.lm_head.", "lm_head."),
    ]
    .into_iter()
    .find_map(|(from, to)| name.strip_prefix(from).map(|rest| format!("{to}{rest}")));
    renamed.unwrap_or_else(|| name.to_string())
}

/// A LLaVA model.
#[derive(Debug)]
pub(crate) struct Llava {
    core: LlavaCore,
    processor: ClipImageProcessor,
    info: ModelInfo,
}

/// Tower, projector and decoder, as LLaVA and LLaVA-NeXT have them.
#[derive(Debug)]
pub(crate) struct LlavaCore {
    pub config: LlavaConfig,
    pub encoder: ImageEncoder,
    pub decoder: Decoder<LlamaLayer>,
}

impl LlavaCore {
    pub(crate) fn take(weights: &mut Weights, config: LlavaConfig) -> Result<Self, MllmError> {
        let encoder = ImageEncoder::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config.text, "language_model.")?;
        Ok(Self {
            config,
            encoder,
            decoder,
        })
    }

    /// Sizes and names of a model of the family `architecture`; `before` is the number of weights
    /// before it was taken.
    pub(crate) fn info(
        &self,
        architecture: &'static str,
        weights: &Weights,
        before: usize,
    ) -> ModelInfo {
        let config = &self.config;
        let image = ImageInfo {
            token: config.image_token,
            side: config.vision.image_size,
            max_tokens: config.image_tokens(),
        };
        ModelInfo::new(architecture, &config.text, Some(image), weights, before)
    }
}

impl Llava {
    pub(crate) fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = LlavaConfig::open(files)?;
        let processor = ClipImageProcessor::open(files)?;
        processor.check_side(config.vision.image_size)?;
        Self::take(weights, config, processor)
    }

    pub(crate) fn take(
        weights: &mut Weights,
        config: LlavaConfig,
        processor: ClipImageProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let core = LlavaCore::take(weights, config)?;
        let info = core.info(NAME, weights, before);
        Ok(Self {
            core,
            processor,
            info,
        })
    }
}

impl VisionLanguageModel for Llava {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn image_layout(&self, _width: u32, _height: u32) -> Result<ImageLayout, MllmError> {
        Ok(ImageLayout::whole(self.info.max_image_tokens))
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        let side = self.core.config.vision.image_size;
        let pixels = vec![self.processor.process(image, side)?];
        Ok(Tiles {
            pixels,
            width: image.width(),
            height: image.height(),
        })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        ImageFeatures::whole(self.core.encoder.encode(&tiles.pixels)?)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        Ok(Box::new(TemplateFormat::open(
            files,
            tokenizer,
            self.info.image_token,
            ImageText::Repeated,
        )?))
    }

    fn decoder(&self) -> &dyn LanguageModel {
        &self.core.decoder
    }
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = LlavaConfig::open(files)?;
    let processor = ClipImageProcessor::open(files)?;
    processor.check_side(config.vision.image_size)?;
    Ok(format!("{config:?} {processor:?}"))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        for (name, canonical) in [
            (
                "vision_tower.vision_model.encoder.layers.0.mlp.fc1.bias",
                "vision_tower.encoder.layers.0.mlp.fc1.bias",
            ),
            (
                "vision_tower.embeddings.class_embedding",
                "vision_tower.embeddings.class_embedding",
            ),
            (
                "model.vision_tower.vision_model.pre_layrnorm.bias",
                "vision_tower.pre_layrnorm.bias",
            ),
            (
                "model.vision_tower.pre_layrnorm.bias",
                "vision_tower.pre_layrnorm.bias",
            ),
            (
                "language_model.model.norm.weight",
                "language_model.norm.weight",
            ),
            (
                "model.language_model.norm.weight",
                "language_model.norm.weight",
            ),
            ("language_model.lm_head.weight", "lm_head.weight"),
            ("lm_head.weight", "lm_head.weight"),
            (
                "model.multi_modal_projector.linear_1.bias",
                "multi_modal_projector.linear_1.bias",
            ),
            ("model.image_newline", "image_newline"),
        ] {
            assert_eq!(canonical_name(name), canonical);
        }
    }
}
