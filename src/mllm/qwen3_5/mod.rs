//! Qwen3.5 (Qwen team, 2026): the tower of Qwen3-VL without `DeepStack`, and a decoder most of whose
//! layers have a gated delta rule in the place of attention.

mod gguf;

#[cfg(test)]
mod gguf_tests;
#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{DecoderType, ModelFiles, Weights};
use super::family::{About, Family};
use super::qwen3_vl::{
    ImageEncoder, Kind, PatchModel, PatchProcessor, Qwen3VlConfig, canonical_name,
};
use super::text_only::qwen35_name;

const NAME: &str = "qwen3.5";

/// Qwen3.5 with vision.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["qwen3_5", "Qwen3_5ForConditionalGeneration"],
    canonical_name: |stored| qwen35_name(&canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Qwen3VlConfig::open_as(KIND, files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "Qwen3.5 with a dense decoder",
        gguf: &[("qwen35", Some("qwen3vl_merger"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_qwen3_5",
        example: "qwen3.5-0.8b",
    },
};

const KIND: Kind = Kind {
    decoder: DecoderType::Qwen35,
    image_token: 248_056,
    deepstack: false,
};

/// A Qwen3.5 with vision.
type Qwen35 = PatchModel<ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<Qwen35, MllmError> {
    let config = Qwen3VlConfig::open_as(KIND, files)?;
    let processor = processor(files, &config)?;
    take(weights, &config, processor)
}

fn processor(files: &ModelFiles, config: &Qwen3VlConfig) -> Result<PatchProcessor, MllmError> {
    let (patch, merge) = (config.vision.patch_size as u32, config.merge as u32);
    PatchProcessor::open(files, patch, merge)
}

fn take(
    weights: &mut Weights,
    config: &Qwen3VlConfig,
    processor: PatchProcessor,
) -> Result<Qwen35, MllmError> {
    let encoder = |weights: &mut Weights| ImageEncoder::take(weights, config);
    let (text, image) = (&config.text, config.image_token);
    PatchModel::take(weights, NAME, text, image, processor, encoder)
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = Qwen3VlConfig::open_as(KIND, files)?;
    let processor = processor(files, &config)?;
    Ok(format!("{config:?} {processor:?}"))
}
