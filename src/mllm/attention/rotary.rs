//! Rotary position embeddings.

use crate::mllm::checkpoint::{LlamaConfig, Rope, RopeScaling};

/// Cosines and sines of every position of a context.
#[derive(Debug)]
pub(crate) struct RotaryTable {
    /// (context, head width / 2)
    angles: Vec<Turn>,
    pairs: usize,
}

/// Cosines and sines of the rows of one pass.
#[derive(Debug)]
pub(crate) struct RotaryRows {
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

impl RotaryTable {
    pub(crate) fn new(config: &LlamaConfig) -> Self {
        let frequencies = frequencies(&config.rope, config.head_dim);
        let angles = (0..config.context)
            .flat_map(|position| frequencies.iter().map(move |frequency| position as f32 * frequency))
            .map(|angle| Turn { cos: angle.cos(), sin: angle.sin() })
            .collect();
        Self { angles, pairs: frequencies.len() }
    }

    pub(crate) fn rows(&self, positions: &[u32]) -> candle_core::Result<RotaryRows> {
        let mut angles = Vec::with_capacity(positions.len() * self.pairs);
        for position in positions {
            let Some(row) = self.angles.chunks_exact(self.pairs).nth(*position as usize) else {
                candle_core::bail!("position {position} is outside the context");
            };
            angles.extend_from_slice(row);
        }
        Ok(RotaryRows { angles, pairs: self.pairs })
    }
}

impl RotaryRows {
    pub(super) fn fits(&self, tokens: usize, width: usize) -> bool {
        self.pairs * 2 == width && self.angles.len() == tokens * self.pairs
    }

    /// Rotates a query or key by its token's angles and scales it. Channels i and i + width / 2 form a pair, as in
    /// transformers.
    pub(super) fn rotate(&self, token: usize, head: &[f32], scale: f32, out: &mut [f32]) {
        let (first, second) = head.split_at(self.pairs);
        let (first_out, second_out) = out.split_at_mut(self.pairs);
        let turns = &self.angles[token * self.pairs..(token + 1) * self.pairs];
        let pairs = first.iter().zip(second).zip(first_out.iter_mut().zip(second_out)).zip(turns);
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

/// Scaling of one frequency (`ROPE_INIT_FUNCTIONS` in transformers).
fn scaled(frequency: f64, scaling: RopeScaling) -> f64 {
    match scaling {
        RopeScaling::None => frequency,
        RopeScaling::Linear { factor } => frequency / factor,
        RopeScaling::Llama3 { factor, low_freq_factor, high_freq_factor, original_context } => {
            let wavelength = 2.0 * std::f64::consts::PI / frequency;
            if wavelength > original_context / low_freq_factor {
                frequency / factor
            } else if wavelength < original_context / high_freq_factor {
                frequency
            } else {
                let smooth = (original_context / wavelength - low_freq_factor) / (high_freq_factor - low_freq_factor);
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
        let rope = Rope { theta: 10_000.0, scaling: RopeScaling::None };
        let frequencies = frequencies(&rope, 8);
        for (frequency, expected) in frequencies.iter().zip([1.0, 0.1, 0.01, 0.001]) {
            assert!((frequency - expected).abs() < 1e-7);
        }
    }

    #[test]
    fn llama3_keeps_high_and_divides_low_frequencies() {
        let scaling =
            RopeScaling::Llama3 { factor: 8.0, low_freq_factor: 1.0, high_freq_factor: 4.0, original_context: 8192.0 };
        assert!((scaled(1.0, scaling) - 1.0).abs() < 1e-12);
        assert!((scaled(1e-5, scaling) - 1.25e-6).abs() < 1e-12);
        // torch: _compute_llama3_parameters at wavelength 4096: smooth = (2 - 1) / 3.
        let middle = 2.0 * std::f64::consts::PI / 4096.0;
        let expected = middle * (2.0 / 3.0 / 8.0 + 1.0 / 3.0);
        assert!((scaled(middle, scaling) - expected).abs() < 1e-12);
    }
}
