//! The generation loop.

use std::time::Instant;

use candle_core::Tensor;
use toktrie::SimpleVob;

use super::sequence::Sequence;
use crate::mllm::decoder::Logits;
use crate::mllm::family::{ImageFeatures, VisionLanguageModel};
use crate::mllm::sampling::Sampler;
use crate::mllm::text::GrammarState;
use crate::mllm::{Deadline, FinishReason, MllmError, milliseconds};

/// The tokens of an answer. Times are milliseconds.
#[derive(Debug)]
pub(super) struct Generated {
    /// The answer, without the token that ended it.
    pub(super) ids: Vec<u32>,
    /// Number of tokens that the grammar fast-forwarded.
    pub(super) fast_forwarded: usize,
    pub(super) finish: FinishReason,
    /// Duration of the first forward pass, over the prompt.
    pub(super) prefill: f64,
    /// End of the first forward pass, from the start of the round; without a pass, the start of generation.
    pub(super) prefill_end: f64,
    /// When the first token was sampled, from the start of the round; zero if none was.
    pub(super) first_token: f64,
}

/// What ends an answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct End<'a> {
    pub(super) tokens: &'a [u32],
    pub(super) max_new_tokens: usize,
    /// Longest chat, tokens.
    pub(super) context: usize,
    pub(super) deadline: Deadline,
}

struct Generation<'a> {
    model: &'a dyn VisionLanguageModel,
    sequence: &'a mut Sequence,
    features: Option<&'a ImageFeatures>,
    /// Tokens that the model has not computed yet: the rest of the prompt, then those appended since. Fast-forwarded tokens
    /// gather here and are computed in one pass before the next token is sampled.
    pending: Vec<u32>,
    deadline: Deadline,
    out: Generated,
    passes: usize,
    start: Instant,
}

/// Generates an answer after `prompt`, the part of the prompt that `sequence` does not hold yet. `on_tokens` gets the answer so
/// far whenever it has grown.
#[expect(clippy::too_many_arguments, reason = "one call, and each argument is of another kind")]
pub(super) fn generate(
    model: &dyn VisionLanguageModel,
    sequence: &mut Sequence,
    features: Option<&ImageFeatures>,
    prompt: &[u32],
    mut grammar: Option<GrammarState>,
    mut sampler: Sampler,
    end: &End<'_>,
    start: Instant,
    on_tokens: &mut dyn FnMut(&[u32]),
) -> Result<Generated, MllmError> {
    let room = end.context.saturating_sub(sequence.ids().len() + prompt.len());
    let (budget, at_budget) = if end.max_new_tokens <= room {
        (end.max_new_tokens, FinishReason::Length)
    } else {
        (room, FinishReason::ContextFull)
    };
    let mut generation = Generation {
        model,
        sequence,
        features,
        pending: prompt.to_vec(),
        deadline: end.deadline,
        out: Generated {
            ids: Vec::new(),
            fast_forwarded: 0,
            finish: at_budget,
            prefill: 0.0,
            prefill_end: milliseconds(start.elapsed()),
            first_token: 0.0,
        },
        passes: 0,
        start,
    };
    loop {
        if let Some(grammar) = &mut grammar {
            let mut fast_forwarded = grammar.take_fast_forwarded()?;
            let left = budget - generation.out.ids.len();
            let cut = fast_forwarded.len() > left;
            fast_forwarded.truncate(left);
            generation.push_fast_forwarded(&fast_forwarded);
            on_tokens(&generation.out.ids);
            if grammar.is_complete() && !cut {
                generation.out.finish = FinishReason::Complete;
                break;
            }
        }
        if generation.out.ids.len() >= budget {
            break;
        }
        let allowed = grammar.as_mut().map(GrammarState::allowed).transpose()?;
        let (token, sampled) = match allowed.as_ref().and_then(only_token) {
            Some(token) => (token, false),
            None => (generation.choose(&mut sampler, allowed.as_ref())?, true),
        };
        if end.tokens.contains(&token) {
            generation.out.finish = FinishReason::EndOfSequence;
            break;
        }
        if sampled {
            generation.push_sampled(token);
        } else {
            generation.push_fast_forwarded(&[token]);
        }
        on_tokens(&generation.out.ids);
        if let Some(grammar) = &mut grammar {
            grammar.consume(&[token])?;
        }
    }
    Ok(generation.out)
}

impl Generation<'_> {
    /// Computes the pending tokens and samples one.
    fn choose(&mut self, sampler: &mut Sampler, allowed: Option<&SimpleVob>) -> Result<u32, MllmError> {
        let pass_start = Instant::now();
        let logits = self.compute_pending()?;
        if self.passes == 0 {
            self.out.prefill = milliseconds(pass_start.elapsed());
            self.out.prefill_end = milliseconds(self.start.elapsed());
        }
        self.passes += 1;
        let logits = match logits {
            Some(logits) => logits.flatten_all()?.to_vec1()?,
            None => Vec::new(),
        };
        let position = self.sequence.ids().len().saturating_sub(1);
        // An answer has no image, so the placeholder is never sampled.
        sampler.choose(logits, allowed, self.model.info().image_token, position)
    }

    /// Computes the pending tokens; gives the logits after the last one.
    fn compute_pending(&mut self) -> Result<Option<Tensor>, MllmError> {
        let pending = std::mem::take(&mut self.pending);
        self.sequence.append_in_passes(self.model, &pending, self.features, Logits::Last, self.deadline)
    }

    fn push_sampled(&mut self, token: u32) {
        if self.out.first_token == 0.0 {
            self.out.first_token = milliseconds(self.start.elapsed());
        }
        self.push(token);
    }

    fn push_fast_forwarded(&mut self, tokens: &[u32]) {
        for token in tokens {
            self.push(*token);
        }
        self.out.fast_forwarded += tokens.len();
    }

    fn push(&mut self, token: u32) {
        self.out.ids.push(token);
        self.pending.push(token);
    }
}

/// The allowed token, if there is exactly one.
fn only_token(allowed: &SimpleVob) -> Option<u32> {
    let first = allowed.first_bit_set()?;
    (allowed.num_set() == 1).then_some(first as u32)
}
