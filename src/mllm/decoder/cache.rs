//! Keys and values of the positions that the decoder has seen.

use candle_core::{DType, Device, Result, Tensor};

/// Positions by which a cache grows at least.
const BLOCK: usize = 256;

/// The keys and values of every layer, append-only: going back to an earlier point of the chat is forgetting the rows
/// behind it, so a snapshot is a length.
#[derive(Debug)]
pub(crate) struct KvCache {
    layers: Vec<LayerCache>,
    depth: usize,
    len: usize,
    capacity: usize,
    limit: usize,
    row: (usize, usize),
}

/// Keys and values of one layer, each of shape (1, capacity, key heads, head width), filled from the front.
#[derive(Debug)]
struct LayerCache {
    keys: Tensor,
    values: Tensor,
}

/// A copy of the first rows of a cache, to start other caches from.
#[derive(Debug)]
pub(crate) struct KvPrefix {
    layers: Vec<LayerCache>,
    len: usize,
}

impl KvCache {
    /// An empty cache of `depth` layers for at most `limit` positions; `row` are the number and width of the key heads.
    pub(crate) fn new(depth: usize, row: (usize, usize), limit: usize) -> Self {
        Self { layers: Vec::with_capacity(depth), depth, len: 0, capacity: 0, limit, row }
    }

    /// Positions held.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Forgets the positions from `len` on.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.len = self.len.min(len);
    }

    /// Makes room for `tokens` more positions.
    pub(crate) fn reserve(&mut self, tokens: usize) -> Result<()> {
        let needed = self.len + tokens;
        if needed > self.limit {
            candle_core::bail!("{needed} positions do not fit into a context of {}", self.limit);
        }
        if needed <= self.capacity && self.layers.len() == self.depth {
            return Ok(());
        }
        let capacity = needed.max(self.capacity * 2).next_multiple_of(BLOCK).min(self.limit).max(needed);
        let shape = (1, capacity, self.row.0, self.row.1);
        let len = self.len;
        let mut grown = Vec::with_capacity(self.depth);
        for index in 0..self.depth {
            let layer = LayerCache {
                keys: Tensor::zeros(shape, DType::F32, &Device::Cpu)?,
                values: Tensor::zeros(shape, DType::F32, &Device::Cpu)?,
            };
            if let (Some(old), true) = (self.layers.get(index), len > 0) {
                layer.keys.slice_set(&old.keys.narrow(1, 0, len)?, 1, 0)?;
                layer.values.slice_set(&old.values.narrow(1, 0, len)?, 1, 0)?;
            }
            grown.push(layer);
        }
        self.layers = grown;
        self.capacity = capacity;
        Ok(())
    }

    /// Writes keys and values (1, tokens, key heads, head width) of a layer behind the positions held, and gives all of
    /// that layer up to and including them. [`Self::advance`] makes them held once every layer has written.
    pub(crate) fn write(&mut self, layer: usize, keys: &Tensor, values: &Tensor) -> Result<(Tensor, Tensor)> {
        let tokens = keys.dim(1)?;
        let end = self.len + tokens;
        let Some(layer) = self.layers.get(layer).filter(|_| end <= self.capacity) else {
            candle_core::bail!("the cache has no room for position {end} of layer {layer}");
        };
        layer.keys.slice_set(keys, 1, self.len)?;
        layer.values.slice_set(values, 1, self.len)?;
        Ok((layer.keys.narrow(1, 0, end)?, layer.values.narrow(1, 0, end)?))
    }

    /// Takes `tokens` written positions as held.
    pub(crate) fn advance(&mut self, tokens: usize) {
        self.len = (self.len + tokens).min(self.capacity);
    }

    /// Copies the first `len` positions.
    pub(crate) fn prefix(&self, len: usize) -> Result<KvPrefix> {
        let len = len.min(self.len);
        let layers = self
            .layers
            .iter()
            .map(|layer| {
                Ok(LayerCache {
                    keys: layer.keys.narrow(1, 0, len)?.copy()?,
                    values: layer.values.narrow(1, 0, len)?.copy()?,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(KvPrefix { layers, len })
    }

    /// Fills an empty cache with a prefix.
    pub(crate) fn restore(&mut self, prefix: &KvPrefix) -> Result<()> {
        self.truncate(0);
        if prefix.len == 0 {
            return Ok(());
        }
        self.reserve(prefix.len)?;
        for (layer, saved) in self.layers.iter().zip(&prefix.layers) {
            layer.keys.slice_set(&saved.keys, 1, 0)?;
            layer.values.slice_set(&saved.values, 1, 0)?;
        }
        self.advance(prefix.len);
        Ok(())
    }
}
