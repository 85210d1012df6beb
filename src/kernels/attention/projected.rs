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

/// Queries, keys and values of tokens before the rotary embedding.
#[derive(Debug, Clone, Copy)]
pub struct Projected<'a> {
    queries: Heads<'a>,
    /// Keys and values; none where queries attend to keys that are cached already.
    cached: Option<[Heads<'a>; 2]>,
    shape: HeadShape,
    tokens: usize,
    rotary: Option<&'a RotaryRows>,
}

/// Some heads of each token.
#[derive(Debug, Clone, Copy)]
struct Heads<'a> {
    values: &'a [f32],
    /// Numbers of a token.
    row: usize,
    /// Where the heads begin among them.
    first: usize,
}

impl<'a> Heads<'a> {
    /// Of a tensor that has nothing else.
    fn alone(values: &'a [f32], row: usize) -> Self {
        Self {
            values,
            row,
            first: 0,
        }
    }

    /// `count` numbers of a token, from number `at` on.
    fn get(&self, token: usize, at: usize, count: usize) -> &'a [f32] {
        let start = token * self.row + self.first + at;
        &self.values[start..start + count]
    }
}

impl<'a> Projected<'a> {
    /// Runs `read` on the rows of a tensor, (tokens, (query heads + 2 · key heads) · head width).
    /// `rotary` has the angles of queries and keys; `None` for no rotary embedding.
    pub fn read<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        let tokens = checked(tensor, shape.row(), shape, rotary)?;
        with_contiguous(tensor, |values| {
            let heads = |first| Heads {
                values,
                row: shape.row(),
                first: first * shape.width,
            };
            read(&Projected {
                queries: heads(0),
                cached: Some([
                    heads(shape.query_heads),
                    heads(shape.query_heads + shape.key_heads),
                ]),
                shape,
                tokens,
                rotary,
            })
        })
    }

    /// As [`Self::read`], of queries, keys and values in tensors of their own, (tokens, heads · head
    /// width).
    pub fn read_apart<T>(
        [queries, keys, values]: [&Tensor; 3],
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        let [of_query, of_key] = [shape.query_heads, shape.key_heads].map(|n| n * shape.width);
        let tokens = checked(queries, of_query, shape, rotary)?;
        for tensor in [keys, values] {
            if checked(tensor, of_key, shape, rotary)? != tokens {
                candle_core::bail!("queries are of {tokens} tokens, keys or values are not");
            }
        }
        with_contiguous(queries, |queries| {
            with_contiguous(keys, |keys| {
                with_contiguous(values, |values| {
                    read(&Projected {
                        queries: Heads::alone(queries, of_query),
                        cached: Some([keys, values].map(|values| Heads::alone(values, of_key))),
                        shape,
                        tokens,
                        rotary,
                    })
                })
            })
        })
    }

    /// As [`Self::read`], of queries alone, (tokens, query heads · head width), which attend to
    /// keys that are cached already.
    pub fn read_queries<T>(
        tensor: &Tensor,
        shape: HeadShape,
        rotary: Option<&'a RotaryRows>,
        read: impl FnOnce(&Projected<'_>) -> candle_core::Result<T>,
    ) -> candle_core::Result<T> {
        let width = shape.query_heads * shape.width;
        let tokens = checked(tensor, width, shape, rotary)?;
        with_contiguous(tensor, |values| {
            read(&Projected {
                queries: Heads::alone(values, width),
                cached: None,
                shape,
                tokens,
                rotary,
            })
        })
    }

    pub(super) fn shape(&self) -> HeadShape {
        self.shape
    }

    /// Number of tokens.
    pub fn tokens(&self) -> usize {
        self.tokens
    }

    /// Whether all magnitudes are below a limit; NaN is not.
    pub(super) fn are_below(&self, limit: f32) -> bool {
        // No early exit within a part: the compiler does not vectorize loops with one.
        let below = |so_far: bool, value: &f32| so_far & (value.abs() < limit);
        let all_below = |heads: &Heads<'_>| {
            let parts = heads.values.par_chunks(TASK_NUMBERS);
            parts.all(|part| part.iter().fold(true, below))
        };
        let of_queries = self.queries.values;
        // The heads of one tensor are read once.
        let others = self.cached.iter().flatten();
        all_below(&self.queries)
            && others
                .filter(|heads| !std::ptr::eq(heads.values, of_queries))
                .all(all_below)
    }

    /// Whether the rows have keys and values beside their queries.
    pub(super) fn has_keys(&self) -> bool {
        self.cached.is_some()
    }

    /// The queries of the heads that share a key head.
    pub(super) fn queries(&self, token: usize, head: usize) -> &'a [f32] {
        let count = self.shape.group() * self.shape.width;
        self.queries.get(token, head * count, count)
    }

    /// Nothing where [`Self::has_keys`] is false.
    pub(super) fn key(&self, token: usize, head: usize) -> &'a [f32] {
        self.of_cached(0, token, head)
    }

    /// Nothing where [`Self::has_keys`] is false.
    pub(super) fn value(&self, token: usize, head: usize) -> &'a [f32] {
        self.of_cached(1, token, head)
    }

    fn of_cached(&self, part: usize, token: usize, head: usize) -> &'a [f32] {
        let width = self.shape.width;
        let heads = self.cached.and_then(|cached| cached.get(part).copied());
        heads.map_or(&[], |heads| heads.get(token, head * width, width))
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

/// The tokens of a tensor, which has `width` numbers of each.
fn checked(
    tensor: &Tensor,
    width: usize,
    shape: HeadShape,
    rotary: Option<&RotaryRows>,
) -> candle_core::Result<usize> {
    let (tokens, row) = tensor.dims2()?;
    if row != width {
        candle_core::bail!("rows of {row} numbers are not {width} of {shape:?}");
    }
    if !shape.query_heads.is_multiple_of(shape.key_heads) {
        candle_core::bail!("{shape:?}: the heads of keys do not divide those of queries");
    }
    if rotary.is_some_and(|rotary| !rotary.fits(tokens, shape.width)) {
        candle_core::bail!("the rotary angles do not fit {tokens} tokens of {shape:?}");
    }
    Ok(tokens)
}
