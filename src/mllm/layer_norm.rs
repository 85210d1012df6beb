//! Layer normalisation.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;

use super::MllmError;
use super::checkpoint::Weights;

/// Fewest numbers that are worth waking other threads for.
const PARALLEL: usize = 1 << 16;

/// (x − mean) / sqrt(variance + ε) · weight + bias over the last dimension, in f32.
///
/// Mean and variance are taken one after the other and summed in f64. candle-nn's layer norm takes the variance as
/// E(x²) − E(x)² in f32, which loses digits where the mean is large.
#[derive(Debug)]
pub(crate) struct LayerNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
    eps: f64,
}

impl LayerNorm {
    /// Takes the norm called `name`.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(
        weights: &mut Weights,
        name: &str,
        width: usize,
        eps: f64,
    ) -> std::result::Result<Self, MllmError> {
        let mut vector = |part: &str| -> std::result::Result<Vec<f32>, MllmError> {
            Ok(weights.take(&format!("{name}.{part}"), &[width])?.to_vec1()?)
        };
        Ok(Self { weight: vector("weight")?, bias: vector("bias")?, eps })
    }

    /// Applies the norm to (rows, width).
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        x.contiguous()?.apply_op1_no_bwd(&Rows(self))
    }

    fn normalise(&self, row: &[f32], out: &mut [f32]) {
        let width = row.len() as f64;
        let mean = row.iter().map(|value| f64::from(*value)).sum::<f64>() / width;
        let squares = row.iter().map(|value| (f64::from(*value) - mean).powi(2)).sum::<f64>();
        let scale = 1.0 / (squares / width + self.eps).sqrt();
        for (((out, value), weight), bias) in out.iter_mut().zip(row).zip(&self.weight).zip(&self.bias) {
            *out = ((f64::from(*value) - mean) * scale) as f32 * weight + bias;
        }
    }
}

/// The norm as an operation on tensors.
struct Rows<'a>(&'a LayerNorm);

impl CustomOp1 for Rows<'_> {
    fn name(&self) -> &'static str {
        "layer-norm"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let CpuStorage::F32(values) = storage else {
            bail!("layer norm of numbers that are not f32");
        };
        let Some((start, end)) = layout.contiguous_offsets() else {
            bail!("layer norm of a tensor that is not contiguous");
        };
        let width = self.0.weight.len();
        if layout.dims().last() != Some(&width) {
            bail!("layer norm of width {width} on shape {:?}", layout.shape());
        }
        let Some(values) = values.get(start..end) else {
            bail!("layer norm beyond the end of a tensor");
        };
        let mut out = vec![0f32; values.len()];
        if values.len() < PARALLEL {
            out.chunks_mut(width).zip(values.chunks(width)).for_each(|(out, row)| self.0.normalise(row, out));
        } else {
            out.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| self.0.normalise(row, out));
        }
        Ok((CpuStorage::F32(out), layout.shape().clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn a_large_mean_costs_no_digits() {
        let norm = LayerNorm { weight: vec![2.0, 1.0, 1.0, 1.0], bias: vec![0.5, 0.0, 0.0, 0.0], eps: 1e-5 };
        // torch.nn.functional.layer_norm in f64 of both rows gives the same: the second is the first plus 4096.
        let rows = [[0.0f32, 1.0, 2.0, 3.0], [4096.0, 4097.0, 4098.0, 4099.0]];
        let x = Tensor::new(&rows, &Device::Cpu).unwrap();
        let y = norm.forward(&x).unwrap().to_vec2::<f32>().unwrap();
        for row in y {
            for (value, expected) in row.into_iter().zip([-2.183_271, -0.447_211_8, 0.447_211_8, 1.341_635_4]) {
                assert!((value - expected).abs() < 1e-6, "{value} {expected}");
            }
        }
        assert!(norm.forward(&Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap()).is_err());
    }
}
