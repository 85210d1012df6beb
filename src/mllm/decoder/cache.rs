//! The key-value cache of a decoder.

use candle_core::Result;
use planagent_kernels::attention::{HeadShape, KeyValues, Precision, Projected};

/// Keys and values of every layer. It only grows and truncates, so an earlier state is a length.
/// Growth moves no data. Clones share memory until one of them writes.
#[derive(Debug, Clone)]
pub struct KvCache {
    layers: Vec<KeyValues>,
    len: usize,
    limit: usize,
}

impl KvCache {
    /// An empty cache of `depth` layers for at most `limit` positions.
    pub(crate) fn new(depth: usize, shape: HeadShape, precision: Precision, limit: usize) -> Self {
        Self {
            layers: vec![KeyValues::new(shape, precision); depth],
            len: 0,
            limit,
        }
    }

    /// Number of positions.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }

    pub(crate) fn check_room(&self, tokens: usize) -> Result<()> {
        let needed = self.len + tokens;
        if needed > self.limit {
            candle_core::bail!(
                "{needed} positions do not fit into a context of {}",
                self.limit
            );
        }
        Ok(())
    }

    /// Writes the keys and values of rows of a layer after the last position and returns all of
    /// that layer. When every layer has written, [`Self::advance`] counts the new positions.
    pub(crate) fn write(&mut self, layer: usize, rows: &Projected<'_>) -> Result<&KeyValues> {
        self.check_room(rows.tokens())?;
        let Some(layer) = self.layers.get_mut(layer) else {
            candle_core::bail!("the cache has no layer {layer}");
        };
        layer.write(rows, self.len)?;
        Ok(layer)
    }

    /// Counts `tokens` positions that every layer has written.
    pub(crate) fn advance(&mut self, tokens: usize) {
        self.len = (self.len + tokens).min(self.limit);
    }
}
