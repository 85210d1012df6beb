//! Qwen3-VL (Bai et al., arXiv:2511.21631): a tower for images of any size, whose early layers add
//! to the first layers of a Qwen 3 decoder (`DeepStack`). Image tokens have positions on three
//! axes.

mod config;
mod gguf;
mod merger;
mod model;
mod names;
mod patches;
mod positions;
mod vision;

#[cfg(test)]
mod reference_tests;

pub(crate) use config::{Kind, Qwen3VlConfig, check_tower_rope, image_token, text_config};
pub(crate) use gguf::{IMAGE, PatchTower, QWEN_NAMES, QWEN2_EPSILON, limits, vision};
pub(crate) use merger::PatchMerger;
pub(crate) use model::{PatchEncoder, PatchModel};
pub(crate) use names::canonical_name;
pub(crate) use patches::{PatchProcessor, take_patch_embedding};
pub(crate) use vision::ImageEncoder;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family};

const NAME: &str = "qwen3-vl";

/// Qwen3-VL.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen3_vl", "Qwen3VLForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Qwen3VlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "Qwen3-VL with a dense decoder",
        gguf: &[("qwen3vl", Some("qwen3vl_merger"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_qwen3_vl",
        example: "qwen3-vl-2b",
    },
};

/// A Qwen3-VL.
pub(crate) type Qwen3Vl = PatchModel<ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Qwen3Vl, MllmError> {
    let config = Qwen3VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    take(weights, &config, processor)
}

fn take(
    weights: &mut Weights,
    config: &Qwen3VlConfig,
    processor: PatchProcessor,
) -> Result<Qwen3Vl, MllmError> {
    let encoder = |weights: &mut Weights| ImageEncoder::take(weights, config);
    PatchModel::take(
        weights,
        NAME,
        &config.text,
        config.image_token,
        processor,
        encoder,
    )
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = Qwen3VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    Ok(format!("{config:?} {processor:?}"))
}
