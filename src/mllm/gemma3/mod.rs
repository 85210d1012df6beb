//! Gemma 3 with vision (Gemma Team, arXiv:2503.19786): a `SigLIP` tower for one size, whose patches
//! are averaged in blocks, and a Gemma 3 decoder. The tokens of an image see one another.

mod chat;
mod config;
mod gguf;
mod model;
mod vision;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ConfigObject, ModelFiles};
use super::family::{About, Family};
use super::llava::canonical_name;
use super::vision::{ClipImageProcessor, read_processor};
pub(crate) use chat::image_text;
use config::Gemma3Config;
use model::Gemma3;
use serde_json::json;

const NAME: &str = "gemma3";

/// Gemma 3 with vision.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &["gemma3", "Gemma3ForConditionalGeneration"],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::Gemma3Gguf),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| Ok(Gemma3Config::open(files)?.text),
    open: |files, weights| {
        let config = Gemma3Config::open(files)?;
        let processor = processor(files)?;
        processor.check_side(config.vision.image_size)?;
        Ok(Box::new(Gemma3::take(weights, &config, processor)?))
    },
    about: About {
        models: "Gemma 3 4B, 12B and 27B with vision",
        gguf: &[("gemma3", Some("gemma3"))],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_gemma3",
        example: "gemma-3-4b",
    },
};

/// `Gemma3ImageProcessor`, or one that a file names.
fn processor(files: &ModelFiles) -> Result<ClipImageProcessor, MllmError> {
    read_processor(files, |path, object: &ConfigObject<'_>| {
        let object = object
            .clone()
            .with_defaults(json!({"image_processor_type": "Gemma3ImageProcessor"}));
        ClipImageProcessor::read(path, &object)
    })
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = Gemma3Config::open(files)?;
    let processor = processor(files)?;
    processor.check_side(config.vision.image_size)?;
    Ok(format!("{config:?} {processor:?}"))
}
