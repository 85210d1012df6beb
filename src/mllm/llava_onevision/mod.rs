//! LLaVA-OneVision (Li et al., arXiv:2408.03326): a LLaVA-NeXT with a `SigLIP` tower and a Qwen 2
//! decoder, whose map of tiles is made smaller where it would become too many tokens.

mod config;
mod connector;
mod preprocess;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::LanguageModel;
use super::family::{
    About, ChatFormat, Family, ImageFeatures, ImageLayout, ImageSettings, ModelInfo, Tiles,
    VisionLanguageModel,
};
use super::llava::{LlavaCore, canonical_name};
use super::llava_next::{Resolution, Tiling};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use super::vision::check_not_empty;
use config::OnevisionConfig;
use connector::MapPacker;
use image::RgbImage;
use preprocess::OnevisionProcessor;

const NAME: &str = "llava-onevision";

/// LLaVA-OneVision.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["llava_onevision", "LlavaOnevisionForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Err("a map of tiles that is made smaller"),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(OnevisionConfig::open(files)?.llava.text),
    open: |files, weights| Ok(Box::new(LlavaOnevision::open(files, weights)?)),
    about: About {
        models: "LLaVA-OneVision",
        gguf: &[],
        tested: "transformers: tests/fixtures/tiny_llava_onevision",
        example: "llava-onevision-0.5b",
    },
};

/// A LLaVA-OneVision.
#[derive(Debug)]
pub(crate) struct LlavaOnevision {
    core: LlavaCore,
    packer: MapPacker,
    config: OnevisionConfig,
    processor: OnevisionProcessor,
    /// Whether an image is shown in one view, as one of several in a chat is.
    one_view: bool,
    info: ModelInfo,
}

impl LlavaOnevision {
    fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = OnevisionConfig::open(files)?;
        let side = config.llava.vision.image_size as u32;
        let processor = OnevisionProcessor::open(files, &config.grids, side)?;
        Self::take(weights, config, processor)
    }

    fn take(
        weights: &mut Weights,
        config: OnevisionConfig,
        processor: OnevisionProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let core = LlavaCore::take(weights, config.llava.clone())?;
        let packer = MapPacker::take(weights, core.config.text.hidden, config.max_tiles)?;
        let info = ModelInfo {
            max_image_tokens: packer.max_tokens(&config.grids),
            ..core.info(NAME, weights, before)
        };
        Ok(Self {
            core,
            packer,
            config,
            processor,
            one_view: false,
            info,
        })
    }

    /// Side of a tile, pixels.
    fn side(&self) -> u32 {
        self.config.llava.vision.image_size as u32
    }

    fn tiling(&self, width: u32, height: u32) -> Tiling {
        self.config.grids.tiling(Resolution { height, width })
    }
}

impl VisionLanguageModel for LlavaOnevision {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        match settings.tiles {
            None => {}
            Some(1) => {
                self.one_view = true;
                self.info.max_image_tokens = connector::view_tokens(&self.config.grids);
            }
            Some(tiles) => {
                let problem = format!(
                    "image.tiles = {tiles}: 1 shows an image in one view; without the setting it is cut as the model's processor does"
                );
                return Err(MllmError::Image { problem });
            }
        }
        settings.check_size(self.side() as usize)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image {
                problem: "it has no pixels".into(),
            });
        }
        let grids = &self.config.grids;
        Ok(ImageLayout::whole(if self.one_view {
            connector::view_tokens(grids)
        } else {
            self.packer.tokens(grids, &self.tiling(width, height))
        }))
    }

    fn layout_of_several(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.image_layout(width, height)?;
        Ok(ImageLayout::whole(connector::view_tokens(
            &self.config.grids,
        )))
    }

    fn tower_pixels(&self, width: u32, height: u32) -> Result<usize, MllmError> {
        self.image_layout(width, height)?;
        let tiles = if self.one_view {
            0
        } else {
            let (down, across) = self.tiling(width, height).tiles;
            (down as usize).saturating_mul(across as usize)
        };
        let side = self.side() as usize;
        Ok(side
            .saturating_mul(side)
            .saturating_mul(tiles.saturating_add(1)))
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        check_not_empty(image)?;
        let (width, height) = image.dimensions();
        if self.one_view {
            return self.preprocess_of_several(image);
        }
        let tiling = self.tiling(width, height);
        Ok(Tiles {
            pixels: self.processor.tiles.process(image, &tiling, self.side())?,
            width,
            height,
        })
    }

    fn preprocess_of_several(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        check_not_empty(image)?;
        let view = self.processor.one_view(image, self.side())?;
        Ok(Tiles::one_view(image, view))
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let features = self.core.encoder.encode(&tiles.pixels)?;
        // An image that is cut has a tile beside the whole view.
        ImageFeatures::whole(if tiles.pixels.len() == 1 {
            self.packer.pack_view(&features)?
        } else {
            let tiling = self.tiling(tiles.width, tiles.height);
            self.packer.pack(&features, &self.config.grids, &tiling)?
        })
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
    let config = OnevisionConfig::open(files)?;
    let side = config.llava.vision.image_size as u32;
    let processor = OnevisionProcessor::open(files, &config.grids, side)?;
    Ok(format!("{config:?} {processor:?}"))
}
