//! Rotary position embedding.

use candle_core::{Device, Result, Tensor};

use crate::mllm::checkpoint::{LlamaConfig, Rope, RopeScaling};

/// Cosines and sines of every position, shape (context, head width / 2) each.
#[derive(Debug)]
pub(crate) struct RotaryTable {
    cos: Tensor,
    sin: Tensor,
}

/// Cosines and sines of the rows of one pass, shape (tokens, head width / 2) each.
#[derive(Debug)]
pub(crate) struct RotaryRows {
    cos: Tensor,
    sin: Tensor,
}

impl RotaryTable {
    /// The table of a decoder.
    pub(crate) fn new(config: &LlamaConfig) -> Result<Self> {
        let frequencies = frequencies(&config.rope, config.head_dim);
        let shape = (config.context, frequencies.len());
        let angles = |function: fn(f32) -> f32| -> Vec<f32> {
            (0..config.context)
                .flat_map(|position| frequencies.iter().map(move |frequency| function(position as f32 * frequency)))
                .collect()
        };
        Ok(Self {
            cos: Tensor::from_vec(angles(f32::cos), shape, &Device::Cpu)?,
            sin: Tensor::from_vec(angles(f32::sin), shape, &Device::Cpu)?,
        })
    }

    /// The angles of rows at these positions, each below the context.
    pub(crate) fn rows(&self, positions: &[u32]) -> Result<RotaryRows> {
        let positions = Tensor::new(positions, &Device::Cpu)?;
        Ok(RotaryRows { cos: self.cos.index_select(&positions, 0)?, sin: self.sin.index_select(&positions, 0)? })
    }
}

impl RotaryRows {
    /// Rotates queries or keys of shape (1, tokens, heads, head width).
    pub(crate) fn rotate(&self, x: &Tensor) -> Result<Tensor> {
        candle_nn::rotary_emb::rope_thd(x, &self.cos, &self.sin)
    }
}

/// Angle per position of each pair of channels, f32 as in transformers.
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
