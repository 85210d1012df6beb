//! Keys and values of the positions that the decoder has seen.

use candle_core::Result;

use crate::mllm::attention::{HeadShape, KeyValues, Precision, Projected};

/// The keys and values of every layer, append-only: going back to an earlier point of the chat is forgetting the rows
/// behind it, so a snapshot is a length. It grows without moving what it holds.
#[derive(Debug)]
pub struct KvCache {
    layers: Vec<KeyValues>,
    len: usize,
    limit: usize,
}

/// The first rows of a cache, to start other caches from; they share its memory until they write to it.
#[derive(Debug)]
pub(crate) struct KvPrefix {
    layers: Vec<KeyValues>,
    len: usize,
}

impl KvCache {
    /// An empty cache of `depth` layers for at most `limit` positions.
    pub(crate) fn new(depth: usize, shape: HeadShape, precision: Precision, limit: usize) -> Self {
        Self { layers: vec![KeyValues::new(shape, precision); depth], len: 0, limit }
    }

    /// Positions held.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Forgets the positions from `len` on.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }

    /// Checks that `tokens` more positions fit.
    ///
    /// # Errors
    /// When they do not.
    pub(crate) fn check_room(&self, tokens: usize) -> Result<()> {
        let needed = self.len + tokens;
        if needed > self.limit {
            candle_core::bail!("{needed} positions do not fit into a context of {}", self.limit);
        }
        Ok(())
    }

    /// Writes the keys and values of rows behind the positions held, and gives all of that layer.
    /// [`Self::advance`] makes them held once every layer has written.
    ///
    /// # Errors
    /// When there is no such layer, or no room.
    pub(crate) fn write(&mut self, layer: usize, rows: &Projected<'_>) -> Result<&KeyValues> {
        self.check_room(rows.tokens())?;
        let Some(layer) = self.layers.get_mut(layer) else {
            candle_core::bail!("the cache has no layer {layer}");
        };
        layer.write(rows, self.len)?;
        Ok(layer)
    }

    /// Takes `tokens` written positions as held.
    pub(crate) fn advance(&mut self, tokens: usize) {
        self.len = (self.len + tokens).min(self.limit);
    }

    /// The first `len` positions.
    pub(crate) fn prefix(&self, len: usize) -> KvPrefix {
        let len = len.min(self.len);
        KvPrefix { layers: self.layers.iter().map(|layer| layer.first(len)).collect(), len }
    }

    /// Holds a prefix and nothing else.
    ///
    /// # Errors
    /// When it does not fit.
    pub(crate) fn restore(&mut self, prefix: &KvPrefix) -> Result<()> {
        self.truncate(0);
        self.check_room(prefix.len)?;
        self.layers.clone_from(&prefix.layers);
        self.len = prefix.len;
        Ok(())
    }
}
