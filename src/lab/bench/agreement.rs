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
    /// How near the numbers of a picture's tokens are; none for a model that reads text alone, and
    /// for an engine without a vision tower.
    #[serde(default)]
    pub picture: Option<PictureAgreement>,
}

/// A picture of ramps, encoded by two engines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PictureAgreement {
    /// Its tokens, ours and theirs.
    pub tokens: [usize; 2],
    /// Largest difference of two numbers as a share of the largest number, and 1 - cosine of the
    /// angle between all numbers. None where the engines make another number of tokens.
    pub apart: Option<[f64; 2]>,
}

/// The number of a picture's tokens, and the numbers of some of them.
pub(super) type Encoded = (usize, Vec<f32>);

impl PictureAgreement {
    /// Compares a picture's tokens, ours and theirs.
    pub(super) fn between((own, ours): &Encoded, (other, theirs): &Encoded) -> Self {
        Self {
            tokens: [*own, *other],
            apart: (own == other && ours.len() == theirs.len()).then(|| apart(ours, theirs)),
        }
    }

    /// The comparison in words.
    fn in_words(&self) -> String {
        let [own, other] = self.tokens;
        match self.apart {
            None => format!(
                "a picture becomes {own} tokens here and {other} there, which are not compared"
            ),
            Some([largest, cosine]) => format!(
                "the numbers of a picture's {own} tokens differ by at most {largest:.1e} of the largest, by {cosine:.1e} \
                 in cosine distance"
            ),
        }
    }
}

fn apart(ours: &[f32], theirs: &[f32]) -> [f64; 2] {
    let (mut difference, mut most) = (0_f64, f64::MIN_POSITIVE);
    let (mut product, mut own_square, mut other_square) = (0_f64, 0_f64, 0_f64);
    for (own, other) in ours.iter().zip(theirs) {
        let (own, other) = (f64::from(*own), f64::from(*other));
        difference = difference.max((own - other).abs());
        most = most.max(own.abs());
        product += own * other;
        own_square += own * own;
        other_square += other * other;
    }
    let lengths = (own_square * other_square).sqrt().max(f64::MIN_POSITIVE);
    [difference / most, 1.0 - product / lengths]
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
            picture: None,
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
        let picture = self.picture.as_ref();
        let picture =
            picture.map_or_else(String::new, |picture| format!("; {}", picture.in_words()));
        format!(
            "{}: {}: logits differ by at most {:.1e}, rms {:.1e}; the likeliest token is the same behind {} of {} prompts, \
             {} of {} tokens are the same up to the first other one{picture}",
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
        assert!(!found.in_words().contains("picture"));
        let wide = (vec![0.0; 3], vec![1]);
        assert!(Agreement::between("m", EngineName::Candle, &[(ours, wide)]).is_err());
    }

    #[test]
    fn a_picture_is_compared_where_it_becomes_as_many_tokens() {
        let near = PictureAgreement::between(&(2, vec![3.0, 4.0]), &(2, vec![3.0, 3.6]));
        let [largest, cosine] = near.apart.unwrap();
        assert!((largest - 0.1).abs() < 1e-6 && (cosine - 0.001_3).abs() < 1e-4);
        let other = PictureAgreement::between(&(2, vec![3.0, 4.0]), &(3, vec![3.0, 4.0]));
        assert_eq!(other.apart, None);
        assert!(other.in_words().contains("2 tokens here and 3 there"));
    }
}
