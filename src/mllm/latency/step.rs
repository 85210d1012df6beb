//! The steps of a planning call.

use planagent_kernels::Work;
use serde::{Deserialize, Serialize};

/// A step of a planning call. Appended tokens are computed together by the next step that needs
/// their result, as in a conversation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Keeps this number of tokens of the sequence and drops the rest.
    Keep(usize),
    /// Encodes a new image: preprocessing, vision tower, projector.
    Encode,
    /// Appends the image's tokens.
    Image,
    /// Appends tokens of a prompt.
    Text(usize),
    /// Appends tokens of an answer that the grammar fast-forwards.
    FastForwarded(usize),
    /// Samples this number of tokens, one after the other; the last one is appended and not
    /// computed yet.
    Sampled(usize),
    /// Computes the appended tokens with `drafted` ones in one pass, keeps those of them that are
    /// accepted, and samples the token after these. That token is appended and not computed yet.
    Verified { drafted: usize, accepted: usize },
    /// Computes the appended tokens and samples nothing.
    Compute,
}

/// Forward passes of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PassTime {
    /// Computed tokens.
    pub tokens: usize,
    /// Wall time, milliseconds.
    pub ms: f64,
    /// Products; none where an engine does not count them.
    #[serde(default)]
    pub work: Work,
}

impl PassTime {
    /// Tokens a second; none without tokens or time.
    pub fn rate(&self) -> Option<f64> {
        (self.tokens > 0 && self.ms > 0.0).then(|| self.tokens as f64 * 1e3 / self.ms)
    }
}

impl std::ops::AddAssign for PassTime {
    fn add_assign(&mut self, other: Self) {
        self.tokens += other.tokens;
        self.ms += other.ms;
        self.work += other.work;
    }
}

/// Wall time of a step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepTime {
    /// The whole step, milliseconds.
    pub ms: f64,
    /// From its start to the first sampled token, milliseconds; none if none was sampled.
    pub first_token_ms: Option<f64>,
    /// Passes of several tokens.
    pub batch: PassTime,
    /// Passes of one token.
    pub single: PassTime,
    /// Products of the whole step.
    #[serde(default)]
    pub work: Work,
}

impl StepTime {
    /// Adds a pass over some tokens.
    pub fn add_pass(&mut self, pass: PassTime) {
        match pass.tokens {
            0 => {}
            1 => self.single += pass,
            _ => self.batch += pass,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_written_in_a_word_and_a_number() {
        let steps = [
            Step::Keep(3),
            Step::Encode,
            Step::Image,
            Step::Text(9),
            Step::FastForwarded(2),
            Step::Sampled(4),
            Step::Verified {
                drafted: 4,
                accepted: 1,
            },
            Step::Compute,
        ];
        let text = serde_json::to_string(&steps).unwrap();
        assert_eq!(
            text,
            r#"[{"keep":3},"encode","image",{"text":9},{"fast_forwarded":2},{"sampled":4},{"verified":{"drafted":4,"accepted":1}},"compute"]"#
        );
        assert_eq!(serde_json::from_str::<Vec<Step>>(&text).unwrap(), steps);
    }

    #[test]
    fn passes_are_told_apart_by_their_tokens() {
        let mut time = StepTime::default();
        let pass = |tokens, ms, operations| PassTime {
            tokens,
            ms,
            work: Work {
                operations,
                bytes: 7,
            },
        };
        for (tokens, ms) in [(0, 9.0), (1, 2.0), (8, 4.0), (1, 3.0)] {
            time.add_pass(pass(tokens, ms, 10));
        }
        let two = PassTime {
            work: Work {
                operations: 20,
                bytes: 14,
            },
            ..pass(2, 5.0, 0)
        };
        assert_eq!((time.batch, time.single), (pass(8, 4.0, 10), two));
        assert_eq!(time.batch.rate(), Some(2000.0));
        assert_eq!(PassTime::default().rate(), None);
    }
}
