//! Exact attention over cached keys and values. A block of keys is scored, weighted and summed
//! while it is in the CPU cache, and the score matrix is never stored (T. Dao et al.,
//! "`FlashAttention`", arXiv:2205.14135).
//!
//! Only the shapes decide how the work is cut into units, and partial results are merged in a fixed
//! order. So the result is the same at any thread count.
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

mod biased;
mod frequencies;
mod key_values;
mod mask;
mod probe;
mod projected;
mod rope;
mod rotary;
mod rounded;
mod unit;

#[cfg(test)]
mod tests;

pub use biased::PackedKeyValues;
pub use frequencies::{frequencies, frequency_factors};
pub use key_values::{KeyValues, Precision};
pub use mask::AttentionMask;
#[doc(hidden)]
pub use probe::AttentionProbe;
pub use projected::{HeadShape, Projected};
pub use rope::{Rope, RopeScaling, RotarySections, Yarn};
pub use rotary::{Position, position_end};
pub use rotary::{RotaryEmbedding, RotaryRows};
pub use rounded::attend_rounded;

use super::matrix::Instructions;
use super::values::in_parts;
use super::{Awake, Work};
use candle_core::{Device, Tensor};
use key_values::{BLOCK_POSITIONS, Block, Blocks, StoredFloat};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use unit::{PartialOutput, WorkUnit};

/// Maximum rows of a work unit, one for each token and query head. More rows read the keys fewer
/// times; the sums of this many stay in the second-level cache.
const MAX_UNIT_ROWS: usize = 192;
/// Positions of a work unit where one unit takes all tokens.
const UNIT_POSITIONS: usize = 8 * BLOCK_POSITIONS;
/// Minimum multiplications for which other threads are worth waking: some 30 µs of one core.
const MIN_PARALLEL_PRODUCTS: usize = 1 << 20;
/// The same where a thread is awake: a few µs.
const MIN_AWAKE_PRODUCTS: usize = 1 << 16;

/// Maximum number of tokens whose results have the same bits as if each token attended alone. A
/// unit takes all of them, and positions are cut as for one token.
pub fn exact_tokens(shape: HeadShape) -> usize {
    (MAX_UNIT_ROWS / shape.group()).max(1)
}

/// Attends from the queries of `rows` to cached positions; returns (tokens, query heads · head
/// width).
pub fn attend(
    rows: &Projected<'_>,
    held: &KeyValues,
    mask: AttentionMask<'_>,
) -> candle_core::Result<Tensor> {
    let tokens = rows.tokens();
    let shape = rows.shape();
    if shape != held.shape || tokens > 0 && mask.seen_by(tokens - 1).end > held.capacity() {
        let (capacity, cached) = (held.capacity(), held.shape);
        candle_core::bail!(
            "{tokens} tokens of {shape:?} cannot attend by {mask:?} to {capacity} positions of {cached:?}"
        );
    }
    count(
        shape,
        held.number_bytes(),
        (0..tokens).map(|token| mask.seen_by(token)),
    );
    let partial = mix(rows, held, mask, Instructions::best());
    Tensor::from_vec(
        partial,
        (tokens, shape.query_heads * shape.width),
        &Device::Cpu,
    )
}

/// Counts an attention by the positions that each token sees: the products with keys and values, and
/// the keys and values that the last token sees.
fn count(shape: HeadShape, number_bytes: usize, seen: impl Iterator<Item = Range<usize>>) {
    let (mut pairs, mut last) = (0, 0);
    for positions in seen {
        last = positions.len();
        pairs += last;
    }
    let bytes = 2 * last * shape.key_heads * shape.width * number_bytes;
    Work::count(2 * pairs, shape.query_heads, shape.width, bytes);
}

fn mix(
    rows: &Projected<'_>,
    held: &KeyValues,
    mask: AttentionMask<'_>,
    instructions: Instructions,
) -> Vec<f32> {
    match &held.blocks {
        Blocks::Single(blocks) => Attention {
            rows: *rows,
            blocks,
            mask,
            instructions,
        }
        .run(),
        Blocks::Half(blocks) => Attention {
            rows: *rows,
            blocks,
            mask,
            instructions,
        }
        .run(),
    }
}

/// One attention, cut into work units.
struct Attention<'a, N> {
    rows: Projected<'a>,
    blocks: &'a [Arc<Block<N>>],
    mask: AttentionMask<'a>,
    instructions: Instructions,
}

impl<N: StoredFloat> Attention<'_, N> {
    fn run(&self) -> Vec<f32> {
        let shape = self.rows.shape();
        let (tokens, width) = (self.rows.tokens(), shape.query_heads * shape.width);
        let step = exact_tokens(shape);
        if tokens > step {
            return in_parts(tokens * width, step * width, |index, out| {
                let first = index * step;
                self.attend_many(first..tokens.min(first + step), out);
            });
        }
        let mut out = vec![0f32; tokens * width];
        if tokens > 0 {
            let seen = self.mask.seen_by(tokens - 1).end;
            let enough = if Awake::is_anybody() {
                MIN_AWAKE_PRODUCTS
            } else {
                MIN_PARALLEL_PRODUCTS
            };
            let parallel = tokens * width * seen >= enough;
            self.attend_few(0..tokens, &mut out, parallel);
        }
        out
    }

    /// Attends from tokens that fit in one unit; units share the positions.
    fn attend_few(&self, tokens: Range<usize>, out: &mut [f32], parallel: bool) {
        let seen = self.seen(&tokens);
        let spans = seen.len().div_ceil(UNIT_POSITIONS).max(1);
        let unit = |index: usize| {
            let from = seen.start + index % spans * UNIT_POSITIONS;
            self.mix(
                index / spans,
                tokens.clone(),
                from..seen.end.min(from + UNIT_POSITIONS),
            )
        };
        let count = self.rows.shape().key_heads * spans;
        let parts: Vec<PartialOutput> = if parallel {
            (0..count).into_par_iter().map(unit).collect()
        } else {
            (0..count).map(unit).collect()
        };
        let mut parts = parts.into_iter();
        for head in 0..self.rows.shape().key_heads {
            PartialOutput::join(parts.by_ref().take(spans)).write(self.rows.shape(), head, out);
        }
    }

    /// Attends from a chunk of many tokens; a unit takes all positions.
    fn attend_many(&self, tokens: Range<usize>, out: &mut [f32]) {
        let seen = self.seen(&tokens);
        let heads = (0..self.rows.shape().key_heads).into_par_iter();
        let partial: Vec<PartialOutput> = heads
            .map(|head| self.mix(head, tokens.clone(), seen.clone()))
            .collect();
        for (head, partial) in partial.iter().enumerate() {
            partial.write(self.rows.shape(), head, out);
        }
    }

    /// The positions that any of the tokens attends to.
    fn seen(&self, tokens: &Range<usize>) -> Range<usize> {
        self.mask.seen_by(tokens.start).start..self.mask.seen_by(tokens.end.saturating_sub(1)).end
    }

    fn mix(&self, head: usize, tokens: Range<usize>, positions: Range<usize>) -> PartialOutput {
        WorkUnit {
            rows: self.rows,
            blocks: self.blocks,
            mask: self.mask,
            head,
            tokens,
            positions,
        }
        .run(self.instructions)
    }
}
