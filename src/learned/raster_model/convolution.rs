//! Convolutions over images with their channels last, (images, rows, columns, channels), as
//! products of windows and weights.

use crate::blocks::{BatchNorm, Linear, Weights};
use candle_core::{Device, Result, Tensor};
use planagent_kernels::values::with_values;
use rayon::prelude::*;

/// Kernel and stride of the pooling.
const POOLING: [usize; 2] = [3, 2];

/// Channels, kernel and stride of a convolution.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    pub inputs: usize,
    pub outputs: usize,
    pub kernel: usize,
    pub stride: usize,
}

/// A convolution with the batch normalization behind it, as one convolution with a bias.
#[derive(Debug, Clone)]
pub(super) struct Convolution {
    shape: Shape,
    weight: Linear,
}

impl Convolution {
    pub(super) fn take(
        weights: &mut Weights,
        [name, norm]: [&str; 2],
        shape: Shape,
    ) -> Result<Self> {
        let Shape {
            inputs,
            outputs,
            kernel,
            ..
        } = shape;
        let weight = weights.take(
            &format!("{name}.weight"),
            &[outputs, inputs, kernel, kernel],
        )?;
        let (weight, bias) = BatchNorm::take(weights, norm, outputs)?.folded(&weight, None)?;
        let weight = weight
            .permute((0, 2, 3, 1))?
            .reshape((outputs, kernel * kernel * inputs))?;
        Ok(Self {
            shape,
            weight: Linear::from_tensors(&weight, Some(bias))?,
        })
    }

    /// Maps (images, rows, columns, inputs) to (images, rows / stride, columns / stride, outputs).
    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.weight
            .forward(&windows(x, self.shape.kernel, self.shape.stride)?)
    }

    /// residual + convolution(x).
    pub(super) fn forward_onto(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        self.weight
            .forward_onto(&windows(x, self.shape.kernel, self.shape.stride)?, residual)
    }
}

/// The largest of each window. Values are not negative, so that a border of zeros does not change a
/// maximum.
pub(super) fn largest(x: &Tensor) -> Result<Tensor> {
    let [kernel, stride] = POOLING;
    let channels = x.dim(3)?;
    let windows = windows(x, kernel, stride)?;
    let (images, rows, columns, _) = windows.dims4()?;
    with_values(&windows, |values| {
        let mut out = vec![0f32; images * rows * columns * channels];
        let windows = values.par_chunks(kernel * kernel * channels);
        out.par_chunks_mut(channels)
            .zip(windows)
            .for_each(|(out, window)| {
                for pixel in window.chunks_exact(channels) {
                    out.iter_mut()
                        .zip(pixel)
                        .for_each(|(out, value)| *out = out.max(*value));
                }
            });
        Tensor::from_vec(out, (images, rows, columns, channels), &Device::Cpu)
    })
}

/// The windows around the pixels of (images, rows, columns, channels), `stride` apart, with a
/// border of zeros: (images, rows, columns, kernel · kernel · channels).
fn windows(x: &Tensor, kernel: usize, stride: usize) -> Result<Tensor> {
    if (kernel, stride) == (1, 1) {
        return Ok(x.clone());
    }
    let (images, rows, columns, channels) = x.dims4()?;
    let border = kernel / 2;
    let [tall, wide] = [rows, columns].map(|length| (length + 2 * border - kernel) / stride + 1);
    let line = kernel * channels;
    with_values(x, |values| {
        let mut out = vec![0f32; images * tall * wide * kernel * line];
        out.par_chunks_mut(wide * kernel * line)
            .enumerate()
            .for_each(|(index, out)| {
                let (image, top) = (index / tall, index % tall * stride);
                for (left, window) in (0..)
                    .step_by(stride)
                    .zip(out.chunks_exact_mut(kernel * line))
                {
                    // Columns of the window within the image.
                    let (first, end) = (
                        border.saturating_sub(left),
                        kernel.min(columns + border - left),
                    );
                    for (row, out) in (top..).zip(window.chunks_exact_mut(line)) {
                        if (border..rows + border).contains(&row) {
                            let pixel =
                                (image * rows + row - border) * columns + left + first - border;
                            let count = (end - first) * channels;
                            out[first * channels..][..count]
                                .copy_from_slice(&values[pixel * channels..][..count]);
                        }
                    }
                }
            });
        Tensor::from_vec(out, (images, tall, wide, kernel * line), &Device::Cpu)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from -1 to 1 without a pattern.
    fn numbers(shape: [usize; 4]) -> Tensor {
        let count = shape.iter().product::<usize>();
        let values = (0..count)
            .map(|index| ((index * index) as f32).sin())
            .collect::<Vec<_>>();
        Tensor::from_vec(values, shape.to_vec(), &Device::Cpu).unwrap()
    }

    #[test]
    fn windows_times_weights_are_candles_convolution() {
        for (kernel, stride, rows, columns) in [
            (7, 2, 13, 10),
            (3, 1, 5, 4),
            (3, 2, 8, 9),
            (1, 2, 7, 6),
            (1, 1, 3, 2),
        ] {
            let image = numbers([2, 3, rows, columns]);
            let weight = numbers([5, 3, kernel, kernel]);
            let expected = image
                .conv2d(&weight, kernel / 2, stride, 1, 1)
                .unwrap()
                .permute((0, 2, 3, 1))
                .unwrap();
            let windows = windows(&image.permute((0, 2, 3, 1)).unwrap(), kernel, stride).unwrap();
            let flat = weight
                .permute((0, 2, 3, 1))
                .unwrap()
                .reshape((5, ()))
                .unwrap();
            let found = Linear::from_tensors(&flat, None)
                .unwrap()
                .forward(&windows)
                .unwrap();
            assert_eq!(found.dims(), expected.dims());
            let off = (found - expected)
                .unwrap()
                .abs()
                .unwrap()
                .max_all()
                .unwrap()
                .to_scalar::<f32>()
                .unwrap();
            assert!(off < 1e-4, "kernel {kernel}, stride {stride}: {off}");
        }
    }

    #[test]
    fn the_largest_of_a_window_is_candles() {
        let image = numbers([2, 3, 8, 11]).abs().unwrap();
        let padded = image
            .pad_with_zeros(2, 1, 1)
            .unwrap()
            .pad_with_zeros(3, 1, 1)
            .unwrap();
        let expected = padded
            .max_pool2d_with_stride(3, 2)
            .unwrap()
            .permute((0, 2, 3, 1))
            .unwrap();
        let found = largest(&image.permute((0, 2, 3, 1)).unwrap()).unwrap();
        let values = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(
            (found.dims(), values(&found)),
            (expected.dims(), values(&expected))
        );
    }
}
