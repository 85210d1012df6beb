//! How near the logits and tokens of two engines are.

use super::engine::EngineName;
use serde::{Deserialize, Serialize};

/// The answers of two engines to the same prompts of random tokens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    pub model: String,
    /// The other engine.
    pub engine: EngineName,
    /// Number of prompts.
    pub prompts: usize,
    /// Largest difference of two logits behind a prompt.
    pub largest: f64,
    /// Root mean square of these differences.
    pub rms: f64,
    /// Prompts behind which both have the same likeliest token.
    pub same_first: usize,
    /// Tokens of all answers up to the first other one.
    pub same_tokens: usize,
    /// Tokens of all answers.
    pub tokens: usize,
}

/// The logits behind a prompt, and the tokens that follow.
pub(super) type Answered = (Vec<f32>, Vec<u32>);

impl Agreement {
    /// Compares answers, ours and theirs to each prompt.
    ///
    /// # Errors
    /// When the engines have different vocabularies.
    pub(super) fn between(
        model: &str,
        engine: EngineName,
        pairs: &[(Answered, Answered)],
    ) -> Result<Self, String> {
        let mut found = Self {
            model: model.to_owned(),
            engine,
            prompts: pairs.len(),
            largest: 0.0,
            rms: 0.0,
            same_first: 0,
            same_tokens: 0,
            tokens: 0,
        };
        let (mut squares, mut count) = (0.0, 0_usize);
        for ((ours, our_tokens), (theirs, their_tokens)) in pairs {
            if ours.len() != theirs.len() {
                return Err(format!(
                    "the engines give {} and {} logits",
                    ours.len(),
                    theirs.len()
                ));
            }
            for (own, other) in ours.iter().zip(theirs) {
                let apart = f64::from(own - other).abs();
                found.largest = found.largest.max(apart);
                squares += apart * apart;
            }
            count += ours.len();
            // Up to the first difference: from there on, both engines continue other texts.
            let same = our_tokens
                .iter()
                .zip(their_tokens)
                .take_while(|(own, other)| own == other)
                .count();
            found.same_first += usize::from(same > 0);
            found.same_tokens += same;
            found.tokens += our_tokens.len();
        }
        found.rms = (squares / count.max(1) as f64).sqrt();
        Ok(found)
    }

    /// The comparison in words.
    pub fn in_words(&self) -> String {
        format!(
            "{}: {}: logits differ by at most {:.1e}, rms {:.1e}; the likeliest token is the same behind {} of {} prompts, \
             {} of {} tokens are the same up to the first other one",
            self.model,
            self.engine,
            self.largest,
            self.rms,
            self.same_first,
            self.prompts,
            self.same_tokens,
            self.tokens
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_compared_up_to_the_first_other_token() {
        let ours = (vec![1.0, 2.0], vec![1, 5, 6]);
        let theirs = (vec![1.5, 2.0], vec![1, 5, 7]);
        let found = Agreement::between(
            "m",
            EngineName::Candle,
            &[(ours.clone(), theirs), (ours.clone(), ours.clone())],
        )
        .unwrap();
        assert!((found.largest - 0.5).abs() < 1e-9 && (found.rms - 0.25).abs() < 1e-9);
        assert_eq!(
            (found.same_first, found.same_tokens, found.tokens),
            (2, 5, 6)
        );
        let wide = (vec![0.0; 3], vec![1]);
        assert!(Agreement::between("m", EngineName::Candle, &[(ours, wide)]).is_err());
    }
}
