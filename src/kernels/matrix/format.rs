//! The operations that a weight format provides to the product of a packed matrix.

use super::line::{CacheLine, LANES};
use super::simd::Simd;

/// Weight tiles that a kernel multiplies at once. Two, so that every loaded activation is used
/// twice.
pub(super) const TILES: usize = 2;

/// Maximum rows of activations in a batch that a kernel multiplies at once. The sums of six rows
/// fill AVX-512's registers.
pub(super) const MAX_BATCH: usize = 6;

/// Whether the sums of all tiles with this number of rows fill at most half of the registers. If
/// not, rows are multiplied with one tile after the other.
/// Why: docs/decisions/145-few-registers.md.
pub(super) const fn take_all_tiles<S: Simd, const ROWS: usize>() -> bool {
    ROWS * TILES <= S::REGISTERS / 2
}

/// Outputs that a kernel computes at once.
pub(super) const COLUMNS: usize = TILES * LANES;

/// Sums of one row of activations with the outputs of [`TILES`] tiles.
pub(super) type TileSums = [[f32; LANES]; TILES];

/// A weight format in a product. A product goes span by span along the inputs. It unpacks the
/// weights of a span once for all rows, and packs the activations once for all outputs.
pub(super) trait Format {
    /// Inputs in a span.
    const SPAN: usize;
    /// Cache lines that hold the weights of a tile for one span.
    const LINES: usize;
    /// Words of a row's packed activations in a span. The rows of a batch alternate word by word.
    const WORDS: usize;
    /// The unpacked weights of a tile in a span.
    type Block: Clone;
    /// Only the scales of a [`Self::Block`].
    type Scales;

    /// Words of a row's packed activations in all spans. The last may have fewer than
    /// [`Self::WORDS`].
    fn row_words(inputs: usize) -> usize {
        inputs.div_ceil(Self::SPAN) * Self::WORDS
    }

    fn zeros() -> Self::Block;

    fn no_scales() -> Self::Scales;

    /// Packs the [`Self::SPAN`] activations of a row in a span.
    fn pack<S: Simd>(simd: S, values: &[f32], words: &mut [i32]);

    /// Unpacks the weights of a span. The last span of a row may have fewer than [`Self::LINES`]
    /// lines.
    fn unpack<S: Simd>(simd: S, lines: &[CacheLine], block: &mut Self::Block);

    /// Adds the products of a span with a batch of `ROWS` rows to their sums. Only the first
    /// `inputs` of a span count; the others are zeros behind the end of a row.
    fn multiply<S: Simd, const ROWS: usize>(
        simd: S,
        blocks: &[Self::Block; TILES],
        words: &[i32],
        inputs: usize,
        sums: &mut [TileSums; ROWS],
    );

    /// As [`Self::multiply`], straight from the packed lines. A few rows read every weight once, so
    /// unpacked weights would only be copies. The last span of a row may have fewer than
    /// [`Self::LINES`] lines.
    fn multiply_packed<S: Simd, const ROWS: usize>(
        simd: S,
        span: PackedSpan<'_>,
        scales: &mut [Self::Scales; TILES],
        words: &[i32],
        inputs: usize,
        sums: &mut [TileSums; ROWS],
    );
}

/// The lines of a pair of tiles in a span, and those to prefetch.
#[derive(Clone, Copy)]
pub(super) struct PackedSpan<'a> {
    pub(super) tiles: [&'a [CacheLine]; TILES],
    pub(super) ahead: [*const CacheLine; TILES],
}

/// Prefetches part `part` of `parts` of the `lines` from `ahead` on. Requests in small groups
/// overlap with products; the memory system holds only some dozens at a time.
#[inline(always)]
pub(super) fn prefetch_part<S: Simd>(
    simd: S,
    ahead: [*const CacheLine; TILES],
    lines: usize,
    part: usize,
    parts: usize,
) {
    for ahead in ahead {
        // A constant number of lines in each part, so that the loop is unrolled; parts may overlap.
        for line in 0..lines.div_ceil(parts) {
            simd.prefetch(ahead.wrapping_add(lines * part / parts + line));
        }
    }
}
