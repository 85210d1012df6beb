//! Qwen2.5-VL (Bai et al., arXiv:2502.13923): a tower for images of any size, most of whose layers
//! attend within windows, and a Qwen 2 decoder; image tokens have positions on three axes.

mod config;
mod gguf;
mod vision;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family};
use super::qwen3_vl::{PatchModel, PatchProcessor, canonical_name};
use config::Qwen25VlConfig;
use vision::ImageEncoder;

const NAME: &str = "qwen2.5-vl";

/// Qwen2.5-VL.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen2_5_vl", "Qwen2_5_VLForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Qwen25VlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "Qwen2.5-VL and its tunes",
        gguf: &[("qwen2vl", Some("qwen2.5vl_merger"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_qwen2_5_vl",
        example: "qwen2.5-vl-3b",
    },
};

/// A Qwen2.5-VL.
pub(crate) type Qwen25Vl = PatchModel<ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Qwen25Vl, MllmError> {
    let config = Qwen25VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    take(weights, &config, processor)
}

fn take(
    weights: &mut Weights,
    config: &Qwen25VlConfig,
    processor: PatchProcessor,
) -> Result<Qwen25Vl, MllmError> {
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
    let config = Qwen25VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    Ok(format!("{config:?} {processor:?}"))
}
