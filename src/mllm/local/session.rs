//! A conversation with a model.

use super::LocalModel;
use super::draft::Drafter;
use super::draft_model::Drafting;
use super::generate::{End, Generated, generate};
use super::images::Images;
use super::likeliest::Search;
use super::sequence::Sequence;
use super::thinking::{ThinkingBounds, ThinkingText};
use crate::family::{Chat, ImageLayout};
use crate::sampling::{Sampler, answer_seed};
use crate::{
    Answer, Constraint, ConstraintUse, Conversation, Mark, MllmError, PromptPrefix, Request,
    RoundTime, Sampling, TokenCounts, Turn, milliseconds, prompt_hash,
};
use image::RgbImage;
use std::sync::Arc;
use std::time::Instant;

/// A chat and its computed tokens.
///
/// Each round renders the whole chat with the model's template, keeps the computed tokens that
/// agree, and computes the rest. So the template alone decides what the model reads, and nothing is
/// computed twice across rounds and rewinds.
pub(super) struct LocalConversation<'a> {
    local: &'a LocalModel,
    /// The system prompt; empty for none.
    system: String,
    images: Images,
    seed: u64,
    answers: u64,
    turns: Vec<Turn>,
    sequence: Sequence,
    /// Of the draft model, if there is one.
    drafting: Option<Drafting>,
    /// Time spent on the system prompt before the first round, milliseconds.
    prefix_time: f64,
}

impl<'a> LocalConversation<'a> {
    /// Opens a conversation and computes or fetches the tokens before the image.
    pub(super) fn open(
        local: &'a LocalModel,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Self, MllmError> {
        let start = Instant::now();
        let (images, image) = Images::of_prefix(&*local.model, prefix.image.as_ref())?;
        let computed = local.call_prefix(&prefix.system, image)?;
        Ok(Self {
            local,
            system: prefix.system.clone(),
            images,
            seed,
            answers: 0,
            turns: Vec::new(),
            sequence: computed.sequence.clone(),
            drafting: local.draft_model.as_ref().map(Drafting::new),
            prefix_time: milliseconds(start.elapsed()),
        })
    }

    fn decode(&self, request: &Request, ids: &[u32]) -> Result<String, MllmError> {
        match request.constraint {
            Constraint::Free => self.local.tokenizer.decode(ids),
            // The grammar constrains the bytes of the tokens, so these are the answer.
            _ => Ok(self.local.tokenizer.decode_verbatim(ids)),
        }
    }
}

/// What several answers to a prompt cost together. The first one computes the prompt; the later
/// ones find it cached, at no cost.
#[derive(Default)]
struct Cost {
    first: Option<(TokenCounts, RoundTime)>,
    sampled: usize,
    total: f64,
}

impl Cost {
    fn add(&mut self, answer: &Answer) {
        self.first.get_or_insert((answer.tokens, answer.time));
        self.sampled += answer.tokens.sampled;
        self.total += answer.time.total;
    }

    fn write_into(self, answer: &mut Answer) {
        let Some((tokens, time)) = self.first else {
            return;
        };
        answer.tokens = TokenCounts {
            sampled: self.sampled,
            ..tokens
        };
        let later = self.total - time.total;
        answer.time = RoundTime {
            decode: time.decode + later,
            total: self.total,
            ..time
        };
    }
}

/// The text of an answer that has been handed on.
#[derive(Default)]
struct Spoken {
    text: String,
}

impl Spoken {
    /// What is new in the text so far. Nothing while its last character is incomplete.
    fn new_part<'t>(&mut self, text: &'t str) -> &'t str {
        if text.ends_with(char::REPLACEMENT_CHARACTER) {
            return "";
        }
        let new = text.strip_prefix(self.text.as_str()).unwrap_or_default();
        self.text.push_str(new);
        new
    }
}

impl Conversation for LocalConversation<'_> {
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError> {
        self.generate(prompt, request, None, None)
    }

    fn ask_aloud(
        &mut self,
        prompt: &str,
        request: &Request,
        on_text: &mut dyn FnMut(&str),
    ) -> Result<Answer, MllmError> {
        self.generate(prompt, request, Some(on_text), None)
    }

    /// The token of each place is the likeliest one, whatever the request's sampling is; drafts are
    /// not used.
    fn ask_likeliest(
        &mut self,
        prompt: &str,
        request: &Request,
        count: usize,
    ) -> Result<Vec<Answer>, MllmError> {
        let request = Request {
            sampling: Sampling::Greedy,
            draft: None,
            ..request.clone()
        };
        let (before, mut search) = (self.mark(), Search::new(count));
        let mut sum = Cost::default();
        loop {
            let answer = self.generate(prompt, &request, None, Some(&mut search))?;
            self.rewind(before);
            sum.add(&answer);
            if !search.turn_to_next(answer) {
                break;
            }
        }
        let mut answers = search.into_answers();
        if let Some(likeliest) = answers.first_mut() {
            // The user waits for the whole search, so its cost is that of the answer that is kept.
            sum.write_into(likeliest);
            self.turns.push(Turn {
                prompt: prompt.to_string(),
                answer: likeliest.text.clone(),
            });
        }
        Ok(answers)
    }

    fn show(&mut self, images: &[Arc<RgbImage>]) -> Result<(), MllmError> {
        self.images
            .show(&*self.local.model, images, self.turns.len())
    }

    fn mark(&self) -> Mark {
        Mark {
            turns: self.turns.len(),
            images: self.images.later(),
        }
    }

    fn rewind(&mut self, mark: Mark) {
        // The computed tokens stay; the next round keeps those that still agree.
        self.turns.truncate(mark.turns);
        self.images.rewind(mark.images, self.turns.len());
    }
}

impl LocalConversation<'_> {
    /// Lets the model think after the prompt, if it does.
    fn think(
        &mut self,
        rest: &[u32],
        request: &Request,
        context: usize,
        start: Instant,
    ) -> Result<Option<ThinkingText>, MllmError> {
        let local = self.local;
        let Some(thinking) = &local.thinking else {
            return Ok(None);
        };
        // Another stream of random numbers than that of the answer.
        let seed = answer_seed(!self.seed, self.answers);
        let bounds = ThinkingBounds {
            ends: &local.end_tokens,
            context,
            deadline: request.deadline,
            start,
        };
        let reasoned = thinking.think(
            &*local.model,
            &mut self.sequence,
            self.images.features(),
            rest,
            Sampler::new(request.sampling, seed)?,
            bounds,
        )?;
        Ok(Some(reasoned))
    }

    fn generate(
        &mut self,
        prompt: &str,
        request: &Request,
        mut on_text: Option<&mut dyn FnMut(&str)>,
        search: Option<&mut Search>,
    ) -> Result<Answer, MllmError> {
        let start = Instant::now();
        request.deadline.check()?;
        let local = self.local;
        let image_token = local.model.info().image_token;
        let sampler = Sampler::new(request.sampling, answer_seed(self.seed, self.answers))?;
        let grammar = local.grammars.begin(&request.constraint)?;
        let images = self.images.lay_out(&*local.model, &mut self.sequence)?;
        let layouts: Vec<ImageLayout> = images.iter().map(|image| image.layout).collect();
        let context = local.context(layouts.iter().map(|layout| layout.tokens).sum());
        let chat = Chat {
            system: &self.system,
            images: &images,
            turns: &self.turns,
            prompt,
        };
        let ids = local.prompt_ids(&chat)?;
        if ids.len() >= context {
            return Err(MllmError::PromptTooLong {
                tokens: ids.len(),
                context,
            });
        }
        let cached = self.sequence.begin(&*local.model, &ids, &layouts);
        let rest = &ids[cached..];

        let encode_start = Instant::now();
        let image_encode = if self.images.encode(&*local.model, rest)? {
            milliseconds(encode_start.elapsed())
        } else {
            0.0
        };

        let mut spoken = Spoken::default();
        let free = request.constraint == Constraint::Free;
        let mut speak = |ids: &[u32]| {
            let Some(on_text) = &mut on_text else { return };
            // A text that cannot be decoded yet is handed on with what follows.
            let so_far = if free {
                local.tokenizer.decode(ids)
            } else {
                Ok(local.tokenizer.decode_verbatim(ids))
            };
            let new = so_far
                .map(|text| spoken.new_part(&text).to_owned())
                .unwrap_or_default();
            if !new.is_empty() {
                on_text(&new);
            }
        };
        let reasoned = self.think(rest, request, context, start)?;
        // What the answer follows.
        let before = reasoned
            .as_ref()
            .map_or(&[][..], |reasoned| reasoned.ids.as_slice());
        let whole = [ids.as_slice(), before].concat();
        let computed_so_far = if reasoned.is_some() {
            let agree = self.sequence.agree(&whole);
            self.sequence.cut(agree.min(whole.len().saturating_sub(1)));
            self.sequence.ids().len()
        } else {
            cached
        };
        let generated: Generated = generate(
            &*local.model,
            &mut self.sequence,
            self.images.features(),
            &whole[computed_so_far..],
            grammar,
            sampler,
            request
                .draft
                .as_deref()
                .map(|earlier| Drafter::new(earlier, self.drafting.as_mut())),
            search,
            &End {
                tokens: &local.end_tokens,
                max_new_tokens: request.max_new_tokens,
                context,
                deadline: request.deadline,
            },
            start,
            &mut speak,
        )?;
        let text = self.decode(request, &generated.ids)?;
        if let Some(on_text) = on_text {
            let rest = text.strip_prefix(spoken.text.as_str()).unwrap_or_default();
            if !rest.is_empty() {
                on_text(rest);
            }
        }
        let computed = rest
            .get(..self.sequence.ids().len() - cached)
            .unwrap_or(rest);
        let image_tokens = computed.iter().filter(|id| **id == image_token).count();
        let prefix_time = std::mem::take(&mut self.prefix_time);
        let [prefill, prefill_end, first_token] = match &reasoned {
            Some(reasoned) => [reasoned.prefill, reasoned.prefill_end, reasoned.first_token],
            None => [
                generated.prefill,
                generated.prefill_end,
                generated.first_token,
            ],
        };
        let answer = Answer {
            prompt_hash: prompt_hash(&self.system, &self.turns, prompt),
            tokens: TokenCounts {
                text: computed.len() - image_tokens,
                image: image_tokens,
                cached,
                fast_forwarded: generated.fast_forwarded,
                sampled: generated.ids.len() - generated.fast_forwarded
                    + reasoned.as_ref().map_or(0, |reasoned| reasoned.sampled),
                drafted: generated.drafted,
                accepted: generated.accepted,
            },
            time: RoundTime {
                image_encode,
                prefill: prefix_time + prefill,
                first_token: if first_token > 0.0 {
                    prefix_time + first_token
                } else {
                    0.0
                },
                decode: milliseconds(start.elapsed()) - prefill_end,
                remote: 0.0,
                total: prefix_time + milliseconds(start.elapsed()),
            },
            log_probability: generated.log_probability,
            finish: generated.finish,
            constraint: match request.constraint {
                Constraint::Free => ConstraintUse::Unconstrained,
                _ => ConstraintUse::Enforced,
            },
            text,
            ids: generated.ids,
        };
        self.turns.push(Turn {
            prompt: prompt.to_string(),
            answer: answer.text.clone(),
        });
        self.answers += 1;
        Ok(answer)
    }
}

#[cfg(test)]
mod tests {
    use super::Spoken;

    #[test]
    fn a_text_is_handed_on_in_whole_characters_and_once() {
        let mut spoken = Spoken::default();
        let said: Vec<&str> = ["A", "A \u{fffd}", "A ü", "A ü"]
            .into_iter()
            .map(|text| spoken.new_part(text))
            .collect();
        assert_eq!(said, ["A", "", " ü", ""]);
    }
}
