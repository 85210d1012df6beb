//! What a model thinks before its answer. It has a limit of its own, no grammar, and is no part of
//! the answer.

use super::generate::{End, Generated, generate};
use super::sequence::Sequence;
use crate::family::{ImageFeatures, VisionLanguageModel};
use crate::sampling::Sampler;
use crate::text::ChatTokenizer;
use crate::{Deadline, FinishReason, MllmError};
use std::time::Instant;

/// The token that ends thinking.
const MARK: &str = "</think>";
/// What stands between thinking and answer in the chats of models that think.
const GAP: &str = "\n\n";

/// How a model thinks.
#[derive(Debug)]
pub(super) struct Thinking {
    /// Most tokens of thinking.
    limit: usize,
    mark: u32,
    /// Tokens behind the mark.
    gap: Vec<u32>,
    /// Tokens before a mark that is put behind thinking that reaches the limit.
    cut: Vec<u32>,
}

/// The thinking before an answer.
pub(super) struct ThinkingText {
    /// Their tokens, with those that end them.
    pub(super) ids: Vec<u32>,
    /// The tokens that the model wrote.
    pub(super) sampled: usize,
    /// Of the pass over the prompt, milliseconds.
    pub(super) prefill: f64,
    /// End of that pass, and the first token, from the start of the round, milliseconds.
    pub(super) prefill_end: f64,
    pub(super) first_token: f64,
}

impl Thinking {
    /// Thinking of at most `limit` tokens.
    ///
    /// # Errors
    /// When the vocabulary has no token that ends them.
    pub(super) fn open(limit: usize, tokenizer: &ChatTokenizer) -> Result<Self, MllmError> {
        let mark = tokenizer.id(MARK).ok_or_else(|| MllmError::Tokenizer {
            path: tokenizer.path().to_path_buf(),
            problem: format!("generation.thinking: the token {MARK} is missing"),
        })?;
        Ok(Self {
            limit,
            mark,
            gap: tokenizer.encode_text(GAP)?,
            cut: tokenizer.encode_text("\n")?,
        })
    }

    /// Lets a model think after `prompt`, the part of the prompt that `sequence` does not hold yet.
    pub(super) fn think(
        &self,
        model: &dyn VisionLanguageModel,
        sequence: &mut Sequence,
        features: Option<&ImageFeatures>,
        prompt: &[u32],
        sampler: Sampler,
        at: ThinkingBounds<'_>,
    ) -> Result<ThinkingText, MllmError> {
        let ends = [&[self.mark][..], at.ends].concat();
        let end = End {
            tokens: &ends,
            max_new_tokens: self.limit,
            context: at.context,
            deadline: at.deadline,
        };
        let Generated {
            mut ids,
            finish,
            prefill,
            prefill_end,
            first_token,
            ..
        } = generate(
            model,
            sequence,
            features,
            prompt,
            None,
            sampler,
            None,
            None,
            &end,
            at.start,
            &mut |_| {},
        )?;
        let sampled = ids.len();
        // The model learned no thinking that stops in mid-sentence, so the cut says why it stops.
        if finish != FinishReason::EndOfSequence {
            ids.extend(&self.cut);
        }
        ids.push(self.mark);
        ids.extend(&self.gap);
        Ok(ThinkingText {
            ids,
            sampled,
            prefill,
            prefill_end,
            first_token,
        })
    }
}

/// What bounds thinking besides its own limit.
#[derive(Debug, Clone, Copy)]
pub(super) struct ThinkingBounds<'a> {
    /// Tokens that end an answer.
    pub(super) ends: &'a [u32],
    /// Longest chat, tokens.
    pub(super) context: usize,
    pub(super) deadline: Deadline,
    /// Start of the round.
    pub(super) start: Instant,
}
