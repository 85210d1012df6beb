//! `config.json` of a `Gemma3ForConditionalGeneration` checkpoint.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, VisionConfig};
use serde_json::{Value, json};
use std::path::Path;

/// A Gemma 3: its vision tower, its decoder, and how they are joined.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gemma3Config {
    pub vision: VisionConfig,
    /// Side of the blocks of patches that become one token.
    pub pool: usize,
    pub text: LlamaConfig,
    /// Token id that stands for a token of the image in the prompt. It may lie outside of the
    /// decoder's vocabulary, which has no row for it then.
    pub image_token: u32,
}

const TOKENS: &str = "mm_tokens_per_image";
/// Largest id of an image's token. A larger one means a broken configuration.
const MAX_ID: u32 = 1 << 24;

impl Gemma3Config {
    pub(super) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        Self::from_json(
            &files.path("config.json"),
            &files.required_json("config.json")?,
        )
    }

    /// Reads a configuration; `path` is for messages.
    pub(super) fn from_json(path: &Path, value: &Value) -> Result<Self, MllmError> {
        let root = ConfigObject::root(path, value)?;
        // The defaults of `SiglipVisionConfig`.
        let vision = root.child_or_empty("vision_config")?.with_defaults(json!({
            "patch_size": 16, "hidden_act": "gelu_pytorch_tanh", "layer_norm_eps": 1e-6,
        }));
        let vision = VisionConfig::read(&vision)?;
        let mut text =
            LlamaConfig::read_as(root.child_or_empty("text_config")?, DecoderType::Gemma3)?;
        text.tie_word_embeddings = root.value("tie_word_embeddings")?.unwrap_or(true);
        Ok(Self {
            pool: pool(&root, &vision)?,
            image_token: image_token(&root)?,
            vision,
            text,
        })
    }

    /// Tokens of an image.
    pub(super) fn tokens(&self) -> usize {
        self.vision.patches() / (self.pool * self.pool)
    }
}

/// The side of the blocks of patches that give the number of tokens.
fn pool(root: &ConfigObject<'_>, vision: &VisionConfig) -> Result<usize, MllmError> {
    let tokens: usize = root.value(TOKENS)?.unwrap_or(256);
    let (side, patches) = (tokens.isqrt(), vision.image_size / vision.patch_size);
    if tokens > 0 && side * side == tokens && patches.is_multiple_of(side) {
        return Ok(patches / side);
    }
    Err(root.error(
        TOKENS,
        format!("{tokens} tokens are no square of blocks of the {patches} by {patches} patches"),
    ))
}

fn image_token(root: &ConfigObject<'_>) -> Result<u32, MllmError> {
    const KEY: &str = "image_token_index";
    let named = match root.first_id("image_token_id")? {
        Some(id) => Some(id),
        None => root.first_id(KEY)?,
    };
    let id = named.unwrap_or(262_144);
    if id > MAX_ID {
        return Err(root.error(KEY, format!("{id} is no token of any vocabulary")));
    }
    Ok(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(value: &Value) -> Result<Gemma3Config, MllmError> {
        Gemma3Config::from_json(Path::new("config.json"), value)
    }

    #[test]
    fn the_published_4b_names_few_keys() {
        let config = parse(&json!({
            "mm_tokens_per_image": 256,
            "text_config": {"model_type": "gemma3_text", "hidden_size": 2560, "intermediate_size": 10240,
                "num_hidden_layers": 34, "sliding_window": 1024, "rope_scaling": {"rope_type": "linear", "factor": 8.0}},
            "vision_config": {"model_type": "siglip_vision_model", "hidden_size": 1152, "intermediate_size": 4304,
                "num_hidden_layers": 27, "num_attention_heads": 16, "image_size": 896, "patch_size": 14,
                "vision_use_head": false},
        }))
        .unwrap();
        assert_eq!((config.tokens(), config.pool), (256, 4));
        let text = &config.text;
        assert_eq!(
            (text.vocabulary, text.heads, text.kv_heads),
            (262_208, 8, 4)
        );
        assert_eq!((text.head_dim, text.context), (256, 131_072));
        assert_eq!(config.image_token, 262_144);
        assert!(text.tie_word_embeddings && text.gemma.is_some());
    }

    #[test]
    fn blocks_that_do_not_fill_the_patches_are_refused() {
        for tokens in [0, 5, 25, 1_usize << 40] {
            let error = parse(&json!({"mm_tokens_per_image": tokens}))
                .unwrap_err()
                .to_string();
            assert!(error.contains("mm_tokens_per_image"), "{error}");
        }
    }
}
