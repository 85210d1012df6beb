//! The features of an image from those of its tiles.

use super::grid::{TileGrids, Tiling};
use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Device, Result, Tensor};

/// Puts the features of tiles back into their grid, drops the border, and ends each row with a
/// newline (`pack_image_features`).
#[derive(Debug)]
pub(crate) struct TilePacker {
    /// The learned row that ends a line, (1, decoder width).
    newline: Tensor,
}

impl TilePacker {
    /// Takes the newline of decoder width `hidden`.
    pub(crate) fn take(
        weights: &mut Weights,
        hidden: usize,
    ) -> std::result::Result<Self, MllmError> {
        Ok(Self {
            newline: weights.take("image_newline", &[hidden])?.unsqueeze(0)?,
        })
    }

    /// The row that ends a line, (1, decoder width).
    pub(crate) fn newline(&self) -> &Tensor {
        &self.newline
    }

    /// Packs features (tiles · patches, decoder width) of the whole image and then of every tile to
    /// (image tokens, decoder width).
    pub(crate) fn pack(
        &self,
        features: &Tensor,
        grids: &TileGrids,
        tiling: &Tiling,
    ) -> Result<Tensor> {
        let rows = grids.token_rows(tiling);
        let count = rows.len();
        Tensor::cat(&[features, &self.newline], 0)?
            .index_select(&Tensor::from_vec(rows, count, &Device::Cpu)?, 0)
    }
}
