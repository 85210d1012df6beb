//! Cached keys and values in the layout that the attention kernel reads.

use super::projected::{HeadShape, Projected};
use crate::matrix::{LANES, Simd};
use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};
use rayon::prelude::*;
use std::sync::Arc;

/// Positions of a block.
pub(super) const BLOCK_POSITIONS: usize = 64;

/// A number type of cached keys and values: f32, or the bits of an f16.
pub(super) trait StoredFloat: Copy + Default + Send + Sync + std::fmt::Debug {
    const IS_F32: bool;
    fn from_f32(from: &[f32], to: &mut [Self]);
    fn load<S: Simd>(simd: S, from: &[Self; LANES]) -> S::Floats;
}

impl StoredFloat for f32 {
    const IS_F32: bool = true;

    fn from_f32(from: &[f32], to: &mut [Self]) {
        to.copy_from_slice(from);
    }

    #[inline(always)]
    fn load<S: Simd>(simd: S, from: &[Self; LANES]) -> S::Floats {
        simd.load(from)
    }
}

impl StoredFloat for u16 {
    const IS_F32: bool = false;

    fn from_f32(from: &[f32], to: &mut [Self]) {
        to.reinterpret_cast_mut::<f16>()
            .convert_from_f32_slice(from);
    }

    #[inline(always)]
    fn load<S: Simd>(simd: S, from: &[Self; LANES]) -> S::Floats {
        simd.load_half(from)
    }
}

/// Number type of cached keys and values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// f32, as computed.
    Single,
    /// f16: a decoding step reads half of the memory.
    Half,
}

/// Keys and values of one layer in blocks. Growth adds blocks and moves none. Clones share blocks
/// until one of them writes.
#[derive(Debug, Clone)]
pub struct KeyValues {
    pub(super) shape: HeadShape,
    pub(super) blocks: Blocks,
}

#[derive(Debug, Clone)]
pub(super) enum Blocks {
    Single(Vec<Arc<Block<f32>>>),
    Half(Vec<Arc<Block<u16>>>),
}

/// Keys and values of [`BLOCK`] positions.
#[derive(Debug, Clone)]
pub(super) struct Block<N> {
    /// (key heads, head width, positions): a vector of keys is one channel of consecutive
    /// positions.
    keys: Vec<N>,
    /// (key heads, positions, head width rounded up to whole vectors).
    values: Vec<N>,
}

impl<N: StoredFloat> Block<N> {
    fn new(shape: HeadShape) -> Self {
        Self {
            keys: vec![N::default(); shape.key_heads * shape.width * BLOCK_POSITIONS],
            values: vec![N::default(); shape.key_heads * BLOCK_POSITIONS * shape.padded()],
        }
    }

    /// The keys of a head, (head width, vectors of positions).
    pub(super) fn keys(&self, shape: HeadShape, head: usize) -> &[[N; LANES]] {
        self.keys
            .chunks_exact(shape.width * BLOCK_POSITIONS)
            .nth(head)
            .expect("the head is one of the block")
            .as_chunks()
            .0
    }

    /// The values of a head, (positions, vectors of channels).
    pub(super) fn values(&self, shape: HeadShape, head: usize) -> &[[N; LANES]] {
        self.values
            .chunks_exact(BLOCK_POSITIONS * shape.padded())
            .nth(head)
            .expect("the head is one of the block")
            .as_chunks()
            .0
    }

    /// Writes keys and values of `tokens` from index `first` of the block on.
    fn write(&mut self, rows: &Projected<'_>, tokens: std::ops::Range<usize>, first: usize) {
        let shape = rows.shape();
        let mut key = vec![0f32; shape.width];
        let mut number = vec![N::default(); shape.width];
        for (place, token) in (first..).zip(tokens) {
            for (head, keys) in self
                .keys
                .chunks_exact_mut(shape.width * BLOCK_POSITIONS)
                .enumerate()
            {
                rows.rotated(token, rows.key(token, head), 1.0, &mut key);
                N::from_f32(&key, &mut number);
                for (number, channel) in number.iter().zip(keys.chunks_exact_mut(BLOCK_POSITIONS)) {
                    channel[place] = *number;
                }
            }
            let padded = shape.padded();
            for (head, values) in self
                .values
                .chunks_exact_mut(BLOCK_POSITIONS * padded)
                .enumerate()
            {
                let at = place * padded;
                N::from_f32(rows.value(token, head), &mut values[at..at + shape.width]);
            }
        }
    }
}

impl KeyValues {
    /// Room for no position yet.
    pub fn new(shape: HeadShape, precision: Precision) -> Self {
        let blocks = match precision {
            Precision::Single => Blocks::Single(Vec::new()),
            Precision::Half => Blocks::Half(Vec::new()),
        };
        Self { shape, blocks }
    }

    /// Writes the rotated keys and the values of rows to the positions from `start` on.
    pub fn write(&mut self, rows: &Projected<'_>, start: usize) -> candle_core::Result<()> {
        if rows.shape() != self.shape {
            candle_core::bail!(
                "cannot write keys and values of {:?} to a cache of {:?}",
                rows.shape(),
                self.shape
            );
        }
        if !rows.has_keys() {
            candle_core::bail!("queries alone have no keys and values to write");
        }
        match &mut self.blocks {
            Blocks::Single(blocks) => write(blocks, rows, start),
            Blocks::Half(blocks) => write(blocks, rows, start),
        }
        Ok(())
    }

    /// Bytes of a number.
    pub(super) fn number_bytes(&self) -> usize {
        match self.blocks {
            Blocks::Single(_) => size_of::<f32>(),
            Blocks::Half(_) => size_of::<half::f16>(),
        }
    }

    /// Positions of the allocated blocks.
    pub(super) fn capacity(&self) -> usize {
        match &self.blocks {
            Blocks::Single(blocks) => blocks.len() * BLOCK_POSITIONS,
            Blocks::Half(blocks) => blocks.len() * BLOCK_POSITIONS,
        }
    }
}

fn write<N: StoredFloat>(blocks: &mut Vec<Arc<Block<N>>>, rows: &Projected<'_>, start: usize) {
    let end = start + rows.tokens();
    blocks.resize_with(end.div_ceil(BLOCK_POSITIONS).max(blocks.len()), || {
        Arc::new(Block::new(rows.shape()))
    });
    let write = |(index, block): (usize, &mut Arc<Block<N>>)| {
        let base = index * BLOCK_POSITIONS;
        let (from, to) = (start.max(base), end.min(base + BLOCK_POSITIONS));
        Arc::make_mut(block).write(rows, from - start..to - start, from - base);
    };
    let touched = start / BLOCK_POSITIONS..end.div_ceil(BLOCK_POSITIONS);
    let blocks = blocks
        .iter_mut()
        .enumerate()
        .take(touched.end)
        .skip(touched.start);
    if touched.len() == 1 {
        blocks.for_each(write);
    } else {
        blocks.collect::<Vec<_>>().into_par_iter().for_each(write);
    }
}
