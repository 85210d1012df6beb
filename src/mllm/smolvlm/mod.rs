//! `SmolVLM` and `SmolVLM2` (Marafioti et al., arXiv:2504.05299), and Idefics3 (Laurençon et al.,
//! arXiv:2408.12637), which is the same model for an image: tiles through a `SigLIP` tower, blocks
//! of patches merged by one matrix, a Llama decoder.

mod chat;
mod config;
mod gguf;
mod tiles;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family};
use super::tiled::{TileEncoder, TiledFamily, TiledModel};
use super::vision::{SiglipVisionTower, merge_blocks};
use candle_core::Tensor;
use chat::image_text;
use config::SmolVlmConfig;
use planagent_kernels::Linear;
use tiles::TileProcessor;

const NAME: &str = "smolvlm";

/// `SmolVLM`, `SmolVLM2` and Idefics3.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &[
        "smolvlm",
        "SmolVLMForConditionalGeneration",
        "idefics3",
        "Idefics3ForConditionalGeneration",
    ],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(SmolVlmConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "SmolVLM, SmolVLM2, Idefics3",
        gguf: &[("llama", Some("idefics3"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_smolvlm",
        example: "smolvlm2-500m",
    },
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
pub(crate) type SmolVlm = TiledModel<TileProcessor, ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<SmolVlm, MllmError> {
    let config = SmolVlmConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    take(weights, &config, tiler)
}

fn take(
    weights: &mut Weights,
    config: &SmolVlmConfig,
    tiler: TileProcessor,
) -> Result<SmolVlm, MllmError> {
    let family = TiledFamily {
        name: NAME,
        text: &config.text,
        image_token: config.image_token,
        side: config.vision.image_size,
        tile_tokens: config.tile_tokens(),
        image_text,
    };
    TiledModel::take(weights, family, tiler, |weights| {
        ImageEncoder::take(weights, config)
    })
}

/// `SigLIP` tower and projector.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    tower: SiglipVisionTower,
    projection: Linear,
    /// Patches along a side.
    side: usize,
    scale: usize,
}

impl ImageEncoder {
    fn take(weights: &mut Weights, config: &SmolVlmConfig) -> Result<Self, MllmError> {
        let SmolVlmConfig {
            vision,
            text,
            scale,
            ..
        } = config;
        let tower = SiglipVisionTower::take_whole(weights, vision)?;
        let merged = vision.hidden * scale * scale;
        let projection =
            weights.take_linear("multi_modal_projector.proj", merged, text.hidden, false)?;
        Ok(Self {
            tower,
            projection,
            side: vision.image_size / vision.patch_size,
            scale: *scale,
        })
    }
}

impl TileEncoder for ImageEncoder {
    fn encode(&self, pixels: &Tensor) -> candle_core::Result<Tensor> {
        self.projection.forward(&merge_blocks(
            &self.tower.forward(pixels)?,
            [self.side, self.side],
            self.scale,
        )?)
    }
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = SmolVlmConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    Ok(format!("{config:?} {tiler:?}"))
}
