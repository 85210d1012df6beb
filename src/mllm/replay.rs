//! A backend that answers from a recording, so that a run can be driven again without a model.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::{
    Answer, ConstraintUse, Conversation, FinishReason, Mark, Mllm, MllmError, ModelDescription, Opening, Request,
    RoundTime, TokenCounts, Turn, prompt_hash,
};

/// One recorded answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedAnswer {
    /// Index of the planning call in the recording.
    pub call: usize,
    /// Index of the attempt in the call.
    pub attempt: usize,
    /// Index of the round in the attempt.
    pub round: usize,
    /// [`Answer::prompt_hash`] of the recorded answer.
    pub prompt_hash: String,
    /// [`Opening::image_hash`] of the recorded call; none if it had no image.
    pub image_hash: Option<String>,
    /// The answer.
    pub text: String,
    /// Why it ended.
    pub finish: FinishReason,
    /// What became of its constraint.
    pub constraint: ConstraintUse,
    /// What it cost in tokens.
    pub tokens: TokenCounts,
}

/// Answers every conversation with the next recorded call, in order of call, attempt and round.
///
/// It belongs to one loop: the n-th conversation that is opened gets the n-th call. Prompt and image must be those of the
/// recording, or the answer is refused. Seeds and requests are not looked at.
#[derive(Debug)]
pub struct Replay {
    name: String,
    calls: Vec<Vec<RecordedAnswer>>,
    next_call: AtomicUsize,
}

impl Replay {
    /// A backend that is called `name` and gives these answers.
    pub fn new(name: &str, answers: Vec<RecordedAnswer>) -> Self {
        let mut calls: BTreeMap<usize, Vec<RecordedAnswer>> = BTreeMap::new();
        for answer in answers {
            calls.entry(answer.call).or_default().push(answer);
        }
        let mut calls: Vec<Vec<RecordedAnswer>> = calls.into_values().collect();
        for call in &mut calls {
            call.sort_by_key(|answer| (answer.attempt, answer.round));
        }
        Self { name: name.to_string(), calls, next_call: AtomicUsize::new(0) }
    }
}

impl Mllm for Replay {
    fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self) -> ModelDescription {
        ModelDescription {
            name: self.name.clone(),
            architecture: "replay".into(),
            parameters: 0,
            dtype: String::new(),
            image_size: None,
            image_tokens: 0,
            vocabulary: 0,
            context: 0,
            weights_blake3: String::new(),
            server: None,
        }
    }

    fn converse<'a>(&'a self, opening: &Opening, _seed: u64) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        let call = self.next_call.fetch_add(1, Ordering::Relaxed);
        let answers = self.calls.get(call).ok_or_else(|| MllmError::Replay {
            call,
            attempt: 0,
            round: 0,
            problem: format!("the recording has {} calls", self.calls.len()),
        })?;
        Ok(Box::new(ReplayConversation {
            system: opening.system.clone(),
            image_hash: opening.image_hash(),
            answers,
            next: 0,
            turns: Vec::new(),
        }))
    }
}

/// One recorded call being replayed. A rewind forgets turns, but the recording goes on: what comes behind it is what
/// was answered after the rewind of the recorded run.
struct ReplayConversation<'a> {
    system: String,
    image_hash: Option<String>,
    answers: &'a [RecordedAnswer],
    next: usize,
    turns: Vec<Turn>,
}

impl Conversation for ReplayConversation<'_> {
    fn ask(&mut self, prompt: &str, _request: &Request) -> Result<Answer, MllmError> {
        let start = Instant::now();
        let Some(recorded) = self.answers.get(self.next) else {
            let last = self.answers.last();
            return Err(MllmError::Replay {
                call: last.map_or(0, |last| last.call),
                attempt: last.map_or(0, |last| last.attempt),
                round: last.map_or(0, |last| last.round),
                problem: "the recorded call ends here, but another question is asked".into(),
            });
        };
        let hash = prompt_hash(&self.system, &self.turns, prompt);
        let differs = |what: &str, asked: &str, recorded_hash: &str| MllmError::Replay {
            call: recorded.call,
            attempt: recorded.attempt,
            round: recorded.round,
            problem: format!("the {what} has hash {asked}, the recorded one {recorded_hash}"),
        };
        if hash != recorded.prompt_hash {
            return Err(differs("prompt", &hash, &recorded.prompt_hash));
        }
        if self.image_hash != recorded.image_hash {
            let shown = |hash: &Option<String>| hash.clone().unwrap_or_else(|| "(no image)".into());
            return Err(differs("image", &shown(&self.image_hash), &shown(&recorded.image_hash)));
        }
        self.next += 1;
        self.turns.push(Turn { prompt: prompt.to_string(), answer: recorded.text.clone() });
        Ok(Answer {
            text: recorded.text.clone(),
            tokens: recorded.tokens,
            time: RoundTime { total: start.elapsed().as_secs_f64() * 1e3, ..RoundTime::default() },
            finish: recorded.finish,
            constraint: recorded.constraint,
            prompt_hash: hash,
        })
    }

    fn mark(&self) -> Mark {
        Mark(self.turns.len())
    }

    fn rewind(&mut self, mark: Mark) {
        self.turns.truncate(mark.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mllm::{Constraint, Deadline, Sampling};

    const REQUEST: Request = Request {
        constraint: Constraint::Free,
        max_new_tokens: 1,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
    };

    fn recorded(call: usize, attempt: usize, round: usize, turns: &[Turn], prompt: &str) -> RecordedAnswer {
        RecordedAnswer {
            call,
            attempt,
            round,
            prompt_hash: prompt_hash("system", turns, prompt),
            image_hash: None,
            text: format!("answer {call}.{attempt}.{round}"),
            finish: FinishReason::EndOfSequence,
            constraint: ConstraintUse::Unconstrained,
            tokens: TokenCounts { free: 3, ..TokenCounts::default() },
        }
    }

    fn opening() -> Opening {
        Opening { system: "system".into(), image: None }
    }

    #[test]
    fn calls_and_rounds_come_in_order_whatever_the_order_of_the_recording() {
        let after_first = [Turn { prompt: "a".into(), answer: "answer 4.0.0".into() }];
        let replay = Replay::new(
            "recorded",
            vec![
                recorded(9, 0, 0, &[], "b"),
                recorded(4, 1, 1, &after_first, "retry"),
                recorded(4, 0, 1, &after_first, "next"),
                recorded(4, 0, 0, &[], "a"),
            ],
        );
        let mut first = replay.converse(&opening(), 0).unwrap();
        assert_eq!(first.ask("a", &REQUEST).unwrap().text, "answer 4.0.0");
        let mark = first.mark();
        assert_eq!(first.ask("next", &REQUEST).unwrap().tokens.free, 3);
        first.rewind(mark);
        assert_eq!(first.ask("retry", &REQUEST).unwrap().text, "answer 4.1.1");
        assert!(matches!(first.ask("more", &REQUEST), Err(MllmError::Replay { call: 4, attempt: 1, round: 1, .. })));
        let mut second = replay.converse(&opening(), 0).unwrap();
        assert_eq!(second.ask("b", &REQUEST).unwrap().text, "answer 9.0.0");
        assert!(matches!(replay.converse(&opening(), 0), Err(MllmError::Replay { call: 2, .. })));
    }

    #[test]
    fn another_prompt_or_image_is_refused() {
        let replay = Replay::new("recorded", vec![recorded(0, 0, 0, &[], "a"), recorded(1, 0, 0, &[], "a")]);
        let mut conversation = replay.converse(&opening(), 0).unwrap();
        let error = conversation.ask("b", &REQUEST).unwrap_err();
        assert!(matches!(&error, MllmError::Replay { call: 0, problem, .. } if problem.contains("prompt")), "{error}");
        assert!(conversation.ask("a", &REQUEST).is_ok(), "a refused question leaves the conversation as it was");
        let image = Opening { image: Some(image::RgbImage::new(1, 1)), ..opening() };
        let error = replay.converse(&image, 0).unwrap().ask("a", &REQUEST).unwrap_err();
        assert!(matches!(&error, MllmError::Replay { call: 1, problem, .. } if problem.contains("image")), "{error}");
    }
}
