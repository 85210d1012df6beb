//! The likeliest answers to a prompt, by a search over the tokens that were not chosen.
//!
//! An answer is as likely as the product of its tokens' probabilities, and each of its beginnings
//! is at least as likely. So the likeliest beginning that was left open is completed next. The
//! search ends when the answers found are likelier than every beginning that is left: best-first
//! search, as in A* with nothing to estimate.

use crate::Answer;
use crate::sampling::{log_total, may_follow};
use toktrie::SimpleVob;

/// Alternatives to a chosen token that are kept: more than any choice in a planner code has.
const MAX_ALTERNATIVES: usize = 64;
/// Completed answers for one that is wanted, at most. A flat distribution has many beginnings that
/// are equally likely.
const MAX_COMPLETED: usize = 8;

/// The beginning of an answer, with the logarithm of its probability.
#[derive(Debug, Clone, Default)]
struct Beginning {
    tokens: Vec<u32>,
    log_probability: f64,
}

/// A search for the likeliest answers.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// What the answer that is being generated begins with.
    given: Vec<u32>,
    /// The logarithm of the probability of that answer so far.
    log_probability: f64,
    open: Vec<Beginning>,
    answers: Vec<(f64, Answer)>,
    completed: usize,
    /// Number of answers that are wanted.
    count: usize,
}

impl Search {
    pub(super) fn new(count: usize) -> Self {
        Self {
            count,
            ..Self::default()
        }
    }

    /// The token that the answer has at this place, where its beginning is given.
    pub(super) fn given(&self, place: usize) -> Option<u32> {
        self.given.get(place).copied()
    }

    /// Notes that `chosen` follows `answer`, and the alternatives.
    pub(super) fn note(
        &mut self,
        answer: &[u32],
        chosen: u32,
        logits: &[f32],
        allowed: Option<&SimpleVob>,
        banned: u32,
    ) {
        let total = log_total(logits, allowed, banned);
        let mut others: Vec<(f64, u32)> = logits
            .iter()
            .zip(0..)
            .filter(|(_, token)| *token != chosen && may_follow(*token, allowed, banned))
            .map(|(logit, token)| (f64::from(*logit), token))
            .collect();
        others.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (logit, token) in others.into_iter().take(MAX_ALTERNATIVES) {
            let tokens = [answer, &[token]].concat();
            self.open.push(Beginning {
                tokens,
                log_probability: self.log_probability + logit - total,
            });
        }
        let chosen = logits
            .get(chosen as usize)
            .map_or(f64::NEG_INFINITY, |logit| f64::from(*logit));
        self.log_probability += chosen - total;
    }

    /// Keeps a completed answer and turns to the likeliest beginning that is left; `false` when the
    /// likeliest answers are found.
    pub(super) fn turn_to_next(&mut self, mut answer: Answer) -> bool {
        self.completed += 1;
        // Its beginning was given, so that the answer itself counts the rest alone.
        answer.log_probability = Some(self.log_probability);
        // A text can be spelled with other tokens; its likeliest spelling counts.
        match self
            .answers
            .iter_mut()
            .find(|(_, known)| known.text == answer.text)
        {
            Some(known) if known.0 < self.log_probability => {
                *known = (self.log_probability, answer);
            }
            Some(_) => {}
            None => self.answers.push((self.log_probability, answer)),
        }
        self.answers.sort_by(|a, b| b.0.total_cmp(&a.0));
        let needed = self
            .count
            .checked_sub(1)
            .and_then(|last| self.answers.get(last))
            .map(|(found, _)| *found);
        let likeliest = (0..self.open.len())
            .rev()
            .max_by(|a, b| self.likelihood(*a).total_cmp(&self.likelihood(*b)));
        let Some(next) =
            likeliest.filter(|next| needed.is_none_or(|needed| self.likelihood(*next) > needed))
        else {
            return false;
        };
        let Beginning {
            tokens,
            log_probability,
        } = self.open.swap_remove(next);
        (self.given, self.log_probability) = (tokens, log_probability);
        self.completed < self.count * MAX_COMPLETED
    }

    /// The likeliest answers, the likeliest first.
    pub(super) fn into_answers(self) -> Vec<Answer> {
        self.answers
            .into_iter()
            .take(self.count)
            .map(|(_, answer)| answer)
            .collect()
    }

    fn likelihood(&self, open: usize) -> f64 {
        self.open
            .get(open)
            .map_or(f64::NEG_INFINITY, |beginning| beginning.log_probability)
    }
}
