//! LLaVA 1.6, LLaVA-NeXT (Liu et al., "LLaVA-NeXT: Improved reasoning, OCR, and world knowledge"):
//! a LLaVA that sees the image small and once more in tiles of a higher resolution.

mod config;
mod connector;
mod grid;
mod preprocess;

#[cfg(test)]
mod reference_tests;

pub(crate) use config::{LlavaNextConfig, PINPOINTS, pinpoints, tile_grids};
pub(crate) use connector::TilePacker;
pub(crate) use grid::{Resolution, TileGrids, Tiling};
pub(crate) use preprocess::AnyresImageProcessor;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::LanguageModel;
use super::family::{
    About, ChatFormat, Family, ImageFeatures, ImageLayout, ModelInfo, Tiles, VisionLanguageModel,
};
use super::llava::{LlavaCore, LlavaGguf, canonical_name};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use image::RgbImage;

const NAME: &str = "llava-next";

/// LLaVA 1.6.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["llava_next", "LlavaNextForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&LlavaGguf {
        next: true,
        model_type: "llava_next",
        image_processor: "LlavaNextImageProcessor",
        config: |files| {
            let LlavaNextConfig { llava, grids } = LlavaNextConfig::open(files)?;
            Ok((
                llava,
                Some(
                    grids
                        .resolutions()
                        .iter()
                        .map(|size| [size.height, size.width])
                        .collect(),
                ),
            ))
        },
    }),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(LlavaNextConfig::open(files)?.llava.text),
    open: |files, weights| Ok(Box::new(LlavaNext::open(files, weights)?)),
    about: About {
        models: "LLaVA 1.6",
        gguf: &[("llama", Some("mlp"))],
        tested: "transformers: tests/fixtures/tiny_llava_next",
        example: "llava-v1.6-vicuna-7b",
    },
};

/// A LLaVA-NeXT model.
#[derive(Debug)]
pub(crate) struct LlavaNext {
    core: LlavaCore,
    packer: TilePacker,
    grids: TileGrids,
    processor: AnyresImageProcessor,
    info: ModelInfo,
}

impl LlavaNext {
    fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Self, MllmError> {
        let config = LlavaNextConfig::open(files)?;
        let processor = AnyresImageProcessor::open(
            files,
            &config.grids,
            config.llava.vision.image_size as u32,
        )?;
        Self::take(weights, config, processor)
    }

    fn take(
        weights: &mut Weights,
        config: LlavaNextConfig,
        processor: AnyresImageProcessor,
    ) -> Result<Self, MllmError> {
        let before = weights.elements();
        let core = LlavaCore::take(weights, config.llava)?;
        let packer = TilePacker::take(weights, core.config.text.hidden)?;
        let max_image_tokens = config.grids.max_tokens();
        let info = ModelInfo {
            max_image_tokens,
            ..core.info(NAME, weights, before)
        };
        Ok(Self {
            core,
            packer,
            grids: config.grids,
            processor,
            info,
        })
    }
}

impl VisionLanguageModel for LlavaNext {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        if width == 0 || height == 0 {
            return Err(MllmError::Image {
                problem: "it has no pixels".into(),
            });
        }
        Ok(ImageLayout::whole(
            self.grids
                .tokens(&self.grids.tiling(Resolution { height, width })),
        ))
    }

    fn tower_pixels(&self, width: u32, height: u32) -> Result<usize, MllmError> {
        self.image_layout(width, height)?;
        let (down, across) = self.grids.tiling(Resolution { height, width }).tiles;
        let views = (down as usize).saturating_mul(across as usize);
        let side = self.core.config.vision.image_size;
        Ok(side
            .saturating_mul(side)
            .saturating_mul(views.saturating_add(1)))
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        let (width, height) = image.dimensions();
        let tiling = self.grids.tiling(Resolution { height, width });
        Ok(Tiles {
            pixels: self.processor.process(
                image,
                &tiling,
                self.core.config.vision.image_size as u32,
            )?,
            width,
            height,
        })
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let tiling = self.grids.tiling(Resolution {
            height: tiles.height,
            width: tiles.width,
        });
        ImageFeatures::whole(self.packer.pack(
            &self.core.encoder.encode(&tiles.pixels)?,
            &self.grids,
            &tiling,
        )?)
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
    let config = LlavaNextConfig::open(files)?;
    let side = config.llava.vision.image_size as u32;
    let processor = AnyresImageProcessor::open(files, &config.grids, side)?;
    Ok(format!("{config:?} {processor:?}"))
}
