//! Layer normalization.

use super::matrix::{Instructions, Kernel, LANES, Simd};
use super::values::row_by_row;
use candle_core::{Result, Tensor};

/// (x − mean) / sqrt(variance + ε) · weight + bias over the last dimension, in f32.
///
/// Computes the mean first, then the variance, both summed in f64. candle-nn computes the variance
/// as E(x²) − E(x)² in f32, which loses digits where the mean is large.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    eps: f64,
}

impl LayerNorm {
    /// Of a weight and a bias of the same length.
    pub fn new(weight: Vec<f32>, bias: Vec<f32>, eps: f64) -> Self {
        Self { weight, bias, eps }
    }

    /// Applies the norm to (…, width).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let width = self.weight.len();
        row_by_row(x, width, width, |out, x| {
            Instructions::best().run(Rows { norm: self, x, out });
        })
    }
}

/// Normalizes whole rows.
struct Rows<'a> {
    norm: &'a LayerNorm,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl Kernel for Rows<'_> {
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        reason = "kernels must be inlined into the functions that enable the instructions"
    )]
    fn run<S: Simd>(self, _: S) {
        let LayerNorm { weight, bias, eps } = self.norm;
        let width = weight.len();
        for (out, row) in self
            .out
            .chunks_exact_mut(width)
            .zip(self.x.chunks_exact(width))
        {
            let mean = sum_of(row, |value| value) / width as f64;
            let squares = sum_of(row, |value| (value - mean) * (value - mean));
            let scale = 1.0 / (squares / width as f64 + eps).sqrt();
            for (((out, value), weight), bias) in out.iter_mut().zip(row).zip(weight).zip(bias) {
                *out = ((f64::from(*value) - mean) * scale) as f32 * weight + bias;
            }
        }
    }
}

#[inline(always)]
#[allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]
fn sum_of(row: &[f32], function: impl Fn(f64) -> f64) -> f64 {
    let (whole, rest) = row.as_chunks::<LANES>();
    let mut sums = [0f64; LANES];
    for values in whole {
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += function(f64::from(*value));
        }
    }
    sums.iter().sum::<f64>()
        + rest
            .iter()
            .map(|value| function(f64::from(*value)))
            .sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn a_large_mean_costs_no_digits() {
        let norm = LayerNorm {
            weight: vec![2.0, 1.0, 1.0, 1.0],
            bias: vec![0.5, 0.0, 0.0, 0.0],
            eps: 1e-5,
        };
        // torch.nn.functional.layer_norm in f64 of both rows gives the same: the second is the
        // first plus 4096.
        let rows = [[0.0f32, 1.0, 2.0, 3.0], [4096.0, 4097.0, 4098.0, 4099.0]];
        let x = Tensor::new(&rows, &Device::Cpu).unwrap();
        let y = norm.forward(&x).unwrap().to_vec2::<f32>().unwrap();
        for row in y {
            for (value, expected) in
                row.into_iter()
                    .zip([-2.183_271, -0.447_211_8, 0.447_211_8, 1.341_635_4])
            {
                assert!((value - expected).abs() < 1e-6, "{value} {expected}");
            }
        }
        assert!(
            norm.forward(&Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap())
                .is_err()
        );
    }
}
