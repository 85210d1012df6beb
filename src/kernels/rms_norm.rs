//! Root mean square normalization.

use super::matrix::{Instructions, Kernel, LANES, Simd};
use super::values::{both_row_by_row, row_by_row};
use candle_core::{Result, Tensor, bail};

/// x / sqrt(mean(x²) + ε) · weight over the last dimension (Zhang and Sennrich, arXiv:1910.07467).
#[derive(Debug)]
pub struct RmsNorm {
    weight: Vec<f32>,
    eps: f32,
}

impl RmsNorm {
    /// Of a weight.
    pub fn new(weight: Vec<f32>, eps: f64) -> Self {
        Self {
            weight,
            eps: eps as f32,
        }
    }

    /// The norm with a factor for each number of a row.
    ///
    /// # Errors
    /// When there are not as many factors as numbers.
    pub fn scaled(self, factors: &Tensor) -> Result<Self> {
        let width = self.width();
        if factors.dims() != [width] {
            bail!("{:?} factors for rows of {width} numbers", factors.shape());
        }
        let factors = factors.to_vec1::<f32>()?;
        let weight = self.weight.iter().zip(factors).map(|(w, f)| w * f);
        Ok(Self {
            weight: weight.collect(),
            ..self
        })
    }

    /// Numbers of a row.
    pub fn width(&self) -> usize {
        self.weight.len()
    }

    /// Applies the norm to (rows, width).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let width = self.weight.len();
        row_by_row(x, width, width, |out, x| {
            let residual = None;
            Instructions::best().run(Rows {
                norm: self,
                x,
                residual,
                out,
            });
        })
    }

    /// residual + norm(x), both (rows, width).
    pub fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        both_row_by_row(x, residual, self.weight.len(), |out, x, residual| {
            let residual = Some(residual);
            Instructions::best().run(Rows {
                norm: self,
                x,
                residual,
                out,
            });
        })
    }
}

/// Normalizes whole rows.
struct Rows<'a> {
    norm: &'a RmsNorm,
    x: &'a [f32],
    residual: Option<&'a [f32]>,
    out: &'a mut [f32],
}

impl Kernel for Rows<'_> {
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        reason = "kernels must be inlined into the functions that enable the instructions"
    )]
    fn run<S: Simd>(self, _: S) {
        let RmsNorm { weight, eps } = self.norm;
        for (out, row) in self
            .out
            .chunks_exact_mut(weight.len())
            .zip(self.x.chunks_exact(weight.len()))
        {
            let (whole, rest) = row.as_chunks::<LANES>();
            let mut squares = [0f32; LANES];
            for values in whole {
                for (square, value) in squares.iter_mut().zip(values) {
                    *square += value * value;
                }
            }
            let sum =
                squares.iter().sum::<f32>() + rest.iter().map(|value| value * value).sum::<f32>();
            let scale = 1.0 / (sum / row.len() as f32 + eps).sqrt();
            for ((out, value), weight) in out.iter_mut().zip(row).zip(weight) {
                *out = value * scale * weight;
            }
        }
        if let Some(residual) = self.residual {
            for (out, residual) in self.out.iter_mut().zip(residual) {
                *out += residual;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn rows_are_divided_by_their_root_mean_square() {
        let width = 37;
        let weight: Vec<f32> = (0..width).map(|index| 0.5 + index as f32 * 0.1).collect();
        let norm = RmsNorm {
            weight: weight.clone(),
            eps: 1e-5,
        };
        let values: Vec<f32> = (0..2500 * width)
            .map(|index| (index as f32 * 0.7).sin() * 3.0)
            .collect();
        let x = Tensor::from_vec(values.clone(), (2500, width), &Device::Cpu).unwrap();
        let found = norm.forward(&x).unwrap();
        let onto = norm.forward_onto(&x, &x).unwrap();
        let rows = |x: &Tensor| x.to_vec2::<f32>().unwrap();
        assert_eq!(rows(&onto), rows(&(&found + &x).unwrap()));
        let twice = Tensor::full(2f32, width, &Device::Cpu).unwrap();
        let scaled = RmsNorm::new(weight.clone(), 1e-5).scaled(&twice).unwrap();
        let expected = (&found * 2.0).unwrap();
        assert_eq!(rows(&scaled.forward(&x).unwrap()), rows(&expected));
        assert!(scaled.scaled(&x).is_err());
        let found = rows(&found);
        for (row, found) in values.chunks(width).zip(found) {
            let mean = row
                .iter()
                .map(|value| f64::from(*value).powi(2))
                .sum::<f64>()
                / width as f64;
            for ((value, weight), found) in row.iter().zip(&weight).zip(found) {
                let expected = f64::from(*value) / (mean + 1e-5).sqrt() * f64::from(*weight);
                assert!(
                    (f64::from(found) - expected).abs() <= 1e-6 * expected.abs(),
                    "{found} {expected}"
                );
            }
        }
        assert!(
            norm.forward(&Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap())
                .is_err()
        );
    }
}
