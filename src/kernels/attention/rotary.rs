//! Rotary position embeddings.

use super::rope::{Rope, RopeScaling, RotarySections};

/// A position on three axes: time, height, width. Text, and families with one position a token,
/// have three equal numbers.
pub type Position = [u32; 3];

/// Frequencies of the pairs of a head's channels, for the positions of a context.
#[derive(Debug)]
pub struct RotaryEmbedding {
    pairs: Vec<Pair>,
    context: usize,
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
    /// (tokens, head width / 2)
    angles: Vec<Turn>,
    pairs: usize,
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
}

impl RotaryEmbedding {
    /// Of heads of this width and the positions below `context`.
    pub fn new(rope: &Rope, head_width: usize, context: usize) -> Self {
        let frequencies = frequencies(rope, head_width);
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

    /// The angles of positions.
    ///
    /// # Errors
    /// When a position is outside the context, or a factor not positive.
    pub fn rows(&self, positions: &[Position]) -> candle_core::Result<RotaryRows> {
        if let Some(pair) = self
            .pairs
            .iter()
            .position(|pair| !pair.frequency.is_finite())
        {
            candle_core::bail!("rope_freqs.weight: the factor of pair {pair} is not positive");
        }
        let mut angles = Vec::with_capacity(positions.len() * self.pairs.len());
        for position in positions {
            if position.iter().any(|axis| *axis as usize >= self.context) {
                candle_core::bail!("position {position:?} is outside the context");
            }
            angles.extend(
                self.pairs
                    .iter()
                    .map(|pair| Turn::by(position[pair.axis] as f32 * pair.frequency)),
            );
        }
        Ok(RotaryRows {
            angles,
            pairs: self.pairs.len(),
        })
    }
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
        Self { angles, pairs }
    }

    /// The angles of some of the rows.
    pub fn of_rows(&self, rows: std::ops::Range<usize>) -> Self {
        let angles = self
            .angles
            .get(rows.start * self.pairs..rows.end * self.pairs)
            .expect("the rows are rows of the table")
            .to_vec();
        Self {
            angles,
            pairs: self.pairs,
        }
    }

    pub(super) fn fits(&self, tokens: usize, width: usize) -> bool {
        self.pairs * 2 == width && self.angles.len() == tokens * self.pairs
    }

    /// Rotates a query or key by its token's angles and scales it. Channels i and i + width / 2
    /// form a pair, as in transformers.
    pub(super) fn rotate(&self, token: usize, head: &[f32], scale: f32, out: &mut [f32]) {
        let (first, second) = head.split_at(self.pairs);
        let (first_out, second_out) = out.split_at_mut(self.pairs);
        let turns = &self.angles[token * self.pairs..(token + 1) * self.pairs];
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

/// Angle per position of each pair of channels, rounded to f32 as in transformers.
fn frequencies(rope: &Rope, head_dim: usize) -> Vec<f32> {
    (0..head_dim / 2)
        .map(|pair| {
            let base = 1.0 / rope.theta.powf(2.0 * pair as f64 / head_dim as f64);
            scaled(base, rope.scaling) as f32
        })
        .collect()
}

/// The divisor of each pair's frequency, where a configuration scales them one by one (Llama 3.1).
pub fn frequency_factors(rope: &Rope, head_dim: usize) -> Option<Vec<f32>> {
    matches!(rope.scaling, RopeScaling::Llama3 { .. }).then(|| {
        let unscaled = frequencies(
            &Rope {
                scaling: RopeScaling::None,
                ..*rope
            },
            head_dim,
        );
        unscaled
            .iter()
            .zip(frequencies(rope, head_dim))
            .map(|(unscaled, scaled)| unscaled / scaled)
            .collect()
    })
}

/// Scaling of one frequency (`ROPE_INIT_FUNCTIONS` in transformers).
fn scaled(frequency: f64, scaling: RopeScaling) -> f64 {
    match scaling {
        RopeScaling::None => frequency,
        RopeScaling::Linear { factor } => frequency / factor,
        RopeScaling::Llama3 {
            factor,
            low_freq_factor,
            high_freq_factor,
            original_context,
        } => {
            let wavelength = 2.0 * std::f64::consts::PI / frequency;
            if wavelength > original_context / low_freq_factor {
                frequency / factor
            } else if wavelength < original_context / high_freq_factor {
                frequency
            } else {
                let smooth = (original_context / wavelength - low_freq_factor)
                    / (high_freq_factor - low_freq_factor);
                (1.0 - smooth) * frequency / factor + smooth * frequency
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_fall_from_one_by_the_base() {
        let rope = Rope {
            theta: 10_000.0,
            scaling: RopeScaling::None,
            sections: None,
        };
        let frequencies = frequencies(&rope, 8);
        for (frequency, expected) in frequencies.iter().zip([1.0, 0.1, 0.01, 0.001]) {
            assert!((frequency - expected).abs() < 1e-7);
        }
    }

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
    fn factors_of_frequencies_scale_as_the_configuration() {
        let scaling = RopeScaling::Llama3 {
            factor: 8.0,
            low_freq_factor: 1.0,
            high_freq_factor: 4.0,
            original_context: 8192.0,
        };
        let rope = Rope {
            theta: 500_000.0,
            scaling,
            sections: None,
        };
        let factors = frequency_factors(&rope, 128).unwrap();
        assert!(
            (factors[0] - 1.0).abs() < 1e-6 && (factors[63] - 8.0).abs() < 1e-4,
            "{factors:?}"
        );
        let plain = Rope {
            scaling: RopeScaling::None,
            ..rope
        };
        let divided = RotaryEmbedding::new(&plain, 128, 2048).divided_by(&factors);
        for (found, expected) in divided
            .pairs
            .iter()
            .zip(&RotaryEmbedding::new(&rope, 128, 2048).pairs)
        {
            assert!((found.frequency / expected.frequency - 1.0).abs() < 1e-6);
        }
        assert!(divided.rows(&[[3; 3]]).is_ok());
        assert!(
            RotaryEmbedding::new(&plain, 128, 2048)
                .divided_by(&[0.0])
                .rows(&[[3; 3]])
                .is_err()
        );
        assert!(frequency_factors(&plain, 128).is_none());
    }

    #[test]
    fn llama3_keeps_high_and_divides_low_frequencies() {
        let scaling = RopeScaling::Llama3 {
            factor: 8.0,
            low_freq_factor: 1.0,
            high_freq_factor: 4.0,
            original_context: 8192.0,
        };
        assert!((scaled(1.0, scaling) - 1.0).abs() < 1e-12);
        assert!((scaled(1e-5, scaling) - 1.25e-6).abs() < 1e-12);
        // torch: _compute_llama3_parameters at wavelength 4096: smooth = (2 - 1) / 3.
        let middle = 2.0 * std::f64::consts::PI / 4096.0;
        let expected = middle * (2.0 / 3.0 / 8.0 + 1.0 / 3.0);
        assert!((scaled(middle, scaling) - expected).abs() < 1e-12);
    }
}
