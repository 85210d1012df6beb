//! Token counts of a planning call.

use planagent_mllm::{PromptSet, Step};
use serde::{Deserialize, Serialize};

/// The token counts of a planning call. They are the same for every model and engine, whatever its
/// answers would be.
///
/// Rounds, fast-forwarded tokens and cached prefixes are those of
/// [`Reasoning`](planagent_agent::reasoning::Reasoning) with grammars.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CallBudget {
    /// The system prompt with the chat template's tokens. Before the image, it is computed once for
    /// all calls; after the image, in every call.
    pub prefix: usize,
    pub scene: usize,
    /// The reflection's feedback in the first prompt of a later attempt.
    pub feedback: usize,
    pub rounds: Vec<RoundBudget>,
    /// Attempts after the first.
    pub rethinks: usize,
    /// Number of accepted tokens among [`DRAFTED`] drafted ones; `None` for answers without drafts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accepted: Option<usize>,
}

/// Tokens of a draft; fewer where the answer ends before.
pub(crate) const DRAFTED: usize = 4;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundBudget {
    /// The question with the chat template's tokens, without scene text and feedback.
    pub question: usize,
    /// The answer, which no model ends early.
    pub answer: Vec<AnswerPart>,
}

/// A piece of an answer: fast-forwarded tokens, then sampled tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnswerPart {
    pub fast_forwarded: usize,
    pub sampled: usize,
}

impl AnswerPart {
    fn steps(self) -> [Step; 2] {
        [
            Step::FastForwarded(self.fast_forwarded),
            Step::Sampled(self.sampled),
        ]
    }
}

/// The steps of an answer with drafts. The first token comes from the pass over the prompt. Each
/// later pass computes a draft too, accepts the first tokens of it, and samples the token behind
/// them.
fn add_drafted(answer: &[AnswerPart], accepted: usize, steps: &mut Vec<Step>) {
    // Whether each token is sampled.
    let tokens: Vec<bool> = answer
        .iter()
        .flat_map(|part| [(false, part.fast_forwarded), (true, part.sampled)])
        .flat_map(|(sampled, count)| std::iter::repeat_n(sampled, count))
        .collect();
    let mut done = 0;
    let mut is_first = true;
    while done < tokens.len() {
        let fast_forwarded = tokens
            .iter()
            .skip(done)
            .take_while(|sampled| !**sampled)
            .count();
        steps.push(Step::FastForwarded(fast_forwarded));
        done += fast_forwarded;
        let left = tokens.len() - done;
        let drafted = if is_first {
            0
        } else {
            DRAFTED.min(left.saturating_sub(1))
        };
        let accepted = accepted.min(drafted);
        match (left, drafted) {
            (0, _) => break,
            (_, 0) => steps.push(Step::Sampled(1)),
            _ => steps.push(Step::Verified { drafted, accepted }),
        }
        done += accepted + 1;
        is_first = false;
    }
}

/// Position of a family's system prompt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Before the image (the LLaVA families).
    PrefixFirst,
    /// Behind the image (`CogVLM`).
    ImageFirst,
}

impl CallBudget {
    /// The token counts of a prompt set; `docs/latency.md` explains them.
    pub fn for_prompts(prompts: PromptSet) -> Self {
        let accepted = None;
        let part = |(fast_forwarded, sampled)| AnswerPart {
            fast_forwarded,
            sampled,
        };
        match prompts {
            PromptSet::Paper => Self {
                prefix: 665,
                scene: 89,
                feedback: 126,
                rounds: vec![
                    RoundBudget {
                        question: 172,
                        answer: [(0, 204)].map(part).into(),
                    },
                    RoundBudget {
                        question: 81,
                        answer: [(4, 1), (4, 15), (4, 1), (2, 13)].map(part).into(),
                    },
                    RoundBudget {
                        question: 46,
                        answer: [(11, 1), (5, 1), (2, 1), (4, 1), (3, 2), (4, 1), (1, 0)]
                            .map(part)
                            .into(),
                    },
                ],
                rethinks: 1,
                accepted,
            },
            // The answers of the first rounds reach the set's bounds.
            PromptSet::Brief => Self {
                prefix: 250,
                scene: 74,
                feedback: 34,
                rounds: vec![
                    RoundBudget {
                        question: 32,
                        answer: [(3, 1), (3, 1), (4, 1), (4, 1), (4, 16)].map(part).into(),
                    },
                    RoundBudget {
                        question: 31,
                        answer: [(2, 1), (3, 2), (3, 19)].map(part).into(),
                    },
                    RoundBudget {
                        question: 17,
                        answer: [(11, 1), (5, 1), (2, 1), (4, 1), (3, 2), (4, 1), (1, 0)]
                            .map(part)
                            .into(),
                    },
                ],
                rethinks: 0,
                accepted,
            },
            PromptSet::Compact => Self {
                prefix: 3,
                scene: 47,
                feedback: 16,
                rounds: vec![
                    RoundBudget {
                        question: 3,
                        answer: [(1, 1); 15].map(part).into(),
                    },
                    RoundBudget {
                        question: 5,
                        answer: [(1, 1); 4].map(part).into(),
                    },
                    RoundBudget {
                        question: 5,
                        answer: [(2, 1), (1, 1), (1, 1), (1, 1), (1, 1), (1, 0)]
                            .map(part)
                            .into(),
                    },
                ],
                rethinks: 1,
                accepted,
            },
            // The words of the lane graph stay 47, and there are three more questions.
            PromptSet::Compact2 => {
                let mut budget = Self::for_prompts(PromptSet::Compact);
                if let Some(first) = budget.rounds.first_mut() {
                    first.answer = [(1, 1); 18].map(part).into();
                }
                budget
            }
        }
    }

    /// The same call with drafts.
    #[must_use]
    pub(crate) fn with_drafts(self, accepted: usize) -> Self {
        Self {
            accepted: Some(accepted),
            ..self
        }
    }

    /// The share of drafted tokens that is accepted; `None` for answers without drafts.
    pub(crate) fn acceptance(&self) -> Option<f64> {
        self.accepted
            .map(|accepted| accepted as f64 / DRAFTED as f64)
    }

    /// Steps before the first call.
    pub(crate) fn prefix_steps(&self, layout: Layout) -> Vec<Step> {
        match layout {
            Layout::PrefixFirst => vec![Step::Keep(0), Step::Text(self.prefix), Step::Compute],
            Layout::ImageFirst => vec![Step::Keep(0)],
        }
    }

    /// The steps of a call for a model whose image has `image` tokens.
    pub(crate) fn call_steps(&self, layout: Layout, image: usize) -> Vec<Step> {
        let mut steps = match layout {
            // A model that reads text alone.
            Layout::PrefixFirst if image == 0 => vec![Step::Keep(self.prefix)],
            Layout::PrefixFirst => vec![Step::Keep(self.prefix), Step::Encode, Step::Image],
            Layout::ImageFirst => vec![
                Step::Keep(0),
                Step::Encode,
                Step::Image,
                Step::Text(self.prefix),
            ],
        };
        steps.push(Step::Text(self.scene));
        self.add_rounds(&mut steps);
        for _ in 0..self.rethinks {
            // The chats of two attempts share everything up to the end of the lane-graph text.
            steps.extend([
                Step::Keep(self.prefix + image + self.scene),
                Step::Text(self.feedback),
            ]);
            self.add_rounds(&mut steps);
        }
        steps
    }

    fn add_rounds(&self, steps: &mut Vec<Step>) {
        for round in &self.rounds {
            steps.push(Step::Text(round.question));
            match self.accepted {
                Some(accepted) => add_drafted(&round.answer, accepted, steps),
                None => steps.extend(round.answer.iter().flat_map(|part| part.steps())),
            }
        }
        steps.retain(|step| {
            !matches!(
                step,
                Step::Text(0) | Step::FastForwarded(0) | Step::Sampled(0)
            )
        });
    }

    /// Text tokens of the prompts of a call, computed or cached.
    pub(crate) fn prompt_tokens(&self) -> usize {
        let questions: usize = self.rounds.iter().map(|round| round.question).sum();
        self.prefix + self.scene + questions + self.rethinks * (self.feedback + questions)
    }

    /// Maximum length of the sequence without the image, tokens.
    pub fn longest(&self) -> usize {
        let answer = |round: &RoundBudget| {
            round
                .answer
                .iter()
                .map(|part| part.fast_forwarded + part.sampled)
                .sum::<usize>()
        };
        let rounds: usize = self
            .rounds
            .iter()
            .map(|round| round.question + answer(round))
            .sum();
        self.prefix + self.scene + rounds + if self.rethinks > 0 { self.feedback } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> CallBudget {
        let round = |question, fast_forwarded, sampled| RoundBudget {
            question,
            answer: vec![AnswerPart {
                fast_forwarded,
                sampled,
            }],
        };
        CallBudget {
            prefix: 7,
            scene: 5,
            feedback: 3,
            rounds: vec![round(2, 0, 4), round(1, 6, 8)],
            rethinks: 1,
            accepted: None,
        }
    }

    #[test]
    fn a_rethink_keeps_what_two_attempts_have_in_common() {
        let steps = small().call_steps(Layout::PrefixFirst, 16);
        let rounds = [
            Step::Text(2),
            Step::Sampled(4),
            Step::Text(1),
            Step::FastForwarded(6),
            Step::Sampled(8),
        ];
        let first = [Step::Keep(7), Step::Encode, Step::Image, Step::Text(5)];
        let again = [Step::Keep(7 + 16 + 5), Step::Text(3)];
        assert_eq!(steps, [&first[..], &rounds, &again, &rounds].concat());
        let behind = small().call_steps(Layout::ImageFirst, 16);
        assert_eq!(
            behind[..4],
            [Step::Keep(0), Step::Encode, Step::Image, Step::Text(7)]
        );
        assert_eq!(behind[4..], steps[3..]);
    }

    #[test]
    fn a_drafted_answer_has_the_same_tokens_in_fewer_passes() {
        let verified = |drafted, accepted| Step::Verified { drafted, accepted };
        let part = |(fast_forwarded, sampled)| AnswerPart {
            fast_forwarded,
            sampled,
        };
        let steps = |parts: &[(usize, usize)], accepted| {
            let mut steps = Vec::new();
            add_drafted(
                &parts.iter().copied().map(part).collect::<Vec<_>>(),
                accepted,
                &mut steps,
            );
            steps.retain(|step| *step != Step::FastForwarded(0));
            steps
        };
        assert_eq!(
            steps(&[(2, 9)], 3),
            [
                Step::FastForwarded(2),
                Step::Sampled(1),
                verified(4, 3),
                verified(3, 3)
            ]
        );
        assert_eq!(
            steps(&[(0, 3)], 0),
            [Step::Sampled(1), verified(1, 0), Step::Sampled(1)]
        );
        // A fast-forwarded token behind the accepted ones is the one that the step appends.
        assert_eq!(
            steps(&[(1, 1), (1, 1), (1, 1)], 1),
            [
                Step::FastForwarded(1),
                Step::Sampled(1),
                Step::FastForwarded(1),
                verified(2, 1),
                Step::Sampled(1)
            ]
        );
        for prompts in [
            PromptSet::Paper,
            PromptSet::Brief,
            PromptSet::Compact,
            PromptSet::Compact2,
        ] {
            let budget = CallBudget::for_prompts(prompts);
            for accepted in 0..=DRAFTED {
                let drafted = budget
                    .clone()
                    .with_drafts(accepted)
                    .call_steps(Layout::PrefixFirst, 16);
                let tokens = |steps: &[Step]| -> usize {
                    let of = |step: &Step| match step {
                        Step::FastForwarded(tokens) | Step::Sampled(tokens) => *tokens,
                        Step::Verified { accepted, .. } => accepted + 1,
                        _ => 0,
                    };
                    steps.iter().map(of).sum()
                };
                assert_eq!(
                    tokens(&drafted),
                    tokens(&budget.call_steps(Layout::PrefixFirst, 16)),
                    "{prompts:?}"
                );
            }
        }
    }

    #[test]
    fn tokens_are_counted_as_the_steps_append_them() {
        for budget in [
            small(),
            CallBudget::for_prompts(PromptSet::Paper),
            CallBudget::for_prompts(PromptSet::Brief),
            CallBudget::for_prompts(PromptSet::Compact),
            CallBudget::for_prompts(PromptSet::Compact2),
        ] {
            let (mut length, mut longest, mut prompt) = (0, 0, 0);
            let steps = [
                budget.prefix_steps(Layout::PrefixFirst),
                budget.call_steps(Layout::PrefixFirst, 0),
            ];
            for step in steps.concat() {
                match step {
                    Step::Keep(tokens) => length = tokens.min(length),
                    Step::Text(tokens) => {
                        length += tokens;
                        prompt += tokens;
                    }
                    Step::FastForwarded(tokens) | Step::Sampled(tokens) => length += tokens,
                    Step::Encode | Step::Image | Step::Compute | Step::Verified { .. } => {}
                }
                longest = longest.max(length);
            }
            assert_eq!(
                (budget.prompt_tokens(), budget.longest()),
                (prompt, longest)
            );
        }
    }
}
