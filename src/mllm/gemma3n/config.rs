//! `config.json` of a `Gemma3nForConditionalGeneration` checkpoint.

use super::blocks::{self, Block, divisible};
use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, Neutral};
use serde_json::Value;
use std::path::Path;

/// A Gemma 3n: its tower, if it has one, and its decoder.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gemma3nConfig {
    pub seen: Option<SeenConfig>,
    pub text: LlamaConfig,
}

/// What of a Gemma 3n with a tower is no decoder.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SeenConfig {
    pub tower: TowerConfig,
    /// Tokens of pictures.
    pub picture: TableConfig,
    /// Tokens of sounds, which follow those of pictures.
    pub sound: TableConfig,
    /// Token id that stands for a token of the image in the prompt.
    pub image_token: u32,
}

/// The vision tower, a `MobileNetV5Encoder` of timm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TowerConfig {
    /// Channels behind the first convolution.
    pub stem: usize,
    /// Blocks by stage; each stage halves the image.
    pub stages: Vec<Vec<Block>>,
    /// Tokens along a side of the image.
    pub grid: usize,
    /// Channels of a token.
    pub width: usize,
}

/// A table for the tokens of pictures, or of sounds (`Gemma3nMultimodalEmbedder`).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TableConfig {
    /// The first of its tokens.
    pub first: u32,
    pub rows: usize,
    /// Numbers of a row, and of an output of the tower.
    pub width: usize,
    pub eps: f64,
}

/// The only architecture of timm that is supported.
const ARCHITECTURE: &str = "mobilenetv5_300m_enc";
/// Channels of its first convolution, its tokens along a side, and its channels of a token.
const STEM: usize = 64;
const GRID: usize = 16;
const WIDTH: usize = 2048;
/// Most channels of the first convolution, of a token and of a row of a table.
const MAX_WIDTH: usize = 1 << 16;
/// Most tokens along a side.
const MAX_GRID: usize = 1 << 7;
/// Most rows of a table.
const MAX_ROWS: usize = 1 << 16;
/// Largest id of a token. A larger one means a broken configuration.
const MAX_ID: u32 = 1 << 24;

impl Gemma3nConfig {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        let mut text =
            LlamaConfig::read_as(root.child_or_empty("text_config")?, DecoderType::Gemma3n)?;
        text.tie_word_embeddings = root.value("tie_word_embeddings")?.unwrap_or(true);
        let vision = root.child("vision_config")?;
        let seen = vision.map(|vision| SeenConfig::read(&root, &vision));
        Ok(Self {
            seen: seen.transpose()?,
            text,
        })
    }
}

impl SeenConfig {
    fn read(root: &ConfigObject<'_>, vision: &ConfigObject<'_>) -> Result<Self, MllmError> {
        const TOKENS: &str = "vision_soft_tokens_per_image";
        const ID: &str = "image_token_id";
        // The tower first, which says how many tokens there must be.
        let tower = TowerConfig::read(vision)?;
        let tokens = root.value(TOKENS)?.unwrap_or(GRID * GRID);
        if tokens != tower.tokens() {
            let problem = format!(
                "{tokens}, where the tower gives {} (msfa_output_resolution by as many)",
                tower.tokens()
            );
            return Err(root.error(TOKENS, problem));
        }
        let image_token = root.first_id(ID)?.unwrap_or(262_145);
        if image_token > MAX_ID {
            let problem = format!("{image_token} is no token of any vocabulary");
            return Err(root.error(ID, problem));
        }
        let audio = root.child_or_empty("audio_config")?;
        let picture = TableConfig::read(vision, 262_144, WIDTH)?;
        let sound = TableConfig::read(&audio, 262_272, 1536)?;
        if sound.first < picture.first {
            let problem = format!(
                "{}, before the first token of pictures, {}",
                sound.first, picture.first
            );
            return Err(audio.error("vocab_offset", problem));
        }
        Ok(Self {
            tower,
            picture,
            sound,
            image_token,
        })
    }
}

impl TowerConfig {
    fn read(vision: &ConfigObject<'_>) -> Result<Self, MllmError> {
        const BLOCKS: &str = "block_args";
        const STEM_KEY: &str = "stem_size";
        const GRID_KEY: &str = "msfa_output_resolution";
        vision.only_neutral(&[("architecture", Neutral::Text(&[ARCHITECTURE]))])?;
        let arguments = vision.child_or_empty("model_args")?;
        arguments.only_keys(&[BLOCKS, STEM_KEY, GRID_KEY])?;
        let stem = divisible(count(&arguments, STEM_KEY, STEM, MAX_WIDTH)? as f64);
        let stages = blocks::read(&arguments, BLOCKS, stem)?;
        Ok(Self {
            stem,
            stages: stages.unwrap_or_else(|| blocks::published(stem)),
            grid: count(&arguments, GRID_KEY, GRID, MAX_GRID)?,
            width: count(vision, "hidden_size", WIDTH, MAX_WIDTH)?,
        })
    }

    /// Tokens of an image.
    pub(super) fn tokens(&self) -> usize {
        self.grid * self.grid
    }

    /// Checks the side of images, pixels: each stage halves it, and the last but one is averaged to
    /// tokens.
    pub(super) fn check_side(&self, side: usize) -> Result<(), String> {
        let halvings = self.stages.len() as u32 + 1;
        let [last, before] = [0, 1].map(|back| 1_usize << (halvings - back));
        if side > 0 && side.is_multiple_of(last) && (side / before).is_multiple_of(self.grid) {
            return Ok(());
        }
        Err(format!(
            "{side} pixels; the vision tower takes a multiple of {last} and of {} pixels",
            before * self.grid
        ))
    }
}

impl TableConfig {
    /// Reads a table with the first token and the width of a class.
    fn read(object: &ConfigObject<'_>, first: u32, width: usize) -> Result<Self, MllmError> {
        const FIRST: &str = "vocab_offset";
        let first = object.value(FIRST)?.unwrap_or(first);
        if first > MAX_ID {
            let problem = format!("{first} is no token of any vocabulary");
            return Err(object.error(FIRST, problem));
        }
        Ok(Self {
            first,
            rows: count(object, "vocab_size", 128, MAX_ROWS)?,
            width: count(object, "hidden_size", width, MAX_WIDTH)?,
            eps: object.positive("rms_norm_eps")?.unwrap_or(1e-6),
        })
    }
}

/// A whole number from 1 to `most`.
fn count(
    object: &ConfigObject<'_>,
    key: &str,
    default: usize,
    most: usize,
) -> Result<usize, MllmError> {
    let count = object.value(key)?.unwrap_or(default);
    if (1..=most).contains(&count) {
        return Ok(count);
    }
    let problem = format!("expected a whole number from 1 to {most}, found {count}");
    Err(object.error(key, problem))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn parse(value: &Value) -> Result<Gemma3nConfig, MllmError> {
        Gemma3nConfig::from_json(Path::new("config.json"), value)
    }

    /// The defaults of the classes, which the published configurations write out.
    #[test]
    fn the_published_towers_are_the_defaults() {
        let config = parse(&json!({"vision_config": {"architecture": "mobilenetv5_300m_enc"}}));
        let config = config.unwrap();
        let seen = config.seen.unwrap();
        assert_eq!((seen.tower.tokens(), seen.tower.width), (256, 2048));
        assert_eq!((seen.picture.first, seen.sound.first), (262_144, 262_272));
        assert_eq!(seen.image_token, 262_145);
        assert_eq!(config.text.vocabulary, 262_400);
        seen.tower.check_side(768).unwrap();
        for side in [0, 16, 224, 512, 800] {
            assert_eq!(seen.tower.check_side(side).is_ok(), side == 512, "{side}");
        }
        assert!(
            parse(&json!({"vision_config": null}))
                .unwrap()
                .seen
                .is_none()
        );
    }

    #[test]
    fn other_towers_are_refused_by_their_key() {
        let vision = |vision: Value| json!({ "vision_config": vision });
        let arguments = |arguments: Value| vision(json!({ "model_args": arguments }));
        for (config, key) in [
            (vision(json!({"architecture": "resnet50"})), "architecture"),
            (vision(json!({"hidden_size": 0})), "hidden_size"),
            (vision(json!({"vocab_offset": 1_u64 << 31})), "vocab_offset"),
            (vision(json!({"vocab_offset": 300_000})), "vocab_offset"),
            (vision(json!({"vocab_size": 0})), "vocab_size"),
            (
                arguments(json!({"channel_multiplier": 0.5})),
                "model_args.channel_multiplier",
            ),
            (arguments(json!({"stem_size": 0})), "model_args.stem_size"),
            (
                arguments(json!({"msfa_output_resolution": 8})),
                "vision_soft_tokens_per_image",
            ),
            (
                arguments(json!({"block_args": [[]]})),
                "model_args.block_args",
            ),
            (arguments(json!(3)), "model_args"),
            (
                json!({"vision_config": {}, "image_token_id": 1_u64 << 31}),
                "image_token_id",
            ),
        ] {
            let said = parse(&config).unwrap_err().to_string();
            assert!(said.contains(key), "{config}: {said}");
        }
    }
}
