//! The generation loop.

use super::ahead::Ahead;
use super::draft::Drafter;
use super::likeliest::Search;
use super::sequence::Sequence;
use crate::decoder::Logits;
use crate::family::{ImageFeatures, VisionLanguageModel};
use crate::sampling::{Sampler, log_total};
use crate::text::GrammarState;
use crate::{Deadline, FinishReason, MllmError, milliseconds};
use candle_core::Tensor;
use std::time::Instant;
use toktrie::SimpleVob;

/// The tokens of an answer. Times are milliseconds.
#[derive(Debug)]
pub(super) struct Generated {
    /// The answer, without the token that ended it.
    pub(super) ids: Vec<u32>,
    /// Number of tokens that the grammar fast-forwarded.
    pub(super) fast_forwarded: usize,
    /// Number of tokens that were drafted and computed ahead.
    pub(super) drafted: usize,
    /// Number of those that the answer has.
    pub(super) accepted: usize,
    /// The logarithm of the probability of the sampled tokens under the grammar, at temperature 1;
    /// none without a grammar.
    pub(super) log_probability: Option<f64>,
    pub(super) finish: FinishReason,
    /// Duration of the first forward pass, over the prompt.
    pub(super) prefill: f64,
    /// End of the first forward pass, from the start of the round; without a pass, the start of
    /// generation.
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
    /// Tokens since the last pass: the rest of the prompt, then those appended to the answer.
    /// Fast-forwarded tokens gather here and are computed in one pass before the next token is
    /// sampled.
    pending: Vec<u32>,
    /// Tokens that the sequence already holds behind its last token that is certain.
    ahead: Ahead,
    drafter: Option<Drafter<'a>>,
    /// A search for likely answers, which gives the beginning of this one.
    search: Option<&'a mut Search>,
    /// Tokens of the chat whose logits were needed: what a sequence without drafts holds.
    needed: usize,
    /// Maximum tokens of the answer.
    budget: usize,
    deadline: Deadline,
    out: Generated,
    passes: usize,
    start: Instant,
}

/// Generates an answer after `prompt`, the part of the prompt that `sequence` does not hold yet.
/// `on_tokens` gets the answer so far whenever it has grown. With a drafter, tokens and sequence
/// are those without one.
#[expect(
    clippy::too_many_arguments,
    reason = "one call, and each argument is of another kind"
)]
pub(super) fn generate(
    model: &dyn VisionLanguageModel,
    sequence: &mut Sequence,
    features: Option<&ImageFeatures>,
    prompt: &[u32],
    mut grammar: Option<GrammarState>,
    mut sampler: Sampler,
    drafter: Option<Drafter<'_>>,
    search: Option<&mut Search>,
    end: &End<'_>,
    start: Instant,
    on_tokens: &mut dyn FnMut(&[u32]),
) -> Result<Generated, MllmError> {
    let room = end
        .context
        .saturating_sub(sequence.ids().len() + prompt.len());
    let (budget, at_budget) = if end.max_new_tokens <= room {
        (end.max_new_tokens, FinishReason::Length)
    } else {
        (room, FinishReason::ContextFull)
    };
    let mut generation = Generation {
        model,
        needed: sequence.ids().len(),
        sequence,
        features,
        pending: prompt.to_vec(),
        ahead: Ahead::default(),
        drafter,
        search,
        budget,
        deadline: end.deadline,
        out: Generated {
            ids: Vec::new(),
            fast_forwarded: 0,
            drafted: 0,
            accepted: 0,
            log_probability: grammar.as_ref().map(|_| 0.0),
            finish: at_budget,
            prefill: 0.0,
            prefill_end: milliseconds(start.elapsed()),
            first_token: 0.0,
        },
        passes: 0,
        start,
    };
    // The sequence is put in order also after an error, because the conversation goes on from it.
    let ran = generation.run(&mut grammar, &mut sampler, end.tokens, on_tokens);
    generation.settle();
    let needed = generation.needed;
    generation.sequence.cut(needed);
    ran.map(|()| generation.out)
}

impl Generation<'_> {
    fn run(
        &mut self,
        grammar: &mut Option<GrammarState>,
        sampler: &mut Sampler,
        end_tokens: &[u32],
        on_tokens: &mut dyn FnMut(&[u32]),
    ) -> Result<(), MllmError> {
        loop {
            if let Some(grammar) = grammar {
                let mut fast_forwarded = grammar.take_fast_forwarded()?;
                let left = self.budget - self.out.ids.len();
                let cut = fast_forwarded.len() > left;
                fast_forwarded.truncate(left);
                self.push_fast_forwarded(&fast_forwarded);
                on_tokens(&self.out.ids);
                // An answer that the budget cuts is not complete, even if the grammar has nothing
                // left to ask.
                if grammar.is_complete() && !cut {
                    self.out.finish = FinishReason::Complete;
                    return Ok(());
                }
            }
            if self.out.ids.len() >= self.budget {
                return Ok(());
            }
            let allowed = grammar.as_mut().map(GrammarState::allowed).transpose()?;
            let given = self
                .search
                .as_ref()
                .and_then(|search| search.given(self.out.ids.len()));
            let (token, sampled) = match given.or_else(|| allowed.as_ref().and_then(only_token)) {
                Some(token) => (token, false),
                None => (
                    self.choose(sampler, grammar.as_mut(), allowed.as_ref())?,
                    true,
                ),
            };
            if end_tokens.contains(&token) {
                self.out.finish = FinishReason::EndOfSequence;
                return Ok(());
            }
            if sampled {
                self.push_sampled(token);
            } else {
                self.push_fast_forwarded(&[token]);
            }
            on_tokens(&self.out.ids);
            if let Some(grammar) = grammar {
                grammar.consume(&[token])?;
            }
        }
    }

    /// Samples a token, from logits that are computed already, or else by a pass over the pending
    /// tokens and a draft.
    fn choose(
        &mut self,
        sampler: &mut Sampler,
        grammar: Option<&mut GrammarState>,
        allowed: Option<&SimpleVob>,
    ) -> Result<u32, MllmError> {
        let logits = match self.ahead.take_logits(&self.pending) {
            Some(logits) => logits,
            None => self.compute(grammar)?,
        };
        self.needed = self.ahead.start() + self.pending.len();
        // An answer has no image, so the placeholder is never sampled.
        let (banned, position) = (self.model.info().image_token, self.needed.saturating_sub(1));
        if self.search.is_none() && self.out.log_probability.is_none() {
            return sampler.choose(logits, allowed, banned, position);
        }
        let token = sampler.choose(logits.clone(), allowed, banned, position)?;
        if let Some(search) = &mut self.search {
            search.note(&self.out.ids, token, &logits, allowed, banned);
        }
        if let (Some(log), Some(chosen)) =
            (&mut self.out.log_probability, logits.get(token as usize))
        {
            *log += f64::from(*chosen) - log_total(&logits, allowed, banned);
        }
        Ok(token)
    }

    /// Computes the pending tokens with a draft of those that may follow; gives the logits after
    /// the pending ones.
    fn compute(&mut self, grammar: Option<&mut GrammarState>) -> Result<Vec<f32>, MllmError> {
        self.settle();
        let pass_start = Instant::now();
        let draft = self.draft(grammar)?;
        let tokens = [self.pending.as_slice(), &draft].concat();
        let wanted = Logits::Tail(1 + draft.len());
        let appended = self.sequence.append_in_passes(
            self.model,
            &tokens,
            self.features,
            wanted,
            self.deadline,
        );
        if appended.is_err() {
            // The passes before the failed one had no draft.
            self.needed = self.sequence.ids().len();
        }
        let logits = appended?;
        if self.passes == 0 {
            self.out.prefill = milliseconds(pass_start.elapsed());
            self.out.prefill_end = milliseconds(self.start.elapsed());
        }
        self.passes += 1;
        self.out.drafted += draft.len();
        self.pending.clear();
        let mut rows = logits
            .as_ref()
            .map_or_else(|| Ok(Vec::new()), Tensor::to_vec2)?
            .into_iter();
        let first = rows.next().ok_or(MllmError::MissingLogits {
            position: self.sequence.ids().len(),
        })?;
        self.ahead = Ahead::new(
            self.sequence.ids().len() - draft.len(),
            draft,
            rows.collect(),
        );
        Ok(first)
    }

    /// Gives up what was computed ahead and is not what was chosen; the pending tokens are then
    /// those that are not computed.
    fn settle(&mut self) {
        let accepted = self.ahead.accepted(&self.pending);
        if let Some(drafter) = &mut self.drafter {
            drafter.learn(self.ahead.len(), accepted);
        }
        self.out.accepted += accepted;
        self.pending.drain(..accepted);
        if self.ahead.len() > 0 {
            let again = self.sequence.cut(self.ahead.start() + accepted);
            self.pending.splice(..0, again);
        }
        self.ahead = Ahead::default();
    }

    /// Tokens that may follow the pending ones, and that the grammar allows. None where a pass of
    /// several tokens could give other numbers than passes of one.
    fn draft(&mut self, grammar: Option<&mut GrammarState>) -> Result<Vec<u32>, MllmError> {
        let Some(drafter) = &mut self.drafter else {
            return Ok(Vec::new());
        };
        let exact = self
            .model
            .decoder()
            .exact_pass()
            .saturating_sub(self.pending.len());
        let limit = exact.min((self.budget - self.out.ids.len()).saturating_sub(1));
        if limit == 0 {
            return Ok(Vec::new());
        }
        let chat = [self.sequence.ids(), &self.pending].concat();
        let mut draft = drafter.draft(
            &chat,
            &self.out.ids,
            self.model.info().image_token,
            limit,
            self.deadline,
        )?;
        let vocabulary = self.model.info().vocabulary;
        // A draft may come from another model, whose vocabulary may be larger.
        let known = draft
            .iter()
            .take_while(|token| (**token as usize) < vocabulary)
            .count();
        draft.truncate(known);
        if let Some(grammar) = grammar {
            draft.truncate(grammar.allowed_prefix(&draft)?);
        }
        Ok(draft)
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
