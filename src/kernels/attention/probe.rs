//! One attention with a filled cache, for `benches/candle.rs`.

use super::{AttentionMask, HeadShape, KeyValues, Precision, Projected, attend};
use candle_core::{Result, Tensor};

/// Causal attention of the last tokens of a context over all of its positions.
#[derive(Debug)]
pub struct AttentionProbe {
    shape: HeadShape,
    cached: KeyValues,
    /// Queries, keys and values of the last tokens.
    last: Tensor,
    mask: AttentionMask<'static>,
}

impl AttentionProbe {
    /// Caches the keys and values of `all`, (positions, (query heads + 2 · key heads) · head
    /// width), in f16 if `half`. The queries are those of the last `tokens` positions.
    pub fn new(
        all: &Tensor,
        [query_heads, key_heads, width]: [usize; 3],
        tokens: usize,
        half: bool,
    ) -> Result<Self> {
        let shape = HeadShape {
            query_heads,
            key_heads,
            width,
        };
        let mut cached = KeyValues::new(
            shape,
            if half {
                Precision::Half
            } else {
                Precision::Single
            },
        );
        // The cache is filled as in decoding, so that the benchmark reads the layout that models
        // read.
        Projected::read(all, shape, None, |rows| cached.write(rows, 0))?;
        let start = all.dim(0)? - tokens;
        let mask = AttentionMask::Causal {
            start,
            window: None,
        };
        Ok(Self {
            shape,
            cached,
            last: all.narrow(0, start, tokens)?,
            mask,
        })
    }

    /// Attends; returns (tokens, query heads · head width).
    pub fn run(&self) -> Result<Tensor> {
        Projected::read(&self.last, self.shape, None, |rows| {
            attend(rows, &self.cached, self.mask)
        })
    }
}
