//! Rotary position embeddings.

use super::frequencies::{extended, frequencies, magnitude};
use super::rope::{Rope, RopeScaling, RotarySections};

/// A position on three axes: time, height, width. Text, and families with one position a token,
/// have three equal numbers.
pub type Position = [u32; 3];

/// Frequencies of the pairs of a head's channels, for the positions of a context. Channels behind
/// the last pair are not turned.
#[derive(Debug)]
pub struct RotaryEmbedding {
    pairs: Vec<Pair>,
    context: usize,
    rope: Rope,
}

/// Two channels of a head that are rotated together.
#[derive(Debug, Clone, Copy)]
struct Pair {
    /// Angle per position.
    frequency: f32,
    /// The axis of the position that it is rotated by.
    axis: usize,
}

/// Cosines and sines of the rows of one pass.
#[derive(Debug, Clone)]
pub struct RotaryRows {
    /// (tokens, pairs)
    angles: Vec<Turn>,
    pairs: usize,
    /// Parts of a head that turn apart, each with as many pairs.
    parts: usize,
}

/// Cosine and sine of an angle.
#[derive(Debug, Clone, Copy)]
struct Turn {
    cos: f32,
    sin: f32,
}

impl Turn {
    fn by(angle: f32) -> Self {
        Self {
            cos: angle.cos(),
            sin: angle.sin(),
        }
    }

    fn scaled(self, factor: f32) -> Self {
        Self {
            cos: self.cos * factor,
            sin: self.sin * factor,
        }
    }
}

impl RotaryEmbedding {
    /// Of the positions below `context` and heads whose first `rotated` channels are turned.
    pub fn new(rope: &Rope, rotated: usize, context: usize) -> Self {
        let frequencies = frequencies(rope, rotated);
        let axis = |pair| rope.sections.map_or(0, |sections| axis(sections, pair));
        let pairs = frequencies
            .iter()
            .enumerate()
            .map(|(pair, frequency)| Pair {
                frequency: *frequency,
                axis: axis(pair),
            });
        Self {
            pairs: pairs.collect(),
            context,
            rope: *rope,
        }
    }

    /// The length that the angles of a prompt depend on which ends before position `end`: 0 within
    /// the context of the training, and where no prompt changes the frequencies.
    pub fn length(&self, end: usize) -> usize {
        match self.rope.scaling {
            RopeScaling::Dynamic {
                original_context, ..
            } if end as f64 > original_context => end,
            _ => 0,
        }
    }

    /// The same with each frequency divided by a factor, which must be positive.
    pub fn divided_by(mut self, factors: &[f32]) -> Self {
        for (pair, factor) in self.pairs.iter_mut().zip(factors) {
            pair.frequency = if *factor > 0.0 {
                pair.frequency / factor
            } else {
                f32::NAN
            };
        }
        self
    }

    /// The angles of positions in a prompt that ends before position `end`; a row behind it ends
    /// the prompt itself.
    ///
    /// # Errors
    /// When a position is outside the context, or a factor not positive.
    pub fn rows(&self, positions: &[Position], end: usize) -> candle_core::Result<RotaryRows> {
        if let Some(pair) = self
            .pairs
            .iter()
            .position(|pair| !pair.frequency.is_finite())
        {
            candle_core::bail!("rope_freqs.weight: the factor of pair {pair} is not positive");
        }
        let magnitude = magnitude(&self.rope);
        let mut angles = Vec::with_capacity(positions.len() * self.pairs.len());
        let (mut length, mut pairs) = (0, self.pairs.clone());
        for position in positions {
            if position.iter().any(|axis| *axis as usize >= self.context) {
                candle_core::bail!("position {position:?} is outside the context");
            }
            let needed = self.length(end.max(position_end(position)));
            if needed != length {
                (length, pairs) = (needed, self.pairs_of_length(needed));
            }
            angles.extend(pairs.iter().map(|pair| {
                Turn::by(position[pair.axis] as f32 * pair.frequency).scaled(magnitude)
            }));
        }
        Ok(RotaryRows {
            angles,
            pairs: self.pairs.len(),
            parts: 1,
        })
    }

    /// The pairs for a prompt of this length, as [`Self::length`] gives it.
    fn pairs_of_length(&self, length: usize) -> Vec<Pair> {
        if length == 0 {
            return self.pairs.clone();
        }
        let extended = frequencies(
            &extended(&self.rope, 2 * self.pairs.len(), length),
            2 * self.pairs.len(),
        );
        let with = |(pair, frequency): (&Pair, f32)| Pair { frequency, ..*pair };
        self.pairs.iter().zip(extended).map(with).collect()
    }
}

/// The position behind all axes of a position.
pub fn position_end(position: &Position) -> usize {
    position.iter().max().map_or(0, |last| *last as usize + 1)
}

/// The axis of a pair (`apply_multimodal_rotary_pos_emb` and `apply_interleaved_mrope` in
/// transformers).
fn axis(sections: RotarySections, pair: usize) -> usize {
    let RotarySections {
        lengths,
        interleaved,
    } = sections;
    if interleaved {
        let axis = pair % 3;
        if pair < 3 * lengths[axis] { axis } else { 0 }
    } else if pair < lengths[0] {
        0
    } else {
        1 + usize::from(pair >= lengths[0] + lengths[1])
    }
}

impl RotaryRows {
    /// Angles of patches by row and column, for heads of `width` channels: the first half of the
    /// pairs turns by the row, the second by the column.
    pub fn of_patches(patches: impl Iterator<Item = [usize; 2]>, width: usize, base: f64) -> Self {
        let pairs = width / 2;
        let frequencies: Vec<f32> = (0..pairs / 2)
            .map(|pair| (1.0 / base.powf(2.0 * pair as f64 / pairs as f64)) as f32)
            .collect();
        let angles = patches
            .flat_map(|[row, column]| {
                let turned = |place: usize| {
                    frequencies
                        .iter()
                        .map(move |frequency| Turn::by(place as f32 * frequency))
                };
                turned(row).chain(turned(column)).collect::<Vec<_>>()
            })
            .collect();
        Self {
            angles,
            pairs,
            parts: 1,
        }
    }

    /// The same angles for heads whose halves turn apart: each half has pairs of its own.
    #[must_use]
    pub fn by_halves(self) -> Self {
        Self { parts: 2, ..self }
    }

    /// The angles of some of the rows.
    pub fn of_rows(&self, rows: std::ops::Range<usize>) -> Self {
        let angles = self
            .angles
            .get(rows.start * self.pairs..rows.end * self.pairs)
            .expect("the rows are rows of the table")
            .to_vec();
        Self { angles, ..*self }
    }

    pub(super) fn fits(&self, tokens: usize, width: usize) -> bool {
        self.pairs * 2 <= width
            && self.pairs.is_multiple_of(self.parts)
            && self.angles.len() == tokens * self.pairs
    }

    /// Rotates a query or key by its token's angles and scales it. In each part, channels i and i +
    /// (number of its pairs) form a pair, as in transformers; those behind the parts are only scaled.
    pub(super) fn rotate(&self, token: usize, head: &[f32], scale: f32, out: &mut [f32]) {
        let (turned, kept) = head.split_at(2 * self.pairs);
        let (turned_out, kept_out) = out.split_at_mut(2 * self.pairs);
        for (out, value) in kept_out.iter_mut().zip(kept) {
            *out = value * scale;
        }
        let turns = &self.angles[token * self.pairs..(token + 1) * self.pairs];
        let pairs = self.pairs / self.parts;
        for ((turned, out), turns) in turned
            .chunks_exact((2 * pairs).max(1))
            .zip(turned_out.chunks_exact_mut((2 * pairs).max(1)))
            .zip(turns.chunks_exact(pairs.max(1)))
        {
            let (first, second) = turned.split_at(pairs);
            let (first_out, second_out) = out.split_at_mut(pairs);
            let pairs = first
                .iter()
                .zip(second)
                .zip(first_out.iter_mut().zip(second_out))
                .zip(turns);
            for (((a, b), (a_out, b_out)), turn) in pairs {
                *a_out = (a * turn.cos - b * turn.sin) * scale;
                *b_out = (a * turn.sin + b * turn.cos) * scale;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_share_the_pairs_among_three_axes() {
        let axes = |lengths, interleaved, pairs| -> Vec<usize> {
            (0..pairs)
                .map(|pair| {
                    axis(
                        RotarySections {
                            lengths,
                            interleaved,
                        },
                        pair,
                    )
                })
                .collect()
        };
        assert_eq!(axes([2, 3, 3], false, 8), [0, 0, 1, 1, 1, 2, 2, 2]);
        assert_eq!(axes([4, 2, 2], true, 8), [0, 1, 2, 0, 1, 2, 0, 0]);
        // Qwen3-VL: 24 for time, 20 each for height and width.
        let published = axes([24, 20, 20], true, 64);
        assert_eq!(
            [0, 1, 2].map(|axis| published.iter().filter(|found| **found == axis).count()),
            [24, 20, 20]
        );
    }

    #[test]
    fn channels_behind_the_pairs_are_only_scaled() {
        let rows = |width| {
            let table = RotaryEmbedding::new(&Rope::default(), width, 64);
            table.rows(&[[5; 3]], 0).unwrap()
        };
        let head = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
        let (mut part, mut whole) = ([0.0; 8], [0.0; 4]);
        assert!(rows(4).fits(1, 8) && !rows(8).fits(1, 4));
        rows(4).rotate(0, &head, 2.0, &mut part);
        rows(4).rotate(0, &head[..4], 2.0, &mut whole);
        assert_eq!(part[..4], whole);
        assert_eq!(part[4..], [10.0, 12.0, 14.0, 16.0]);
    }

    #[test]
    fn halves_of_a_head_turn_apart() {
        let patches = || [[3, 5]].into_iter();
        let whole = RotaryRows::of_patches(patches(), 8, 100.0);
        let apart = RotaryRows::of_patches(patches(), 8, 100.0).by_halves();
        let head = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
        // First quarters and then second ones turn as a whole.
        let quarters = [1.0, 2.0, 5.0, 6.0, 3.0, 4.0, 7.0, 8.0];
        let (mut expected, mut found) = ([0.0; 8], [0.0; 8]);
        whole.rotate(0, &quarters, 1.0, &mut expected);
        apart.rotate(0, &head, 1.0, &mut found);
        assert!(apart.fits(1, 8));
        for (at, from) in [0, 1, 4, 5, 2, 3, 6, 7].into_iter().enumerate() {
            assert_eq!(found[at].to_bits(), expected[from].to_bits(), "{at}");
        }
    }

    #[test]
    fn factors_divide_frequencies_and_must_be_positive() {
        let plain = RotaryEmbedding::new(&Rope::default(), 8, 64);
        let factors = [1.0, 2.0, 4.0, 8.0];
        let divided = RotaryEmbedding::new(&Rope::default(), 8, 64).divided_by(&factors);
        for ((found, plain), factor) in divided.pairs.iter().zip(&plain.pairs).zip(factors) {
            assert!((found.frequency * factor / plain.frequency - 1.0).abs() < 1e-6);
        }
        assert!(divided.rows(&[[3; 3]], 0).is_ok());
        assert!(plain.divided_by(&[0.0]).rows(&[[3; 3]], 0).is_err());
    }

    #[test]
    fn a_row_of_a_prompt_turns_by_the_length_of_the_prompt() {
        let rope = Rope {
            scaling: RopeScaling::Dynamic {
                factor: 2.0,
                original_context: 16.0,
            },
            ..Rope::default()
        };
        let table = RotaryEmbedding::new(&rope, 8, 64);
        assert_eq!([0, 16, 17].map(|end| table.length(end)), [0, 0, 17]);
        let second = |position: u32, end| {
            let rows = table.rows(&[[position; 3]], end).unwrap();
            rows.angles[1].sin
        };
        let sine = |position: u32, length: f64| {
            let base = 10_000.0 * (2.0 * length / 16.0 - 1.0).powf(8.0 / 6.0);
            (f64::from(position) / base.powf(0.25)).sin() as f32
        };
        for (position, end, length) in [(3, 0, 16.0), (3, 16, 16.0), (3, 40, 40.0)] {
            assert!((second(position, end) - sine(position, length)).abs() < 1e-6);
        }
        // A token behind the prompt ends it itself.
        assert!((second(30, 20) - sine(30, 31.0)).abs() < 1e-6);
        assert!((second(30, 40) - sine(30, 40.0)).abs() < 1e-6);
    }
}
