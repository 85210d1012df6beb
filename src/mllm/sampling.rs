//! Sampling of tokens from logits.

use super::{MllmError, Sampling};
use candle_core::{Device, Tensor};
use candle_transformers::generation::{LogitsProcessor, Sampling as Draw};
use toktrie::SimpleVob;

/// Logits that a search takes together, without an exit between them: as many as some vectors.
const SEARCHED: usize = 64;

pub(crate) enum Sampler {
    /// The most likely token.
    Greedy,
    /// A random token of a seeded generator.
    Draw(Box<LogitsProcessor>),
}

impl Sampling {
    pub(crate) fn check(self) -> Result<(), MllmError> {
        match self {
            Self::Sample { temperature, top_p }
                if !(temperature.is_finite()
                    && temperature > 0.0
                    && top_p > 0.0
                    && top_p <= 1.0) =>
            {
                Err(MllmError::Request {
                    problem: format!(
                        "temperature must be above 0 and top_p in (0, 1], found {temperature} and {top_p}"
                    ),
                })
            }
            Self::Greedy | Self::Sample { .. } => Ok(()),
        }
    }
}

impl Sampler {
    pub(crate) fn new(sampling: Sampling, seed: u64) -> Result<Self, MllmError> {
        sampling.check()?;
        Ok(match sampling {
            Sampling::Greedy => Self::Greedy,
            Sampling::Sample { temperature, top_p } => {
                let draw = Draw::TopP {
                    p: top_p,
                    temperature,
                };
                Self::Draw(Box::new(LogitsProcessor::from_sampling(seed, draw)))
            }
        })
    }

    /// Samples one of the allowed tokens, never `banned`. `position` is the position of the logits
    /// in the chat.
    pub(crate) fn choose(
        &mut self,
        mut logits: Vec<f32>,
        allowed: Option<&SimpleVob>,
        banned: u32,
        position: usize,
    ) -> Result<u32, MllmError> {
        // NaN compares with nothing: a broken model would seem to choose a token.
        if let Some(token) = first_not_finite(&logits) {
            return Err(MllmError::NonFiniteLogits {
                position,
                token,
                value: logits[token],
            });
        }
        if let Some(allowed) = allowed {
            for (token, logit) in logits.iter_mut().enumerate() {
                if !allowed.is_allowed(token as u32) {
                    *logit = f32::NEG_INFINITY;
                }
            }
        }
        if let Some(logit) = logits.get_mut(banned as usize) {
            *logit = f32::NEG_INFINITY;
        }
        let best = most_likely(&logits).ok_or_else(|| MllmError::Request {
            problem: "no token is allowed".into(),
        })?;
        match self {
            Self::Greedy => Ok(best),
            Self::Draw(processor) => {
                let count = logits.len();
                Ok(processor.sample(&Tensor::from_vec(logits, count, &Device::Cpu)?)?)
            }
        }
    }
}

/// The logarithm of the sum of the exponentials of the logits of all allowed tokens but `banned`.
/// Less this, a logit is the logarithm of the token's probability under the grammar, at temperature
/// 1.
pub(crate) fn log_total(logits: &[f32], allowed: Option<&SimpleVob>, banned: u32) -> f64 {
    let weighed = || {
        logits
            .iter()
            .zip(0..)
            .filter(|(_, token)| may_follow(*token, allowed, banned))
            .map(|(logit, _)| f64::from(*logit))
    };
    // The highest logit is taken out, because `exp` of a large one overflows.
    let highest = weighed().fold(f64::NEG_INFINITY, f64::max);
    highest
        + weighed()
            .map(|logit| (logit - highest).exp())
            .sum::<f64>()
            .ln()
}

/// Whether a token is allowed and not banned.
pub(crate) fn may_follow(token: u32, allowed: Option<&SimpleVob>, banned: u32) -> bool {
    token != banned && allowed.is_none_or(|allowed| allowed.is_allowed(token))
}

/// The token of the largest logit, the lowest of equals; `None` if all are minus infinity.
pub(crate) fn most_likely(logits: &[f32]) -> Option<u32> {
    let larger = |most: f32, logit: f32| if logit > most { logit } else { most };
    let mut most = [f32::NEG_INFINITY; SEARCHED];
    let (whole, rest) = logits.as_chunks::<SEARCHED>();
    for logits in whole {
        for (most, logit) in most.iter_mut().zip(logits) {
            *most = larger(*most, *logit);
        }
    }
    let highest = most.iter().chain(rest).copied().reduce(larger)?;
    if highest == f32::NEG_INFINITY {
        return None;
    }
    let token = logits.iter().position(|logit| *logit >= highest)?;
    Some(token as u32)
}

fn first_not_finite(logits: &[f32]) -> Option<usize> {
    // No early exit within a part: the compiler does not vectorize loops with one.
    let are_finite = |logits: &[f32]| logits.iter().fold(true, |all, x| all & x.is_finite());
    let part = logits.chunks(SEARCHED).position(|part| !are_finite(part))?;
    let first = part * SEARCHED;
    let within = logits[first..].iter().position(|x| !x.is_finite())?;
    Some(first + within)
}

/// The seed of an answer, from the conversation's seed (the finalizer of `SplitMix64`).
pub(crate) fn answer_seed(conversation: u64, answer: u64) -> u64 {
    let mut z =
        conversation.wrapping_add(answer.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The most likely token of the tests, which is banned.
    const BANNED: u32 = 4;

    fn only(tokens: &[u32]) -> SimpleVob {
        let mut allowed = SimpleVob::alloc(5);
        for token in tokens {
            allowed.allow_token(*token);
        }
        allowed
    }

    #[test]
    fn greedy_takes_the_first_largest_allowed() {
        let mut sampler = Sampler::new(Sampling::Greedy, 0).unwrap();
        let logits = vec![1.0, 3.0, 2.0, 3.0, 9.0];
        assert_eq!(sampler.choose(logits.clone(), None, BANNED, 0).unwrap(), 1);
        assert_eq!(
            sampler
                .choose(logits.clone(), Some(&only(&[0, 2])), BANNED, 0)
                .unwrap(),
            2
        );
        assert!(matches!(
            sampler.choose(logits, Some(&only(&[])), BANNED, 0),
            Err(MllmError::Request { .. })
        ));
    }

    #[test]
    fn draws_follow_the_seed_and_stay_in_the_nucleus() {
        let draws = |seed, top_p| -> Vec<u32> {
            let mut sampler = Sampler::new(
                Sampling::Sample {
                    temperature: 1.0,
                    top_p,
                },
                seed,
            )
            .unwrap();
            (0..64)
                .map(|_| {
                    sampler
                        .choose(
                            vec![0.0, 2.0, 1.0, 1.5, 9.0],
                            Some(&only(&[0, 1, 3, 4])),
                            BANNED,
                            0,
                        )
                        .unwrap()
                })
                .collect()
        };
        assert_eq!(draws(7, 1.0), draws(7, 1.0));
        assert_ne!(draws(7, 1.0), draws(8, 1.0));
        assert!(draws(7, 1.0).iter().all(|token| [0, 1, 3].contains(token)));
        assert!(draws(7, 0.5).iter().all(|token| *token == 1));
    }

    #[test]
    fn logits_that_are_no_numbers_are_an_error() {
        let mut sampler = Sampler::new(Sampling::Greedy, 0).unwrap();
        let error = sampler
            .choose(vec![0.0, f32::NAN], None, BANNED, 12)
            .unwrap_err();
        assert!(matches!(
            error,
            MllmError::NonFiniteLogits {
                position: 12,
                token: 1,
                ..
            }
        ));
    }

    #[test]
    fn impossible_sampling_is_an_error() {
        for (temperature, top_p) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, 0.0), (1.0, 1.5)] {
            assert!(Sampler::new(Sampling::Sample { temperature, top_p }, 0).is_err());
        }
    }

    #[test]
    fn rows_of_any_length_are_searched_to_their_end() {
        for count in [1, 63, 64, 65, 200] {
            for token in 0..count {
                let mut logits = vec![-1.0; count];
                logits[token] = 2.0;
                // The lowest of equals.
                logits[count - 1] = 2.0;
                assert_eq!(most_likely(&logits), Some(token as u32));
                assert_eq!(first_not_finite(&logits), None);
                for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                    logits[token] = value;
                    assert_eq!(first_not_finite(&logits), Some(token));
                }
            }
            assert_eq!(most_likely(&vec![f32::NEG_INFINITY; count]), None);
            // As a draft model may give it.
            assert_eq!(most_likely(&vec![f32::NAN; count]), None);
        }
        assert_eq!(most_likely(&[]), None);
    }
}
