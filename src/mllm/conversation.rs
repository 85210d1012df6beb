//! The one interface to every model backend: open a conversation, ask, go back to a mark.

use std::sync::Arc;
use std::time::Duration;

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::{Deadline, LoadReport, MllmError};

/// A multimodal language model that can be talked to.
///
/// Backends: [`LocalModel`](super::LocalModel) computes the answers in this process, [`Endpoint`](super::Endpoint) asks a
/// server, [`Replay`](super::Replay) gives recorded ones.
pub trait Mllm: Send + Sync {
    /// The name under which results are reported.
    fn name(&self) -> &str;

    /// What the model is: size, number format, context, identity of its weights.
    fn describe(&self) -> ModelDescription;

    /// Opens a conversation. The same opening, seed and requests give the same answers at any thread count, unless a
    /// deadline cuts one short; an endpoint promises as much as its server does.
    ///
    /// # Errors
    /// When the opening cannot be rendered by the model's chat template or its image cannot be used.
    fn converse<'a>(&'a self, prefix: &PromptPrefix, seed: u64) -> Result<Box<dyn Conversation + 'a>, MllmError>;

    /// Tokens that the model's own tokenizer makes of a text, without special ones; `None` where it is not at hand.
    fn count_tokens(&self, _text: &str) -> Option<usize> {
        None
    }
}

/// A chat in progress: the rounds of a planning call continue one another.
pub trait Conversation: Send {
    /// Appends a user turn and generates the assistant's. After an error the conversation is as it was before.
    ///
    /// # Errors
    /// When the constraint does not compile, the prompt does not fit into the context, the model computes NaN, a server
    /// fails, or the request's deadline passes.
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError>;

    /// Remembers this point of the conversation.
    fn mark(&self) -> Mark;

    /// Goes back to a mark: later turns are forgotten, what was computed before the mark stays.
    /// A mark that lies ahead (made before an earlier rewind went behind it) changes nothing.
    fn rewind(&mut self, mark: Mark);
}

/// What stands at the head of a conversation.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PromptPrefix {
    /// The system prompt; empty for none.
    pub system: String,
    /// The image of the first user turn, before its text. It is resized as the model's preprocessor says.
    pub image: Option<Arc<RgbImage>>,
}

/// BLAKE3 of an image's width, height and RGB bytes, in hexadecimal.
pub fn image_hash(image: &RgbImage) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&image.width().to_le_bytes());
    hasher.update(&image.height().to_le_bytes());
    hasher.update(image.as_raw());
    hasher.finalize().to_hex().to_string()
}

/// One question with its answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Turn {
    /// What the user said.
    pub prompt: String,
    /// What the model answered.
    pub answer: String,
}

/// BLAKE3, in hexadecimal, of all text the model has been told when it answers `prompt`: the system prompt, the earlier
/// turns and the prompt itself. Every part is preceded by its length, so no two chats share a hash.
pub fn prompt_hash(system: &str, turns: &[Turn], prompt: &str) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut part = |text: &str| {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    };
    part(system);
    for turn in turns {
        part(&turn.prompt);
        part(&turn.answer);
    }
    part(prompt);
    hasher.finalize().to_hex().to_string()
}

/// How an answer is to be generated.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// What the answer must look like.
    pub constraint: Constraint,
    /// Most tokens of the answer, forced ones included.
    pub max_new_tokens: usize,
    /// How free tokens are chosen.
    pub sampling: Sampling,
    /// When the answer must be there. Models here look at it between tokens and between chunks of the prompt; for an
    /// endpoint it bounds the wait.
    pub deadline: Deadline,
}

/// What an answer must look like. A constrained answer always matches, unless `max_new_tokens` cuts it short, which
/// [`Answer::finish`] says, or a server did not keep to it, which [`Answer::constraint`] says.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Constraint {
    /// Any text, until the model ends it.
    Free,
    /// Exactly one of these texts.
    Choice(Vec<String>),
    /// A text that matches this regular expression as a whole (syntax of the `regex` crate, no look-around).
    Regex(String),
    /// These one after the other; free text and Lark cannot be among them.
    Sequence(Vec<Constraint>),
    /// A text of this grammar in llguidance's dialect of Lark, whose start rule is `start`.
    Lark(String),
}

/// What became of a request's constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ConstraintUse {
    /// None was asked for.
    Unconstrained,
    /// The answer was decoded under it in this process.
    Enforced,
    /// It was sent to a server, and the answer is as it says.
    Satisfied,
    /// It was sent to a server, but the answer is not as it says: it was cut short, or the server ignored it.
    Violated,
    /// It was not sent, since the endpoint's description says `grammar = "none"`.
    NotSent,
}

/// How free tokens are chosen from the model's distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Sampling {
    /// The most likely token; of equals, the lowest id.
    Greedy,
    /// A random token, seeded by the conversation.
    Sample {
        /// Divides the logits; above 0.
        temperature: f64,
        /// Nucleus: only the likeliest tokens whose probabilities sum to this, in (0, 1].
        top_p: f64,
    },
}

/// A generated answer and what it cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The text, without special tokens.
    pub text: String,
    /// Tokens read and written.
    pub tokens: TokenCounts,
    /// Wall time.
    pub time: RoundTime,
    /// Why the answer ends where it ends.
    pub finish: FinishReason,
    /// What became of the constraint.
    pub constraint: ConstraintUse,
    /// [`prompt_hash`] of the chat that was answered.
    pub prompt_hash: String,
}

/// Tokens of one round. The prompt has `text + image + cached` tokens, the answer `forced + free`. Where the constraint left
/// nothing to choose, the prompt is not computed: what was not known of it is counted by the next round that computes it.
///
/// An endpoint tells what its server counts: image tokens stand under `text`, forced ones under `free`, and all is zero
/// where the server says nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
pub struct TokenCounts {
    /// Text tokens of the prompt that were computed in this round.
    pub text: usize,
    /// Image tokens of the prompt that were computed in this round.
    pub image: usize,
    /// Tokens of the prompt that were still known: of earlier rounds, or of the system prompt that all calls share.
    pub cached: usize,
    /// Tokens of the answer that the constraint left no choice about.
    pub fast_forwarded: usize,
    /// Tokens of the answer that the model chose.
    pub sampled: usize,
}

/// Wall time of one round, milliseconds. Parts that a backend cannot tell are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
pub struct RoundTime {
    /// Preprocessing the image, vision tower and projector; zero when the features were known.
    pub image_encode: f64,
    /// Computing the prompt's tokens (and those of the answer that are forced from its start).
    pub prefill: f64,
    /// From the start of the round to the first token that the model chose; zero if it chose none.
    pub first_token: f64,
    /// Everything after the prefill.
    pub decode: f64,
    /// Waiting for a server, retries included; how it spent the time is not known.
    #[serde(default)]
    pub remote: f64,
    /// The whole round, chat template and tokenizer included.
    pub total: f64,
}

/// A time as [`RoundTime`] has it, milliseconds.
pub(crate) fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Why an answer ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinishReason {
    /// The model said so (end-of-sequence token).
    EndOfSequence,
    /// The constraint is fulfilled and allows nothing more.
    Complete,
    /// `max_new_tokens` were generated.
    Length,
    /// The model's context is full.
    ContextFull,
}

/// A point of a conversation, from [`Conversation::mark`]; the default is its beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Mark(pub(super) usize);

/// What a model is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelDescription {
    /// The name under which results are reported.
    pub name: String,
    /// Kind of model (`llava`, `llava-next`, `cogvlm`, `endpoint`, `replay`).
    pub architecture: String,
    /// Number of weights.
    pub parameters: u64,
    /// Number format that it computes in.
    pub dtype: String,
    /// Side of the square image that the vision tower sees, pixels; none if it takes no images.
    pub image_size: Option<u32>,
    /// Tokens that an image becomes; the most, where that depends on its shape.
    pub image_tokens: usize,
    /// Number of token ids.
    pub vocabulary: usize,
    /// Most tokens of a chat; of `CogVLM` most positions, of which an image takes three.
    pub context: usize,
    /// BLAKE3 of the weight files in the order of their names, hexadecimal; empty if there are none.
    pub weights_blake3: String,
    /// How its weights are held in memory; empty if it is not computed here.
    #[serde(default, skip_serializing_if = "LoadReport::is_empty")]
    pub load: LoadReport,
    /// The server that answers, of an endpoint; of such a model neither size nor weights are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub server: Option<Server>,
}

/// Who answers for an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Server {
    /// Its address.
    pub endpoint: String,
    /// The model, as the server calls it.
    pub model: String,
}
