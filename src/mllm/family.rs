//! The contract of a model family: what differs between LLaVA, `CogVLM` and their like.
//!
//! A family answers five questions, and nothing else knows it by name:
//! 1. How does an image become tiles ([`VisionLanguageModel::preprocess`])?
//! 2. How do tiles become input rows of the decoder ([`VisionLanguageModel::encode`])?
//! 3. How does a chat become tokens, with placeholders for the image ([`VisionLanguageModel::chat_format`])?
//! 4. Where do the tokens stand ([`VisionLanguageModel::positions`])?
//! 5. What are its tensors called in safetensors and GGUF files (`canonical_name` and `gguf` of [`Family`])?

use std::fmt::{self, Debug, Formatter};
use std::ops::Range;

use candle_core::Tensor;
use image::RgbImage;

use super::checkpoint::{LlamaConfig, ModelFiles, Weights};
use super::decoder::LanguageModel;
use super::gguf::GgufLayout;
use super::text::ChatTokenizer;
use super::{MllmError, Turn};

/// A model, or why it cannot be opened.
pub type OpenedModel = Result<Box<dyn VisionLanguageModel>, MllmError>;

/// A family of vision-language models. `families.rs` lists those that are built in.
#[derive(Clone, Copy)]
pub struct Family {
    /// The name in model descriptions and results.
    pub name: &'static str,
    /// The `model_type` of `config.json`, then the entries of `architectures`, that this family opens.
    pub config_names: &'static [&'static str],
    /// The canonical name of a tensor in safetensors; none for a tensor that is no weight.
    pub canonical_name: fn(stored: &str) -> Option<String>,
    /// How llama.cpp's GGUF files hold the family, or the part that its format has no place for.
    pub gguf: Result<&'static dyn GgufLayout, &'static str>,
    /// The error where a model has no tokenizer: the missing file, and what to do.
    pub missing_tokenizer: &'static str,
    /// Reads the configuration of the decoder.
    pub decoder_config: fn(&ModelFiles) -> Result<LlamaConfig, MllmError>,
    /// Opens the configuration and the preprocessor, and takes the weights.
    pub open: fn(&ModelFiles, &mut Weights) -> OpenedModel,
}

impl Debug for Family {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Family").field(&self.name).finish()
    }
}

/// An opened model.
pub trait VisionLanguageModel: Debug + Send + Sync {
    /// Sizes and names that users of the model need.
    fn info(&self) -> &ModelInfo;

    /// Tokens that an image of this width and height, pixels, becomes.
    fn image_tokens(&self, width: u32, height: u32) -> Result<usize, MllmError>;

    /// Cuts and scales an image to the tiles that the vision tower takes.
    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError>;

    /// Encodes tiles to input rows of the decoder: (image tokens, hidden).
    fn encode(&self, tiles: &Tiles) -> candle_core::Result<Tensor>;

    /// How chats are written, from the model's files.
    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError>;

    /// Where the tokens `tokens` of a chat stand whose image has the tokens `image` (empty for none).
    fn positions(&self, tokens: Range<usize>, image: &Range<usize>) -> Positions {
        let _ = image;
        Positions { rotary: (tokens.start as u32..tokens.end as u32).collect(), vision: 0..0 }
    }

    /// Longest chat, tokens, whose image (if it has one) becomes `image_tokens` tokens.
    fn context(&self, image_tokens: usize) -> usize {
        let _ = image_tokens;
        self.info().positions
    }

    /// The language model.
    fn decoder(&self) -> &dyn LanguageModel;

    /// Encodes an image to input rows of the decoder.
    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        Ok(self.encode(&self.preprocess(image)?)?)
    }
}

/// An image as the vision tower takes it.
#[derive(Debug, Clone)]
pub struct Tiles {
    /// Pixel values of each tile, (3, side, side).
    pub pixels: Vec<Tensor>,
    /// Width of the image before it was cut, pixels.
    pub width: u32,
    /// Height of the image before it was cut, pixels.
    pub height: u32,
}

/// Where tokens of a chat stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Positions {
    /// The position of each token for its rotary embedding, never falling.
    pub rotary: Vec<u32>,
    /// Which of the tokens, by index, layers treat as parts of an image.
    pub vision: Range<usize>,
}

/// How a family writes a chat as tokens.
pub trait ChatFormat: Debug + Send + Sync {
    /// Token ids of a chat, each token of the image as the model's placeholder ([`ModelInfo::image_token`]).
    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError>;
}

/// A chat that ends with a user's prompt.
#[derive(Debug, Clone, Copy)]
pub struct Chat<'a> {
    /// The system prompt; empty for none.
    pub system: &'a str,
    /// Tokens of the image that the first prompt begins with; none without one.
    pub image_tokens: Option<usize>,
    pub turns: &'a [Turn],
    pub prompt: &'a str,
}

/// Sizes and names of a model.
#[derive(Debug, Clone)]
pub struct ModelInfo {
    /// Name of its family.
    pub architecture: &'static str,
    /// The id that stands for a token of the image. It need not be a token of the vocabulary.
    pub image_token: u32,
    /// Whether the image stands before the system prompt, so that no chat shares a prefix with another.
    pub image_first: bool,
    /// Side of the square that the vision tower takes, pixels.
    pub image_size: usize,
    /// Tokens of the image that becomes the most.
    pub max_image_tokens: usize,
    /// Number of token ids.
    pub vocabulary: usize,
    /// Positions that the decoder was trained for.
    pub positions: usize,
    /// Number of weights.
    pub parameters: u64,
    /// BLAKE3 of the weight files.
    pub blake3: String,
}
