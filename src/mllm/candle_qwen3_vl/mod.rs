//! candle-transformers' Qwen3-VL, unchanged, behind the contract of a family.
//!
//! It is here for comparison, and as a pattern for models of that crate that this program has no
//! code for. The family has about 400 lines. It is slow, holds f32 weights alone, and its answers
//! are not those of the model (docs/models.md has the differences). A description names it:
//! `architecture = "candle-qwen3-vl"`.

mod decoder;
mod weights;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::decoder::LanguageModel;
use super::family::{
    ChatFormat, Family, ImageFeatures, ImageInfo, ImageLayout, ImageSettings, ModelInfo,
    OpenedModel, Tiles, VisionLanguageModel,
};
use super::qwen3_vl::{PatchProcessor, Qwen3VlConfig, canonical_name};
use super::template_format::{ImageText, TemplateFormat};
use super::text::ChatTokenizer;
use candle_core::Tensor;
use decoder::CandleDecoder;
use image::RgbImage;

const NAME: &str = "candle-qwen3-vl";

/// Qwen3-VL as candle-transformers computes it.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen3_vl", "Qwen3VLForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Err("candle's Qwen3-VL, which reads safetensors alone"),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(config(files)?.text),
    open,
};

/// Longest chat, tokens: candle reserves keys and values for all positions at once.
const MAX_CONTEXT: usize = 4096;
/// Side of the image that is drawn for the model, pixels.
const DRAWN_SIDE: usize = 448;

/// A Qwen3-VL of candle-transformers.
#[derive(Debug)]
struct CandleQwen3Vl {
    processor: PatchProcessor,
    decoder: CandleDecoder,
    patches: Patches,
    info: ModelInfo,
}

/// How candle's model takes the pixels of a token.
#[derive(Debug, Clone, Copy)]
struct Patches {
    /// Side of a patch, pixels.
    side: usize,
    /// Side of the block of patches that becomes a token.
    merge: usize,
    /// Frames of a patch.
    frames: usize,
}

fn config(files: &ModelFiles) -> Result<Qwen3VlConfig, MllmError> {
    let mut config = Qwen3VlConfig::open(files)?;
    config.text.context = config.text.context.min(MAX_CONTEXT);
    Ok(config)
}

fn open(files: &ModelFiles, weights: &mut Weights) -> OpenedModel {
    let config = config(files)?;
    let patches = Patches {
        side: config.vision.patch_size,
        merge: config.merge,
        frames: config.frames,
    };
    let processor = PatchProcessor::open(files, patches.side as u32, patches.merge as u32)?;
    let before = weights.elements();
    let decoder = CandleDecoder::take(weights, &config, files)?;
    let max_tokens = processor.max_tokens().min(MAX_CONTEXT);
    let image = ImageInfo {
        token: config.image_token,
        side: DRAWN_SIDE,
        max_tokens,
    };
    let info = ModelInfo::new(NAME, &config.text, image, weights, before);
    Ok(Box::new(CandleQwen3Vl {
        processor,
        decoder,
        patches,
        info,
    }))
}

impl Patches {
    /// The patches of whole tokens, (tokens, numbers of a token), from pixel values (3, height,
    /// width).
    fn cut(self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        let Self {
            side,
            merge,
            frames,
        } = self;
        let (channels, height, width) = pixels.dims3()?;
        let [rows, columns] = [height, width].map(|length| length / (side * merge));
        // Blocks of patches in raster order, each patch as channel, frame, row and column.
        let split = pixels.reshape(vec![channels, rows, merge, side, columns, merge, side])?;
        let blocks = split.permute(vec![1, 4, 2, 5, 0, 3, 6])?.contiguous()?;
        let still = blocks.reshape((rows * columns * merge * merge, channels, 1, side * side))?;
        let moving = still.repeat((1, 1, frames, 1))?;
        moving.reshape((
            rows * columns,
            merge * merge * channels * frames * side * side,
        ))
    }
}

impl VisionLanguageModel for CandleQwen3Vl {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        self.processor.set_images(settings, &mut self.info)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.processor.layout(width, height)
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        Ok(Tiles {
            pixels: vec![self.processor.process(image)?],
            width: image.width(),
            height: image.height(),
        })
    }

    /// The tower is a part of candle's decoder. So the rows are the patches, which the decoder
    /// encodes.
    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        let Some(pixels) = tiles.pixels.first() else {
            candle_core::bail!("there is no image")
        };
        let (_, height, width) = pixels.dims3()?;
        let [rows, columns] =
            [height, width].map(|length| length / (self.patches.side * self.patches.merge));
        let layout = ImageLayout {
            tokens: rows * columns,
            rows,
            columns,
        };
        let rows = self
            .decoder
            .image_rows(&self.patches.cut(pixels)?, layout)?;
        Ok(ImageFeatures {
            rows,
            deep: Vec::new(),
            layout,
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
        &self.decoder
    }
}
