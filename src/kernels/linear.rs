//! Affine layers.

use super::activation::Activation;
use super::matrix::{Beside, Matrix};
use candle_core::{Result, Tensor, bail};

/// y = s · (x Wᵀ + b) over the last dimension.
#[derive(Debug, Clone)]
pub struct Linear {
    weight: Matrix,
    bias: Option<Tensor>,
    /// Factors of the outputs; none for 1.
    scale: Option<Tensor>,
    /// Least and greatest of the inputs, and of the outputs.
    bounds: Option<[[f32; 2]; 2]>,
}

impl Linear {
    /// Of a matrix of shape (outputs, inputs), and a bias of as many numbers as outputs.
    pub fn from_matrix(weight: Matrix, bias: Option<Tensor>) -> Self {
        Self {
            weight,
            bias,
            scale: None,
            bounds: None,
        }
    }

    /// Of a weight (outputs, inputs), which stays in f32, and a bias.
    ///
    /// # Errors
    /// When the weight is no matrix of f32.
    pub fn from_tensors(weight: &Tensor, bias: Option<Tensor>) -> Result<Self> {
        Ok(Self::from_matrix(Matrix::from_tensor(weight)?, bias))
    }

    /// The layer with a factor for each output, as many numbers.
    #[must_use]
    pub fn scaled(self, scale: Tensor) -> Self {
        Self {
            scale: Some(scale),
            ..self
        }
    }

    /// The layer with its inputs and outputs clamped, each to a least and a greatest number.
    #[must_use]
    pub fn clamped(self, bounds: [[f32; 2]; 2]) -> Self {
        Self {
            bounds: Some(bounds),
            ..self
        }
    }

    /// As [`Matrix::in_two_terms`].
    #[must_use]
    pub fn in_two_terms(self) -> Self {
        Self {
            weight: self.weight.in_two_terms(),
            ..self
        }
    }

    /// Whether products round their inputs, to 8 bits in blocks.
    pub fn rounds_inputs(&self) -> bool {
        self.weight.weight_format().block() > 1
    }

    /// Numbers of a row of the result.
    pub fn outputs(&self) -> usize {
        self.weight.outputs()
    }

    /// Applies the layer to (…, inputs).
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.sum(x, None, None)
    }

    /// residual + layer(x), with a residual of shape (…, outputs).
    pub fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.sum(x, Some(residual), None)
    }

    /// Applies a function to the numbers of [`Self::forward`]. The result is the same as in two
    /// passes.
    pub fn forward_then(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        self.sum(x, None, Some(activation))
    }

    fn sum(
        &self,
        x: &Tensor,
        residual: Option<&Tensor>,
        activation: Option<Activation>,
    ) -> Result<Tensor> {
        if x.rank() == 2 {
            return self.sum_of_rows(x, residual, activation);
        }
        let mut shape = x.dims().to_vec();
        match shape.last_mut() {
            Some(last) if *last == self.weight.inputs() => *last = self.outputs(),
            _ => bail!(
                "cannot apply a layer of {} inputs to {:?}",
                self.weight.inputs(),
                x.shape()
            ),
        }
        let rows = x.elem_count() / self.weight.inputs();
        let x = x.reshape((rows, self.weight.inputs()))?;
        let residual = residual
            .map(|residual| residual.reshape((rows, self.outputs())))
            .transpose()?;
        self.sum_of_rows(&x, residual.as_ref(), activation)?
            .reshape(shape)
    }

    /// As [`Self::sum`], of (rows, inputs).
    fn sum_of_rows(
        &self,
        x: &Tensor,
        residual: Option<&Tensor>,
        activation: Option<Activation>,
    ) -> Result<Tensor> {
        let beside = Beside {
            bias: self.bias.as_ref(),
            scale: self.scale.as_ref(),
            residual,
            bounds: self.bounds,
            activation,
        };
        self.weight.forward_then(x, &beside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::WeightFormat;
    use crate::values::clamp;
    use candle_core::Device;

    /// Activations in the pass of the product are those of a pass of their own, bit for bit: with
    /// columns that fill no vector, few rows and many, and with a second term for what rounding takes.
    #[test]
    fn an_activation_in_the_pass_of_the_product_is_the_same() {
        let numbers = |shape: &[usize], step: usize| {
            let count: usize = shape.iter().product();
            let values: Vec<f32> = (0..count)
                .map(|i| (i * step % 101) as f32 / 50.0 - 1.0)
                .collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let bits = |x: Tensor| {
            let values = x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            values.into_iter().map(f32::to_bits).collect::<Vec<_>>()
        };
        let activations = [
            Activation::Gelu,
            Activation::GeluTanh,
            Activation::QuickGelu,
            Activation::Relu,
            Activation::Silu,
        ];
        let (outputs, inputs) = (70, 320);
        for format in [WeightFormat::F32, WeightFormat::Q8_0] {
            let values = numbers(&[outputs * inputs], 37).to_vec1().unwrap();
            let matrix = Matrix::quantize(&values, outputs, inputs, format).unwrap();
            let bias = numbers(&[outputs], 29);
            let layer = Linear::from_matrix(matrix, Some(bias));
            for layer in [layer.clone(), layer.in_two_terms()] {
                for rows in [1, 2, 13, 40] {
                    let x = numbers(&[rows, inputs], 53);
                    let sums = layer.forward(&x).unwrap();
                    for activation in activations {
                        let apart = activation.forward(&sums).unwrap();
                        let together = layer.forward_then(&x, activation).unwrap();
                        assert_eq!(
                            bits(together),
                            bits(apart),
                            "{format} {rows} {activation:?}"
                        );
                    }
                }
            }
        }
    }

    /// With columns that fill no vector, and with a residual.
    #[test]
    fn a_scale_of_outputs_in_the_pass_of_the_product_is_the_same() {
        let numbers = |shape: &[usize], step: usize| {
            let count: usize = shape.iter().product();
            let values: Vec<f32> = (0..count)
                .map(|i| (i * step % 101) as f32 / 50.0 - 1.0)
                .collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let (outputs, inputs) = (70, 320);
        for format in [WeightFormat::F32, WeightFormat::Q8_0] {
            let values = numbers(&[outputs * inputs], 37).to_vec1().unwrap();
            let matrix = Matrix::quantize(&values, outputs, inputs, format).unwrap();
            let (bias, scale) = (numbers(&[outputs], 29), numbers(&[outputs], 13));
            let layer = Linear::from_matrix(matrix, Some(bias));
            let scaled = layer.clone().scaled(scale.clone());
            for rows in [1, 13, 40] {
                let (x, residual) = (numbers(&[rows, inputs], 53), numbers(&[rows, outputs], 7));
                let apart = layer.forward(&x).unwrap().broadcast_mul(&scale).unwrap();
                let expected = (&residual + apart).unwrap().to_vec2::<f32>().unwrap();
                let found = scaled.forward_onto(&x, &residual).unwrap();
                assert_eq!(found.to_vec2::<f32>().unwrap(), expected, "{format} {rows}");
                let in_two = scaled.clone().in_two_terms();
                let found = in_two.forward_onto(&x, &residual).unwrap();
                let found = found.to_vec2::<f32>().unwrap().concat();
                for (found, expected) in found.iter().zip(expected.concat()) {
                    assert!((found - expected).abs() < 0.2, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn bounds_in_the_pass_of_the_product_are_those_of_passes_of_their_own() {
        let numbers = |shape: &[usize], step: usize| {
            let count: usize = shape.iter().product();
            let values: Vec<f32> = (0..count)
                .map(|i| (i * step % 101) as f32 / 50.0 - 1.0)
                .collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let (outputs, inputs) = (70, 320);
        let bounds = [[-0.5, 0.3], [-1.0, 2.0]];
        for format in [WeightFormat::F32, WeightFormat::Q8_0] {
            let values = numbers(&[outputs * inputs], 37).to_vec1().unwrap();
            let matrix = Matrix::quantize(&values, outputs, inputs, format).unwrap();
            let layer = Linear::from_matrix(matrix, None);
            for layer in [layer.clone(), layer.in_two_terms()] {
                let clamped = layer.clone().clamped(bounds);
                for rows in [1, 13, 40] {
                    let x = numbers(&[rows, inputs], 53);
                    let apart = layer.forward(&x.clamp(-0.5f32, 0.3f32).unwrap()).unwrap();
                    let apart = apart.clamp(-1f32, 2f32).unwrap();
                    let rows = |x: &Tensor| x.to_vec2::<f32>().unwrap();
                    assert_eq!(
                        rows(&clamped.forward(&x).unwrap()),
                        rows(&apart),
                        "{format}"
                    );
                }
            }
        }
        // As in torch, and NaN stays.
        for (value, bounds, expected) in
            [(0.5, [1.0, -1.0], -1.0), (f32::NAN, [0.0, 1.0], f32::NAN)]
        {
            let mut values = [value];
            clamp(&mut values, bounds);
            assert_eq!(values.map(f32::to_bits), [expected.to_bits()]);
        }
    }

    #[test]
    fn rows_of_any_shape_are_those_of_a_table() {
        let numbers = |shape: &[usize], step: usize| {
            let count: usize = shape.iter().product();
            let values: Vec<f32> = (0..count).map(|i| (i * step % 17) as f32 - 8.0).collect();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        let layer = Linear::from_tensors(&numbers(&[3, 5], 7), Some(numbers(&[3], 5))).unwrap();
        let (x, residual) = (numbers(&[2, 4, 5], 3), numbers(&[2, 4, 3], 11));
        let flat = |x: &Tensor| x.reshape((8, ())).unwrap();
        let values = |x: Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let whole = layer.forward_onto(&x, &residual).unwrap();
        assert_eq!(whole.dims(), [2, 4, 3]);
        let table = layer.forward_onto(&flat(&x), &flat(&residual)).unwrap();
        assert_eq!(values(whole), values(table));
        // A part of a tensor lies in pieces.
        let part = x.narrow(1, 1, 2).unwrap();
        let found = layer.forward(&part).unwrap();
        let copied = layer.forward(&part.contiguous().unwrap()).unwrap();
        assert_eq!(values(found), values(copied));
        assert!(layer.forward(&numbers(&[2, 4, 3], 1)).is_err());
    }
}
