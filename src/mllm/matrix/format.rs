//! What the product of a matrix in tiles asks of the form its numbers are stored in.

use super::line::CacheLine;
use super::simd::{LANES, Simd};

/// PackedTiles that a kernel multiplies at once: as many as let every number of the activations that is loaded be used twice.
pub(super) const TILES: usize = 2;

/// Most rows of activations that a kernel multiplies at once: their sums and those of their parts fill AVX-512's registers.
pub(super) const MAX_BATCH: usize = 6;

/// TileSums of one row of activations with the outputs of [`TILES`] tiles.
pub(super) type TileSums = [[f32; LANES]; TILES];

/// A form of numbers. Products go span by span: the weights of a span are unpacked once for all rows, the activations were
/// packed once for all outputs.
pub(super) trait Format {
    /// Numbers of a row in a span.
    const SPAN: usize;
    /// Lines of a tile in a span.
    const LINES: usize;
    /// Words that a row's activations take in a span. Those of the rows of a tile alternate, word by word.
    const WORDS: usize;
    /// The weights of a tile in a span, ready to be multiplied.
    type Block: Clone;

    /// A block of zeros.
    fn zeros() -> Self::Block;

    /// Packs a row's activations of a span, all [`Self::SPAN`] of them.
    fn pack<S: Simd>(simd: S, values: &[f32], words: &mut [i32]);

    /// Unpacks the weights of a span, fewer than [`Self::LINES`] lines at the end of a row.
    fn unpack<S: Simd>(simd: S, lines: &[CacheLine], block: &mut Self::Block);

    /// Adds the products of a span and a tile of `ROWS` rows to their sums.
    fn multiply<S: Simd, const ROWS: usize>(
        simd: S,
        blocks: &[Self::Block; TILES],
        words: &[i32],
        sums: &mut [TileSums; ROWS],
    );
}
