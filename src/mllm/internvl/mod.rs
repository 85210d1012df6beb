//! `InternVL` 2.5, 3 and 3.5 (Zhu et al., arXiv:2504.10479): tiles through `InternViT`, blocks of
//! patches merged by a two-layer projector, a Qwen decoder. Both layouts of the repositories are
//! read, that of the authors and that of transformers (`-hf`).

mod config;
mod gguf;
mod layout;
mod names;
mod tiles;
mod vision;

#[cfg(test)]
mod reference_tests;

use super::MllmError;
use super::checkpoint::{ModelFiles, Weights};
use super::family::{About, Family, ImageLayout};
use super::tiled::{TiledFamily, TiledModel};
use config::InternVlConfig;
use names::canonical_name;
use tiles::TileProcessor;
use vision::ImageEncoder;

const NAME: &str = "internvl";

/// `InternVL` 2.5, 3 and 3.5.
pub(crate) const FAMILY: Family = Family {
    name: NAME,
    config_names: &[
        "internvl",
        "InternVLForConditionalGeneration",
        "internvl_chat",
        "InternVLChatModel",
    ],
    canonical_name: |stored| Some(canonical_name(stored)),
    gguf: Ok(&gguf::LAYOUT),
    missing_tokenizer: "tokenizer.json (some of InternVL's repositories have none; that of the same model's -hf repository \
                        fits: copy it here, or name it under tokenizer in the model's description)",
    decoder_config: |files| Ok(InternVlConfig::open(files)?.text),
    open: |files, weights| Ok(Box::new(open(files, weights)?)),
    about: About {
        models: "InternVL 2.5, 3 and 3.5 up to 14B, with a Qwen or Llama decoder",
        gguf: &[
            ("qwen2", Some("internvl")),
            ("qwen3", Some("internvl")),
            ("llama", Some("internvl")),
        ],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_internvl3",
        example: "internvl3-1b",
    },
};

/// An `InternVL`.
pub(crate) type InternVl = TiledModel<TileProcessor, ImageEncoder>;

fn open(files: &ModelFiles, weights: &mut Weights) -> Result<InternVl, MllmError> {
    let config = InternVlConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    take(weights, &config, tiler)
}

fn take(
    weights: &mut Weights,
    config: &InternVlConfig,
    tiler: TileProcessor,
) -> Result<InternVl, MllmError> {
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

/// All tokens in one run, framed.
fn image_text(placeholder: &str, layout: ImageLayout) -> String {
    format!("<img>{}</img>", placeholder.repeat(layout.tokens))
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    let config = InternVlConfig::open(files)?;
    let tiler = TileProcessor::open(files, config.vision.image_size as u32)?;
    Ok(format!("{config:?} {tiler:?}"))
}
