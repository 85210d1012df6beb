//! Queries, keys and values as the projections of a layer leave them.

use super::rotary::RotaryRows;
use crate::matrix::LANES;
use crate::values::{TASK_NUMBERS, with_contiguous};
use candle_core::Tensor;
use rayon::prelude::*;

/// The heads of an attention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HeadShape {
    /// A multiple of the key heads.
    pub query_heads: usize,
    /// Key heads, and value heads.
    pub key_heads: usize,
    /// Channels of a head.
    pub width: usize,
}

impl HeadShape {
    /// Query heads that share a key head.
    pub(super) fn group(self) -> usize {
        self.query_heads / self.key_heads
    }

    /// Head width rounded up to whole vectors.
    pub(super) fn padded(self) -> usize {
        self.width.next_multiple_of(LANES)
    }

    /// Numbers of a token's queries, keys and values together.
    pub(super) fn row(self) -> usize {
        (self.query_heads + 2 * self.key_heads) * self.width
    }
}

/// Queries, keys and values of tokens before the rotary embedding, (tokens, (query heads + 2 · key
/// heads) · head width).
#[derive(Debug, Clone, Copy)]
pub struct Projected<'a> {
    values: &'a [f32],
    shape: HeadShape,
    /// Numbers of a token.
    row: usize,
    rotary: Option<&'a RotaryRows>,
}

impl<'a> Projected<'a> {
    /// Runs `read` on the rows of a tensor. `rotary` has the angles of queries and keys; `None` for
    /// no rotary embedding.
    pub fn read<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        if tensor.dim(1)? != shape.row() {
            let width = tensor.dim(1)?;
            candle_core::bail!(
                "rows of {width} numbers do not hold queries, keys and values of {shape:?}"
            );
        }
        Self::read_rows(tensor, shape, rotary, read)
    }

    /// As [`Self::read`], of queries alone, (tokens, query heads · head width), which attend to
    /// keys that are cached already.
    pub fn read_queries<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        if tensor.dim(1)? != shape.query_heads * shape.width {
            let width = tensor.dim(1)?;
            candle_core::bail!("rows of {width} numbers do not hold queries of {shape:?}");
        }
        Self::read_rows(tensor, shape, rotary, read)
    }

    fn read_rows<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        let (tokens, row) = tensor.dims2()?;
        if !shape.query_heads.is_multiple_of(shape.key_heads) {
            candle_core::bail!("{shape:?}: the heads of keys do not divide those of queries");
        }
        if rotary.is_some_and(|rotary| !rotary.fits(tokens, shape.width)) {
            candle_core::bail!("the rotary angles do not fit {tokens} tokens of {shape:?}");
        }
        with_contiguous(tensor, |values| {
            read(&Projected {
                values,
                shape,
                row,
                rotary,
            })
        })
    }

    pub(super) fn shape(&self) -> HeadShape {
        self.shape
    }

    /// Number of tokens.
    pub fn tokens(&self) -> usize {
        self.values.len() / self.row
    }

    /// Whether all magnitudes are below a limit; NaN is not.
    pub(super) fn are_below(&self, limit: f32) -> bool {
        let parts = self.values.par_chunks(TASK_NUMBERS);
        // No early exit within a part: the compiler does not vectorize loops with one.
        let below = |so_far: bool, value: &f32| so_far & (value.abs() < limit);
        parts.all(|part| part.iter().fold(true, below))
    }

    /// Whether the rows have keys and values beside their queries.
    pub(super) fn has_keys(&self) -> bool {
        self.row == self.shape.row()
    }

    pub(super) fn heads(&self, token: usize, first: usize, count: usize) -> &'a [f32] {
        let start = token * self.row + first * self.shape.width;
        &self.values[start..start + count * self.shape.width]
    }

    /// The queries of the heads that share a key head.
    pub(super) fn queries(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(token, head * self.shape.group(), self.shape.group())
    }

    pub(super) fn key(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(token, self.shape.query_heads + head, 1)
    }

    pub(super) fn value(&self, token: usize, head: usize) -> &'a [f32] {
        self.heads(
            token,
            self.shape.query_heads + self.shape.key_heads + head,
            1,
        )
    }

    /// A query or key, rotated by its token's angles and scaled.
    pub(super) fn rotated(&self, token: usize, head: &[f32], scale: f32, out: &mut [f32]) {
        match self.rotary {
            Some(rotary) => rotary.rotate(token, head, scale, out),
            None => out
                .iter_mut()
                .zip(head)
                .for_each(|(out, value)| *out = value * scale),
        }
    }
}
