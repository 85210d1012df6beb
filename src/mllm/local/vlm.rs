//! The one interface to every family of models that is computed here.

use std::ops::Range;

use candle_core::Tensor;
use image::RgbImage;

use crate::mllm::checkpoint::ModelFiles;
use crate::mllm::decoder::{KvCache, Logits};
use crate::mllm::text::ChatTokenizer;
use crate::mllm::{MllmError, Turn};

/// A vision-language model: what it computes, and how its prompts are written. One folder of the stage is one family.
pub(crate) trait VisionLanguageModel: std::fmt::Debug + Send + Sync {
    /// What the model is.
    fn info(&self) -> &ModelInfo;

    /// Most tokens of a chat whose image (if it has one) becomes `image_tokens` tokens.
    fn context(&self, image_tokens: usize) -> usize;

    /// Tokens that an image of this width and height, pixels, becomes.
    ///
    /// # Errors
    /// When such an image cannot be used.
    fn image_tokens(&self, width: u32, height: u32) -> Result<usize, MllmError>;

    /// Image features, the decoder's input rows of an image: (image tokens, hidden).
    ///
    /// # Errors
    /// When the image cannot be used.
    fn encode_image(&self, image: &RgbImage) -> Result<Tensor, MllmError>;

    /// The decoder's input rows of text tokens: (tokens, hidden).
    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor>;

    /// An empty cache.
    fn new_cache(&self) -> KvCache;

    /// Runs rows through the decoder, adds them to the cache, and gives the logits (wanted positions, vocabulary).
    fn forward(
        &self,
        rows: &InputEmbeddings,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>>;

    /// How prompts are written, from the model's files.
    ///
    /// # Errors
    /// When a file is missing or does not fit the model.
    fn chat_format(&self, files: &ModelFiles, tokenizer: &ChatTokenizer) -> Result<Box<dyn ChatFormat>, MllmError>;
}

/// How a family writes a chat as tokens.
pub(crate) trait ChatFormat: std::fmt::Debug + Send + Sync {
    /// Token ids of a chat, each token of the image as the model's placeholder ([`ModelInfo::image_token`]).
    ///
    /// # Errors
    /// When the chat cannot be written.
    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError>;
}

/// A chat that ends with a user's prompt.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chat<'a> {
    /// The system prompt; empty for none.
    pub system: &'a str,
    /// Tokens of the image that the first prompt begins with; none without one.
    pub image_tokens: Option<usize>,
    /// What was said.
    pub turns: &'a [Turn],
    /// The prompt that is to be answered.
    pub prompt: &'a str,
}

/// What a model is, as far as its users must know.
#[derive(Debug, Clone)]
pub(crate) struct ModelInfo {
    /// Name of its family.
    pub architecture: &'static str,
    /// The id that stands for a token of the image. It need not be a token of the vocabulary.
    pub image_token: u32,
    /// Side of the square that the vision tower sees, pixels.
    pub image_size: usize,
    /// Most tokens that an image becomes.
    pub max_image_tokens: usize,
    /// Number of token ids.
    pub vocabulary: usize,
    /// Positions that the decoder was made for.
    pub positions: usize,
    /// Number of weights.
    pub parameters: u64,
    /// BLAKE3 of the weight files.
    pub blake3: String,
}

/// Input rows with their place in the chat.
#[derive(Debug)]
pub(crate) struct InputEmbeddings {
    /// The rows, (tokens, hidden).
    pub rows: Tensor,
    /// Index in the chat of the first row's token.
    pub start: usize,
    /// Indices in the chat of the image's tokens, all of them, also those that are not among the rows; empty without an
    /// image up to here.
    pub image: Range<usize>,
}
