//! The patches of an image: from pixels to rows, and from blocks of rows to wider rows.

use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::Linear;
use planagent_kernels::matrix::Matrix;

/// Takes the embedding of patches with `side` pixels, a convolution without overlap (`NAME.weight`,
/// `NAME.bias`).
pub(crate) fn take_patch_embedding(
    weights: &mut Weights,
    name: &str,
    hidden: usize,
    side: usize,
    bias: bool,
) -> std::result::Result<Linear, MllmError> {
    let kernel = weights.take(&format!("{name}.weight"), &[hidden, 3, side, side])?;
    let bias = if bias {
        Some(weights.take(&format!("{name}.bias"), &[hidden])?)
    } else {
        None
    };
    Ok(Linear::from_matrix(
        Matrix::from_tensor(&kernel.flatten_from(1)?)?,
        bias,
    ))
}

/// Cuts pixels (3, height, width) into patches in raster order, (patches, 3 · patch²), in the
/// layout of a convolution kernel. Drops the remainder at the right and at the bottom.
pub(crate) fn unfold(pixels: &Tensor, patch: usize) -> Result<Tensor> {
    let (rows, columns) = (pixels.dim(1)? / patch, pixels.dim(2)? / patch);
    pixels
        .narrow(1, 0, rows * patch)?
        .narrow(2, 0, columns * patch)?
        .reshape(vec![3, rows, patch, columns, patch])?
        .permute(vec![1, 3, 0, 2, 4])?
        .reshape((rows * columns, 3 * patch * patch))
}

/// Lays the patches of each block of `side` by `side` patches side by side, row by row (pixel
/// shuffle, patch merging): grids (grids · rows · columns, width) become (grids · rows/side ·
/// columns/side, side² · width), blocks in raster order.
pub(crate) fn merge_blocks(x: &Tensor, [rows, columns]: [usize; 2], side: usize) -> Result<Tensor> {
    let (tokens, width) = x.dims2()?;
    let (rows, columns) = (rows / side, columns / side);
    let grids = tokens / (rows * columns * side * side).max(1);
    x.reshape(vec![grids, rows, side, columns, side, width])?
        .permute(vec![0, 1, 3, 2, 4, 5])?
        .reshape((grids * rows * columns, side * side * width))
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn blocks_are_merged_row_by_row() {
        // Two grids of 2 by 4 patches of one number.
        let x = Tensor::arange(0f32, 16.0, &Device::Cpu)
            .unwrap()
            .reshape((16, 1))
            .unwrap();
        let merged = merge_blocks(&x, [2, 4], 2)
            .unwrap()
            .to_vec2::<f32>()
            .unwrap();
        assert_eq!(merged[..2], [[0.0, 1.0, 4.0, 5.0], [2.0, 3.0, 6.0, 7.0]]);
        assert_eq!(merged[2], [8.0, 9.0, 12.0, 13.0]);
    }

    #[test]
    fn patches_lie_in_raster_order_and_the_remainder_is_dropped() {
        let pixels = Tensor::arange(0f32, 45.0, &Device::Cpu)
            .unwrap()
            .reshape((3, 3, 5))
            .unwrap();
        let patches = unfold(&pixels, 2).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(patches.len(), 2);
        assert_eq!(
            patches[1],
            [
                2.0, 3.0, 7.0, 8.0, 17.0, 18.0, 22.0, 23.0, 32.0, 33.0, 37.0, 38.0
            ]
        );
    }
}
