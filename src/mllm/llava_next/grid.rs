//! The tiles of an image, and the patches that become tokens ("anyres").
//!
//! The arithmetic is that of transformers: `select_best_resolution`, `get_patch_output_size`,
//! `unpad_image` and `pack_image_features`.

use std::ops::Range;

/// A size in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Resolution {
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
}

/// The resolutions that images are scaled to, each a grid of square tiles.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TileGrids {
    resolutions: Vec<Resolution>,
    /// Side of a tile, pixels.
    side: u32,
    /// Patches of a tile in each direction.
    patches: u32,
}

/// The tiles of one image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Tiling {
    /// The resolution of its grid.
    pub target: Resolution,
    /// The size of the image within it; the rest is a black border.
    pub inner: Resolution,
    /// Numbers of tiles from top to bottom and from left to right.
    pub tiles: (u32, u32),
    /// Rows of patches of the whole grid without the border.
    pub rows: Range<u32>,
    /// Columns of patches of the whole grid without the border.
    pub columns: Range<u32>,
}

impl TileGrids {
    /// Grids of tiles with `side` pixels and `patches` patches in each direction. There must be at
    /// least one resolution.
    ///
    /// # Errors
    /// The first resolution that is no multiple of a tile.
    pub(crate) fn new(
        resolutions: Vec<Resolution>,
        side: u32,
        patches: u32,
    ) -> Result<Self, Resolution> {
        let fits = |resolution: &Resolution| {
            resolution.height.is_multiple_of(side) && resolution.width.is_multiple_of(side)
        };
        match resolutions.iter().find(|resolution| !fits(resolution)) {
            Some(resolution) => Err(*resolution),
            None => Ok(Self {
                resolutions,
                side,
                patches,
            }),
        }
    }

    pub(crate) fn resolutions(&self) -> &[Resolution] {
        &self.resolutions
    }

    /// The tiles of an image of this size, which must not be empty.
    pub(crate) fn tiling(&self, image: Resolution) -> Tiling {
        let target = self.best(image);
        let tiles = (target.height / self.side, target.width / self.side);
        let (rows, columns) = unpadded(image, tiles.0 * self.patches, tiles.1 * self.patches);
        Tiling {
            target,
            inner: inner_size(image, target),
            tiles,
            rows,
            columns,
        }
    }

    /// Patches of a tile.
    pub(crate) fn tile_tokens(&self) -> usize {
        (self.patches * self.patches) as usize
    }

    /// Rows of patches of the tallest grid.
    pub(crate) fn max_rows(&self) -> usize {
        let rows = |resolution: &Resolution| resolution.height / self.side * self.patches;
        self.resolutions.iter().map(rows).max().unwrap_or(0) as usize
    }

    /// Tokens of the largest grid without a border.
    pub(crate) fn max_tokens(&self) -> usize {
        let base = (self.patches * self.patches) as usize;
        let grid = |resolution: &Resolution| {
            let rows = (resolution.height / self.side * self.patches) as usize;
            let columns = (resolution.width / self.side * self.patches) as usize;
            base + rows * (columns + 1)
        };
        self.resolutions.iter().map(grid).max().unwrap_or(base)
    }

    /// Tokens of a tiling: the downscaled image, then each row of the grid with a newline.
    pub(crate) fn tokens(&self, tiling: &Tiling) -> usize {
        (self.patches * self.patches) as usize + tiling.rows.len() * (tiling.columns.len() + 1)
    }

    /// The features that become tokens, in order: indices into those of the downscaled image, of
    /// all tiles (left to right, then down), and the newline.
    pub(crate) fn token_rows(&self, tiling: &Tiling) -> Vec<u32> {
        let patches = self.patches;
        let tile_rows = patches * patches;
        let (down, across) = tiling.tiles;
        let newline = tile_rows * (1 + down * across);
        let mut indices: Vec<u32> = (0..tile_rows).collect();
        for row in tiling.rows.clone() {
            for column in tiling.columns.clone() {
                let tile = row / patches * across + column / patches;
                indices.push(tile_rows * (1 + tile) + row % patches * patches + column % patches);
            }
            indices.push(newline);
        }
        indices
    }

    /// The resolution that keeps most of the image's pixels, then wastes least, then comes first
    /// (`select_best_resolution`).
    fn best(&self, image: Resolution) -> Resolution {
        let mut best = Resolution {
            height: self.side,
            width: self.side,
        };
        let mut most = 0;
        let mut least_waste = u64::MAX;
        let pixels = u64::from(image.height) * u64::from(image.width);
        for resolution in &self.resolutions {
            let across = f64::from(resolution.width) / f64::from(image.width);
            let down = f64::from(resolution.height) / f64::from(image.height);
            let scale = across.min(down);
            let width = (f64::from(image.width) * scale) as u64;
            let height = (f64::from(image.height) * scale) as u64;
            let effective = (width * height).min(pixels);
            let area = u64::from(resolution.height) * u64::from(resolution.width);
            let waste = area.saturating_sub(effective);
            if effective > most || (effective == most && waste < least_waste) {
                (best, most, least_waste) = (*resolution, effective, waste);
            }
        }
        best
    }
}

/// The size of an image that is scaled to fit into `target` (`get_patch_output_size`).
fn inner_size(image: Resolution, target: Resolution) -> Resolution {
    let across = f64::from(target.width) / f64::from(image.width);
    let down = f64::from(target.height) / f64::from(image.height);
    if across < down {
        let height = (f64::from(image.height) * across).ceil() as u32;
        Resolution {
            height: height.min(target.height),
            width: target.width,
        }
    } else {
        let width = (f64::from(image.width) * down).ceil() as u32;
        Resolution {
            height: target.height,
            width: width.min(target.width),
        }
    }
}

/// The rows and columns of a grid of patches without the border (`unpad_image`).
fn unpadded(image: Resolution, rows: u32, columns: u32) -> (Range<u32>, Range<u32>) {
    let (height, width) = (f64::from(image.height), f64::from(image.width));
    let (grid_height, grid_width) = (f64::from(rows), f64::from(columns));
    if width / height > grid_width / grid_height {
        let border = (rows - rows.min(rounded_down(height * (grid_width / width)))) / 2;
        (border..rows - border, 0..columns)
    } else {
        let border = (columns - columns.min(rounded_down(width * (grid_height / height)))) / 2;
        (0..rows, border..columns - border)
    }
}

/// transformers rounds a size to 7 digits before it truncates it.
const DIGITS: f64 = 1e7;

/// The whole part of a size, without the rounding error of the division.
fn rounded_down(size: f64) -> u32 {
    ((size * DIGITS).round_ties_even() / DIGITS) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The grids of LLaVA 1.6.
    fn grids() -> TileGrids {
        let resolutions = [(336, 672), (672, 336), (672, 672), (1008, 336), (336, 1008)]
            .map(|(height, width)| Resolution { height, width })
            .to_vec();
        TileGrids::new(resolutions, 336, 24).unwrap()
    }

    #[test]
    fn a_square_image_is_cut_into_four() {
        let grids = grids();
        let tiling = grids.tiling(Resolution {
            height: 336,
            width: 336,
        });
        assert_eq!(
            (tiling.tiles, tiling.rows.clone(), tiling.columns.clone()),
            ((1, 2), 0..24, 12..36)
        );
        let tiling = grids.tiling(Resolution {
            height: 700,
            width: 700,
        });
        assert_eq!(
            (tiling.tiles, tiling.rows.clone(), tiling.columns.clone()),
            ((2, 2), 0..48, 0..48)
        );
        assert_eq!(grids.tokens(&tiling), 576 + 48 * 49);
        assert_eq!(grids.max_tokens(), 576 + 48 * 49);
    }

    #[test]
    fn rows_run_across_tiles_and_end_with_a_newline() {
        let grid = TileGrids::new(
            vec![Resolution {
                height: 4,
                width: 8,
            }],
            4,
            2,
        )
        .unwrap();
        let tiling = grid.tiling(Resolution {
            height: 4,
            width: 8,
        });
        // Base 0 to 3, left tile 4 to 7, right tile 8 to 11, newline 12.
        assert_eq!(
            grid.token_rows(&tiling),
            [0, 1, 2, 3, 4, 5, 8, 9, 12, 6, 7, 10, 11, 12]
        );
    }

    #[test]
    fn a_resolution_that_is_no_grid_is_refused() {
        let odd = Resolution {
            height: 336,
            width: 500,
        };
        assert_eq!(TileGrids::new(vec![odd], 336, 24), Err(odd));
    }

    proptest! {
        #[test]
        fn every_image_has_a_tiling(height in 1u32..5000, width in 1u32..5000) {
            let grids = grids();
            let tiling = grids.tiling(Resolution { height, width });
            prop_assert!(tiling.inner.height >= 1 && tiling.inner.height <= tiling.target.height);
            prop_assert!(tiling.inner.width >= 1 && tiling.inner.width <= tiling.target.width);
            let rows = grids.token_rows(&tiling);
            prop_assert_eq!(rows.len(), grids.tokens(&tiling));
            prop_assert!(rows.len() <= grids.max_tokens());
            let newline = 576 * (1 + tiling.tiles.0 * tiling.tiles.1);
            prop_assert!(rows.iter().all(|row| *row <= newline));
        }
    }
}
