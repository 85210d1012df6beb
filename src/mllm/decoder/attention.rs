//! Causal attention of a layer over the key-value cache.

use super::cache::{DecoderCache, LayerState};
use super::layer::Pass;
use crate::checkpoint::{LayerKeys, LlamaConfig};
use candle_core::Tensor;
use planagent_kernels::attention::{
    AttentionMask, HeadShape, Precision, Projected, attend, exact_tokens,
};

/// Causal attention of a layer, without the projections.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CausalAttention {
    shape: HeadShape,
    window: Option<usize>,
    /// Whether the layer has the rotary embedding of local layers.
    local: bool,
    /// Whether the tokens of an image see one another.
    image_at_once: bool,
    /// The earlier layer whose keys and values it attends to; none for its own.
    keys_of: Option<usize>,
}

impl CausalAttention {
    /// That of a layer, by its number from 0.
    pub(crate) fn new(config: &LlamaConfig, layer: usize) -> Self {
        let local = config.gemma.as_ref().filter(|gemma| gemma.is_local(layer));
        let shape = config.shape(layer);
        Self {
            shape: HeadShape {
                key_heads: shape.kv_heads,
                width: shape.head_dim,
                ..config.into()
            },
            window: local.map_or(config.window, |gemma| Some(gemma.window)),
            local: local.is_some(),
            image_at_once: config
                .gemma
                .as_ref()
                .is_some_and(|gemma| gemma.sees_image(layer)),
            keys_of: match shape.keys {
                LayerKeys::Of(layer) => Some(layer),
                LayerKeys::Projected | LayerKeys::AsValues => None,
            },
        }
    }

    /// As [`LanguageModel::exact_pass`](super::LanguageModel::exact_pass). A window cuts the
    /// positions of each token elsewhere.
    pub(crate) fn exact_pass(&self) -> usize {
        if self.window.is_some() {
            1
        } else {
            exact_tokens(self.shape)
        }
    }

    /// Its keys and values of a sequence that is empty.
    pub(crate) fn new_state(&self, precision: Precision) -> LayerState {
        match self.keys_of {
            Some(_) => LayerState::nothing(),
            None => LayerState::key_values(self.shape, precision),
        }
    }

    /// Attends from tokens that follow the cached positions. `qkv` has their queries, keys and
    /// values, (tokens, (heads + 2 · key heads) · head width), or their queries alone in a layer
    /// that attends to the keys of an earlier one; the result is (tokens, heads · head width).
    pub(crate) fn forward(
        &self,
        qkv: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let (start, window) = (cache.len(), self.window);
        let seen = pass.vision.iter().filter(|_| self.image_at_once);
        let blocks: Vec<[usize; 2]> = seen
            .map(|rows| [start + rows.start, start + rows.end])
            .collect();
        let mask = if blocks.is_empty() {
            AttentionMask::Causal { start, window }
        } else {
            AttentionMask::CausalWithBlocks {
                start,
                window,
                blocks: &blocks,
            }
        };
        let rotary = Some(pass.rotary(self.local));
        match self.keys_of {
            Some(layer) => Projected::read_queries(qkv, self.shape, rotary, |rows| {
                attend(rows, cache.keys(layer)?, mask)
            }),
            None => Projected::read(qkv, self.shape, rotary, |rows| {
                attend(rows, cache.write(pass.layer, rows)?, mask)
            }),
        }
    }
}

impl From<&LlamaConfig> for HeadShape {
    fn from(config: &LlamaConfig) -> Self {
        Self {
            query_heads: config.heads,
            key_heads: config.kv_heads,
            width: config.head_dim,
        }
    }
}
