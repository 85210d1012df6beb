//! Qwen2-VL (Wang et al., arXiv:2409.12191): a tower for images of any size, all of whose layers
//! attend to the whole image, and a Qwen 2 decoder; image tokens have positions on three axes.

mod config;
mod gguf;
mod vision;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family};
use super::qwen3_vl::{PatchModel, PatchProcessor, canonical_name};
use config::Qwen2VlConfig;
use vision::ImageEncoder;

const NAME: &str = "qwen2-vl";

/// Qwen2-VL.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen2_vl", "Qwen2VLForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Qwen2VlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "Qwen2-VL and its tunes",
        gguf: &[("qwen2vl", Some("qwen2vl_merger"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_qwen2_vl",
        example: "qwen2-vl-2b",
    },
};

/// A Qwen2-VL.
pub(crate) type Qwen2Vl = PatchModel<ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Qwen2Vl, MllmError> {
    let config = Qwen2VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    take(weights, &config, processor)
}

fn take(
    weights: &mut Weights,
    config: &Qwen2VlConfig,
    processor: PatchProcessor,
) -> Result<Qwen2Vl, MllmError> {
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
    let config = Qwen2VlConfig::open(files)?;
    let processor =
        PatchProcessor::open(files, config.vision.patch_size as u32, config.merge as u32)?;
    Ok(format!("{config:?} {processor:?}"))
}
