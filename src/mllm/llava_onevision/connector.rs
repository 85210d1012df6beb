//! The features of an image from those of its tiles, of which no more become tokens than the model
//! takes.

use crate::MllmError;
use crate::checkpoint::Weights;
use crate::llava_next::{TileGrids, TilePacker, Tiling};
use candle_core::{Device, Result, Tensor};

/// Puts the features of tiles back into their grid, makes a large one smaller, and ends each row
/// with a newline (`pack_image_features`).
#[derive(Debug)]
pub(super) struct MapPacker {
    packer: TilePacker,
    /// Tiles whose patches all become tokens.
    max_tiles: usize,
}

/// The map is made smaller where its sides exceed those of the most tiles by this factor.
const MAX_RATIO: f64 = 1.1;

/// Tokens of an image in one view, which ends with a newline.
pub(super) fn view_tokens(grids: &TileGrids) -> usize {
    grids.tile_tokens() + 1
}

impl MapPacker {
    pub(super) fn take(
        weights: &mut Weights,
        hidden: usize,
        max_tiles: usize,
    ) -> std::result::Result<Self, MllmError> {
        Ok(Self {
            packer: TilePacker::take(weights, hidden)?,
            max_tiles,
        })
    }

    /// Tokens of a tiling: the whole image, then each row of its map with a newline.
    pub(super) fn tokens(&self, grids: &TileGrids, tiling: &Tiling) -> usize {
        let [rows, columns] = self.map_size(grids, tiling);
        grids.tile_tokens() + rows * (columns + 1)
    }

    /// A bound of the tokens of any image.
    pub(super) fn max_tokens(&self, grids: &TileGrids) -> usize {
        let tile = grids.tile_tokens();
        let most = (self.max_tiles * tile) as f64 * MAX_RATIO * MAX_RATIO;
        let rows = grids.max_rows();
        grids.max_tokens().min(tile + most as usize + rows)
    }

    /// Rows and columns of the map, without newlines.
    fn map_size(&self, grids: &TileGrids, tiling: &Tiling) -> [usize; 2] {
        let size = [tiling.rows.len(), tiling.columns.len()];
        let most = self.max_tiles * grids.tile_tokens();
        let ratio = ((size[0] * size[1]) as f64 / most as f64).sqrt();
        if ratio > MAX_RATIO {
            size.map(|side| divided(side, ratio).max(1))
        } else {
            size
        }
    }

    /// Packs features (tiles · patches, decoder width) of the whole image and then of every tile to
    /// (image tokens, decoder width).
    pub(super) fn pack(
        &self,
        features: &Tensor,
        grids: &TileGrids,
        tiling: &Tiling,
    ) -> Result<Tensor> {
        let size = [tiling.rows.len(), tiling.columns.len()];
        let smaller = self.map_size(grids, tiling);
        let packed = self.packer.pack(features, grids, tiling)?;
        if size == smaller {
            return Ok(packed);
        }
        let (tokens, width) = packed.dims2()?;
        let tile = grids.tile_tokens();
        let map: Vec<f32> = packed
            .narrow(0, tile, tokens - tile)?
            .flatten_all()?
            .to_vec1()?;
        let newline: Vec<f32> = self.packer.newline().flatten_all()?.to_vec1()?;
        // A row of the packed map ends with its newline.
        let rows: Vec<&[f32]> = map
            .chunks_exact((size[1] + 1) * width)
            .map(|row| &row[..size[1] * width])
            .collect();
        let small = resized(&rows, size[1], smaller, &newline);
        let count = smaller[0] * (smaller[1] + 1);
        let small = Tensor::from_vec(small, (count, width), &Device::Cpu)?;
        Tensor::cat(&[&packed.narrow(0, 0, tile)?, &small], 0)
    }

    /// Packs the features of an image in one view.
    pub(super) fn pack_view(&self, features: &Tensor) -> Result<Tensor> {
        Tensor::cat(&[features, self.packer.newline()], 0)
    }
}

/// The whole quotient, as Python's `//` of two floats has it.
fn divided(side: usize, ratio: f64) -> usize {
    let side = side as f64;
    ((side - side % ratio) / ratio).round() as usize
}

/// Resizes rows of `columns` cells each, bilinearly and without smoothing, to a map of the size
/// `to`, each of whose rows ends with the newline (torch's `interpolate` without aligned corners).
fn resized(rows: &[&[f32]], columns: usize, to: [usize; 2], newline: &[f32]) -> Vec<f32> {
    let width = newline.len();
    let (down, across) = (taps(rows.len(), to[0]), taps(columns, to[1]));
    let mut out = Vec::with_capacity(to[0] * (to[1] + 1) * width);
    // Rows are borrowed from the grid of tiles, so the map is never joined before it shrinks.
    let cell = |row: usize, column: usize| {
        rows.get(row)
            .and_then(|row| row.get(column * width..(column + 1) * width))
            .expect("taps lie within the map")
    };
    for (above, below, to_below) in &down {
        for (left, right, to_right) in &across {
            let corners = [
                cell(*above, *left),
                cell(*above, *right),
                cell(*below, *left),
                cell(*below, *right),
            ];
            let [from_above, from_left] = [1.0 - to_below, 1.0 - to_right];
            let weights = [
                from_above * from_left,
                from_above * to_right,
                to_below * from_left,
                to_below * to_right,
            ];
            let first = out.len();
            out.resize(first + width, 0.0);
            for (corner, weight) in corners.into_iter().zip(weights) {
                out.iter_mut()
                    .skip(first)
                    .zip(corner)
                    .for_each(|(out, value)| *out += weight * value);
            }
        }
        out.extend_from_slice(newline);
    }
    out
}

/// The two nearest of `from` cells of each of `to` cells, and the weight of the second.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f32 / to as f32;
    let last = from.saturating_sub(1);
    (0..to)
        .map(|index| {
            let at = (scale * (index as f32 + 0.5) - 0.5).max(0.0);
            let lower = (at as usize).min(last);
            let part = (at - lower as f32).clamp(0.0, 1.0);
            (lower, (lower + 1).min(last), part)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_resized_without_aligned_corners() {
        // torch.nn.functional.interpolate of [[0, 1, 2, 3, 4]] to one row of two: [0.75, 3.25].
        let row = [0.0, 1.0, 2.0, 3.0, 4.0];
        assert_eq!(resized(&[&row], 5, [1, 2], &[9.0]), [0.75, 3.25, 9.0]);
        assert_eq!(taps(4, 2), [(0, 1, 0.5), (2, 3, 0.5)]);
    }

    #[test]
    fn a_quotient_is_that_of_python() {
        // 81 // 1.2 == 67.0, 6 // 0.1 == 59.0
        assert_eq!((divided(81, 1.2), divided(6, 0.1)), (67, 59));
    }
}
