//! Attention over held keys and values, exact: blocks of keys are scored, weighed and summed while they lie in the cache
//! of the processor, and the score matrix is never written down (T. Dao et al., "`FlashAttention`", arXiv:2205.14135).
//!
//! The work is cut into units by the shapes alone and their results are joined in a fixed order, so the same numbers come
//! out at any thread count.
#![allow(clippy::inline_always, reason = "kernels must be inlined into the functions that have the instructions")]

mod key_values;
mod rotary;
mod unit;

#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::Arc;

use candle_core::{Device, Storage, Tensor};
use rayon::prelude::*;

use key_values::{BLOCK_POSITIONS, Block, Blocks, StoredFloat};
pub(crate) use key_values::{KeyValues, Precision};
pub(crate) use rotary::{RotaryRows, RotaryTable};
use unit::{PartialOutput, WorkUnit};

use super::matrix::{Instructions, LANES};

/// Rows of queries, one a query head, that one unit takes along the keys: the more, the fewer times keys are read; all
/// sums of them stay in the second-level cache.
const MAX_UNIT_ROWS: usize = 192;
/// Positions that one unit looks at when there are too few queries to share the work by them.
const UNIT_POSITIONS: usize = 8 * BLOCK_POSITIONS;
/// Fewest products of a number by a number that are worth waking other threads for, some 30 µs.
const MIN_PARALLEL_PRODUCTS: usize = 1 << 20;

/// The heads of an attention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HeadShape {
    /// Number of query heads, a multiple of the key heads.
    pub query_heads: usize,
    /// Number of key heads, and of value heads.
    pub key_heads: usize,
    /// Numbers of a head.
    pub width: usize,
}

impl HeadShape {
    /// Query heads that share a key head.
    fn group(self) -> usize {
        self.query_heads / self.key_heads
    }

    /// Head width rounded up to whole vectors.
    fn padded(self) -> usize {
        self.width.next_multiple_of(LANES)
    }

    /// Numbers of a row of queries, keys and values side by side.
    fn row(self) -> usize {
        (self.query_heads + 2 * self.key_heads) * self.width
    }
}

/// Queries, keys and values of tokens side by side, (tokens, (query heads + 2 · key heads) · head width), before the
/// rotary embedding.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Projected<'a> {
    values: &'a [f32],
    shape: HeadShape,
    rotary: Option<&'a RotaryRows>,
}

impl<'a> Projected<'a> {
    /// Runs `read` on the rows of a tensor. `rotary` are the angles by which queries and keys are turned; none for not.
    ///
    /// # Errors
    /// When the tensor is not a contiguous f32 one of (tokens, (query heads + 2 · key heads) · head width), or there are
    /// not as many angles.
    pub(crate) fn of<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        let (tokens, width) = tensor.dims2()?;
        if width != shape.row() || !shape.query_heads.is_multiple_of(shape.key_heads) {
            candle_core::bail!("rows of {width} numbers are not the projections of {shape:?}");
        }
        if rotary.is_some_and(|rotary| !rotary.fits(tokens, shape.width)) {
            candle_core::bail!("no angles for {tokens} tokens of {shape:?}");
        }
        let (storage, layout) = tensor.storage_and_layout();
        let (Storage::Cpu(storage), Some((start, end))) = (&*storage, layout.contiguous_offsets()) else {
            candle_core::bail!("attention to a tensor that is not contiguous, or not on the CPU");
        };
        let Some(values) = storage.as_slice::<f32>()?.get(start..end) else {
            candle_core::bail!("attention beyond the end of a tensor");
        };
        read(&Projected { values, shape, rotary })
    }

    /// Number of tokens.
    pub(crate) fn tokens(&self) -> usize {
        self.values.len() / self.shape.row()
    }

    fn heads(&self, token: usize, first: usize, count: usize) -> &'a [f32] {
        let start = token * self.shape.row() + first * self.shape.width;
        &self.values[start..start + count * self.shape.width]
    }

    /// The queries of the heads that share a key head.
    fn queries(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(token, head * self.shape.group(), self.shape.group())
    }

    fn key(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(token, self.shape.query_heads + head, 1)
    }

    fn value(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(token, self.shape.query_heads + self.shape.key_heads + head, 1)
    }

    /// A query or key, turned by its token's angles and scaled.
    fn rotated(&self, token: usize, head: &[f32], scale: f32, out: &mut [f32]) {
        match self.rotary {
            Some(rotary) => rotary.rotate(token, head, scale, out),
            None => out.iter_mut().zip(head).for_each(|(out, value)| *out = value * scale),
        }
    }
}

/// Which positions the rows of a pass may attend to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AttentionMask {
    /// All of the first `positions`.
    All {
        /// Their number.
        positions: usize,
    },
    /// The row's own and those before it.
    Causal {
        /// Position of the first row.
        start: usize,
        /// Most positions that a row sees, its own among them; none for all.
        window: Option<usize>,
    },
}

impl AttentionMask {
    /// The positions that a row sees.
    fn of(self, token: usize) -> Range<usize> {
        match self {
            Self::All { positions } => 0..positions,
            Self::Causal { start, window } => {
                let end = start + token + 1;
                end.saturating_sub(window.unwrap_or(end))..end
            }
        }
    }
}

/// Attends from the queries of `rows` to what is held, (tokens, query heads · head width).
///
/// # Errors
/// When the shapes differ, or a position that a row sees has never been written.
pub(crate) fn attend(rows: &Projected<'_>, held: &KeyValues, mask: AttentionMask) -> candle_core::Result<Tensor> {
    let tokens = rows.tokens();
    if rows.shape != held.shape || tokens > 0 && mask.of(tokens - 1).end > held.capacity() {
        candle_core::bail!("{tokens} tokens of {:?} attend to fewer positions, or to {:?}", rows.shape, held.shape);
    }
    let partial = mix(rows, held, mask, Instructions::best());
    Tensor::from_vec(partial, (tokens, rows.shape.query_heads * rows.shape.width), &Device::Cpu)
}

fn mix(rows: &Projected<'_>, held: &KeyValues, mask: AttentionMask, instructions: Instructions) -> Vec<f32> {
    match &held.blocks {
        Blocks::Single(blocks) => Attention { rows: *rows, blocks, mask, instructions }.run(),
        Blocks::Half(blocks) => Attention { rows: *rows, blocks, mask, instructions }.run(),
    }
}

/// An attention, to be cut into units.
struct Attention<'a, N> {
    rows: Projected<'a>,
    blocks: &'a [Arc<Block<N>>],
    mask: AttentionMask,
    instructions: Instructions,
}

impl<N: StoredFloat> Attention<'_, N> {
    fn run(&self) -> Vec<f32> {
        let shape = self.rows.shape;
        let (tokens, width) = (self.rows.tokens(), shape.query_heads * shape.width);
        let mut out = vec![0f32; tokens * width];
        if tokens == 0 {
            return out;
        }
        let step = (MAX_UNIT_ROWS / shape.group()).max(1);
        if tokens <= step {
            let seen = self.mask.of(tokens - 1).end;
            self.attend_few(0..tokens, &mut out, tokens * width * seen >= MIN_PARALLEL_PRODUCTS);
        } else {
            let chunks = out.par_chunks_mut(step * width).enumerate();
            chunks.for_each(|(index, out)| {
                let first = index * step;
                self.attend_many(first..tokens.min(first + step), out);
            });
        }
        out
    }

    /// Attends from as many tokens as a unit takes, the positions shared among units too.
    fn attend_few(&self, tokens: Range<usize>, out: &mut [f32], parallel: bool) {
        let seen = self.seen(&tokens);
        let spans = seen.len().div_ceil(UNIT_POSITIONS).max(1);
        let unit = |index: usize| {
            let from = seen.start + index % spans * UNIT_POSITIONS;
            self.mix(index / spans, tokens.clone(), from..seen.end.min(from + UNIT_POSITIONS))
        };
        let count = self.rows.shape.key_heads * spans;
        let parts: Vec<PartialOutput> =
            if parallel { (0..count).into_par_iter().map(unit).collect() } else { (0..count).map(unit).collect() };
        let mut parts = parts.into_iter();
        for head in 0..self.rows.shape.key_heads {
            PartialOutput::join(parts.by_ref().take(spans)).write(self.rows.shape, head, out);
        }
    }

    /// Attends from as many tokens as a unit takes, of which there are others.
    fn attend_many(&self, tokens: Range<usize>, out: &mut [f32]) {
        let seen = self.seen(&tokens);
        let heads = (0..self.rows.shape.key_heads).into_par_iter();
        let partial: Vec<PartialOutput> = heads.map(|head| self.mix(head, tokens.clone(), seen.clone())).collect();
        for (head, partial) in partial.iter().enumerate() {
            partial.write(self.rows.shape, head, out);
        }
    }

    /// The positions that any of the tokens sees.
    fn seen(&self, tokens: &Range<usize>) -> Range<usize> {
        self.mask.of(tokens.start).start..self.mask.of(tokens.end.saturating_sub(1)).end
    }

    fn mix(&self, head: usize, tokens: Range<usize>, positions: Range<usize>) -> PartialOutput {
        WorkUnit { rows: self.rows, blocks: self.blocks, mask: self.mask, head, tokens, positions }
            .run(self.instructions)
    }
}
