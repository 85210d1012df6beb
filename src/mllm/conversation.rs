//! The interface of every model backend: open a conversation, ask, rewind to a mark.

use super::{Deadline, LoadReport, MllmError};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// A vision-language model.
///
/// Backends: [`LocalModel`](super::LocalModel) runs in this process, `Endpoint` asks a server.
pub trait Mllm: Send + Sync {
    /// The name in results.
    fn name(&self) -> &str;

    /// Identity and size of the model.
    fn describe(&self) -> ModelDescription;

    /// Asks a model that others run at most two short questions, to find out whether it can be
    /// asked as `question` says. Gives remarks on what is odd in its answers. A model that answered
    /// before is not asked again; one in this process needs no question. `on_wait` hears why it
    /// takes long.
    ///
    /// # Errors
    /// When the model cannot be asked.
    fn probe(
        &self,
        _question: &ProbeQuestion,
        _on_wait: &dyn Fn(&str),
    ) -> Result<Vec<String>, MllmError> {
        Ok(Vec::new())
    }

    /// How long an answer of `new` tokens to `text` tokens and a picture takes on this machine, by a
    /// short measurement; `None` where it takes no time worth a word, or is not known.
    fn answer_time(&self, _text: usize, _new: usize) -> Option<AnswerTime> {
        None
    }

    /// Opens a conversation. The same prefix, seed and requests give the same answers at any thread
    /// count, unless a deadline ends one early. A server's answers are as repeatable as the server.
    ///
    /// # Errors
    /// When the chat template cannot render the prefix, or its image cannot be used.
    fn converse<'a>(
        &'a self,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError>;

    /// Number of tokens of a text, without special tokens; `None` if the backend has no tokenizer.
    fn count_tokens(&self, _text: &str) -> Option<usize> {
        None
    }
}

/// A chat. The rounds of a planning call are its turns.
pub trait Conversation: Send {
    /// Appends a user turn and generates the assistant's turn. An error leaves the conversation
    /// unchanged.
    ///
    /// # Errors
    /// When the constraint does not compile, the prompt exceeds the context, the model computes
    /// NaN, a server fails, or the request's deadline passes.
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError>;

    /// As [`Self::ask`]. `on_text` gets the pieces of the answer as they are generated. A backend
    /// that does not know the pieces gives the whole. Joined, they are the answer's text, except
    /// where a server's answer shows late that what came was reasoning: then the text counts.
    ///
    /// # Errors
    /// As [`Self::ask`].
    fn ask_aloud(
        &mut self,
        prompt: &str,
        request: &Request,
        on_text: &mut dyn FnMut(&str),
    ) -> Result<Answer, MllmError> {
        let answer = self.ask(prompt, request)?;
        on_text(&answer.text);
        Ok(answer)
    }

    /// As [`Self::ask`], and gives at most `count` answers, the likeliest first. The turn is the
    /// first of them.
    ///
    /// # Errors
    /// As [`Self::ask`], and where the backend does not know how likely its answers are.
    fn ask_likeliest(
        &mut self,
        _: &str,
        _: &Request,
        count: usize,
    ) -> Result<Vec<Answer>, MllmError> {
        let problem = format!(
            "{count} proposals were asked for, but a server does not say how likely answers are"
        );
        Err(MllmError::Request { problem })
    }

    /// Adds images that the next prompt begins with, behind those that it has already. A chat may
    /// have several, in one turn and in many. They are resized as the model's preprocessor says.
    ///
    /// # Errors
    /// When the model takes no such image, or not so many, or when the backend takes none but that
    /// of the prefix. Then none is added.
    fn show(&mut self, images: &[Arc<RgbImage>]) -> Result<(), MllmError> {
        let problem = format!(
            "{} more pictures were shown, but this model takes that of the prompt prefix alone",
            images.len()
        );
        Err(MllmError::Request { problem })
    }

    /// The current point of the conversation.
    fn mark(&self) -> Mark;

    /// Drops the turns, and the images that were shown, after a mark; what was computed before it
    /// stays cached. A mark after the current point changes nothing.
    fn rewind(&mut self, mark: Mark);
}

/// The time that an answer is expected to take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnswerTime {
    /// Until its first token.
    pub first_token: Duration,
    /// Until its last token, if it has as many as it may.
    pub whole: Duration,
}

/// How a model will be asked, for [`Mllm::probe`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeQuestion {
    /// Whether prompts come with a picture.
    pub picture: bool,
    /// Whether answers are constrained.
    pub constrained: bool,
    /// Maximum tokens of an answer.
    pub max_new_tokens: usize,
    pub sampling: Sampling,
}

/// The prompt prefix of a conversation.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PromptPrefix {
    /// The system prompt; empty for none.
    pub system: String,
    /// The image of the first user turn, before its text; [`Conversation::show`] adds further ones.
    /// It is resized as the model's preprocessor says.
    pub image: Option<Arc<RgbImage>>,
}

/// BLAKE3 of an image's width, height and RGB bytes, hexadecimal.
pub fn image_hash(image: &RgbImage) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&image.width().to_le_bytes());
    hasher.update(&image.height().to_le_bytes());
    hasher.update(image.as_raw());
    hasher.finalize().to_hex().to_string()
}

/// A prompt with its answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Turn {
    pub prompt: String,
    pub answer: String,
}

/// BLAKE3, hexadecimal, of the whole chat: the system prompt, the earlier turns and `prompt`. Each
/// part follows its length, so no two chats share a hash.
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

/// Settings of one answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    pub constraint: Constraint,
    /// Maximum tokens of the answer, fast-forwarded tokens included.
    pub max_new_tokens: usize,
    pub sampling: Sampling,
    /// A local model checks it between tokens and between chunks of the prompt; for a server it
    /// limits the wait.
    pub deadline: Deadline,
    /// Lets a local model draft the answer, from these tokens of an earlier answer and from the
    /// chat. `None` drafts nothing. Drafts change the time that an answer takes, and nothing else.
    pub draft: Option<Vec<u32>>,
}

/// The form of an answer. A constrained answer matches, except where `max_new_tokens` ends it
/// ([`Answer::finish`]) or a server violates the constraint ([`Answer::constraint`]).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Constraint {
    /// Any text.
    Free,
    /// Exactly one of these texts.
    Choice(Vec<String>),
    /// A text that this regular expression matches as a whole (syntax of the `regex` crate, no
    /// look-around).
    Regex(String),
    /// These in order; free text and Lark are not allowed. A regular expression takes all that it
    /// matches: what may begin the next part must end it, or both must be one expression.
    Sequence(Vec<Constraint>),
    /// One of these; free text and Lark are not allowed.
    OneOf(Vec<Constraint>),
    /// A text of this grammar in llguidance's dialect of Lark, with the start rule `start`.
    Lark(String),
}

/// How a constraint was applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ConstraintUse {
    /// The request had none.
    Unconstrained,
    /// Decoding in this process enforced it.
    Enforced,
    /// A server received it, and the answer matches.
    Satisfied,
    /// A server received it, but the answer does not match: it is too short, or the server ignored
    /// the constraint.
    Violated,
    /// The server did not receive it, because its description has `grammar = "none"`.
    NotSent,
}

/// How tokens are sampled from the model's distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Sampling {
    /// The most likely token, the lowest id of equals.
    Greedy,
    /// A random token, seeded by the conversation.
    Sample {
        /// Divides the logits; above 0.
        temperature: f64,
        /// Nucleus: only the most likely tokens whose probabilities add up to this, in (0, 1].
        top_p: f64,
    },
}

/// A generated answer with its cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The text, without special tokens.
    pub text: String,
    /// Its tokens, to draft a later answer from; none from a server.
    pub ids: Vec<u32>,
    /// The natural logarithm of the probability of the tokens that were sampled, under the
    /// constraint and at temperature 1; none without a constraint, and from a server.
    pub log_probability: Option<f64>,
    pub tokens: TokenCounts,
    pub time: RoundTime,
    pub finish: FinishReason,
    pub constraint: ConstraintUse,
    /// [`prompt_hash`] of the chat.
    pub prompt_hash: String,
}

/// Tokens of one round. The prompt has `text + image + cached` tokens, the answer `fast_forwarded +
/// sampled`. If the constraint determines the whole answer, the prompt is not computed; its tokens
/// count in the next round that computes them.
///
/// For a server these are the server's counts: `text` includes image tokens, `sampled` includes
/// fast-forwarded tokens, and all are zero if the server gives none.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema,
)]
pub struct TokenCounts {
    /// Text tokens of the prompt computed in this round.
    pub text: usize,
    /// Image tokens of the prompt computed in this round.
    pub image: usize,
    /// Prompt tokens in the cache: from earlier rounds, or from the prompt prefix that all calls
    /// share.
    pub cached: usize,
    /// Answer tokens that the constraint determined.
    pub fast_forwarded: usize,
    /// Answer tokens that the model sampled.
    pub sampled: usize,
    /// Tokens that were drafted and computed ahead of the model's choice.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub drafted: usize,
    /// Drafted tokens that the answer has; they count as sampled or fast-forwarded too.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub accepted: usize,
}

/// Lets serde omit counts of what most answers do not have.
#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Wall time of one round, milliseconds. Parts that a backend does not measure are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
pub struct RoundTime {
    /// Image preprocessing, vision tower and projector; zero if the features were cached.
    pub image_encode: f64,
    /// Computation of the prompt's tokens, and of the fast-forwarded tokens that begin the answer.
    pub prefill: f64,
    /// From the start of the round to the first sampled token; zero if there is none.
    pub first_token: f64,
    /// Everything after the prefill.
    pub decode: f64,
    /// Wait for a server, retries included.
    #[serde(default)]
    pub remote: f64,
    /// The whole round with chat template and tokenizer.
    pub total: f64,
}

pub fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Why an answer ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FinishReason {
    /// The model sampled an end-of-sequence token.
    EndOfSequence,
    /// The constraint allows no further token.
    Complete,
    /// The answer has `max_new_tokens`.
    Length,
    /// The model's context is full.
    ContextFull,
}

/// A point of a conversation, from [`Conversation::mark`]. The default is the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Mark {
    /// Number of turns.
    pub(super) turns: usize,
    /// Number of images that were shown behind that of the prefix.
    pub(super) images: usize,
}

/// Identity and size of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelDescription {
    /// The name in results.
    pub name: String,
    /// Kind of model (`llava`, `llava-next`, `cogvlm`, `endpoint`).
    pub architecture: String,
    /// Number of weights.
    pub parameters: u64,
    /// Number format of the computation.
    pub dtype: String,
    /// Side of the vision tower's square input, pixels; `None` for a model without images.
    pub image_size: Option<u32>,
    /// Tokens of an image; the maximum if they depend on its shape.
    pub image_tokens: usize,
    /// Number of token ids.
    pub vocabulary: usize,
    /// Maximum tokens of a chat; for `CogVLM` maximum positions, of which an image takes three.
    pub context: usize,
    /// BLAKE3, hexadecimal, of the weight files in the order of their names; empty without files.
    pub weights_blake3: String,
    /// The weights in memory; empty for a server.
    #[serde(default, skip_serializing_if = "LoadReport::is_empty")]
    pub load: LoadReport,
    /// The server of a remote model, whose size and weights are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub server: Option<Server>,
}

/// The server of a remote model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Server {
    /// The server's address.
    pub endpoint: String,
    /// The server's name of the model.
    pub model: String,
}
