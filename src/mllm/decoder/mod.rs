//! Llama-style decoders: embedding, layers with what they keep of the positions before, RMS norm,
//! output layer.
//!
//! [`LlamaLayer`] is the layer of Llama, Mistral, Qwen, Gemma and LFM2. A family with another layer implements
//! [`DecoderLayer`], as [`StreamLayer`] is one. What it keeps is a [`LayerState`]: keys and values,
//! or a state that each position changes.

mod attention;
mod cache;
#[cfg(test)]
mod cache_tests;
mod delta_net;
mod head_norms;
mod layer;
mod layer_input;
mod llama;
mod mixer;
mod output_gate;
mod recurrence;
mod self_attention;
mod short_convolution;
mod stream_layer;
mod streams;
mod taps;

pub(crate) use attention::CausalAttention;
pub use cache::DecoderCache;
pub(crate) use cache::{LayerState, MAX_ROWS, MAX_STATES};
pub(crate) use layer::{DecoderLayer, Pass, SwiGlu, SwiGluShape, rms_norm};
use layer_input::LayerInputs;
pub(crate) use llama::LlamaLayer;
pub use planagent_kernels::attention::Position;
pub(crate) use stream_layer::StreamLayer;
use streams::Streams;

use super::MllmError;
use super::checkpoint::{LlamaConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::attention::RopeScaling;
use planagent_kernels::attention::{Precision, RotaryEmbedding};
use planagent_kernels::matrix::{Matrix, WeightFormat};
use planagent_kernels::{Awake, Linear, RmsNorm};
use std::ops::Range;

#[derive(Debug)]
pub(crate) struct Decoder<L> {
    embedding: Matrix,
    layers: Vec<L>,
    norm: RmsNorm,
    head: Linear,
    rotary: RotaryEmbedding,
    /// That of local layers; none where they have the same.
    local_rotary: Option<RotaryEmbedding>,
    /// Input rows of text are multiplied by it.
    embedding_scale: Option<f64>,
    layer_inputs: Option<LayerInputs>,
    /// Hidden states of a token beside one another; none where there is one.
    streams: Option<Streams>,
    /// Bound of logits.
    softcap: Option<f64>,
    precision: Precision,
}

/// Input of one forward pass.
#[derive(Debug)]
pub struct DecoderInput {
    /// Input rows, (tokens, hidden).
    pub rows: Tensor,
    /// The token of each row, for layers that read it once more; none for a row of an image.
    pub tokens: Vec<Option<u32>>,
    /// Position of each row for the rotary embedding.
    pub positions: Vec<Position>,
    /// The position behind the prompt that the rows belong to. A rotary embedding whose base grows
    /// with the prompt turns all its rows by this length; rows behind it by their own.
    pub prompt_end: usize,
    /// The rows of each image, in their order, for layers that tell an image from text.
    pub vision: Vec<Range<usize>>,
    /// Added to the hidden states after the first layers, one for each: (tokens, hidden).
    pub deep: Vec<Tensor>,
}

/// The positions of a forward pass whose logits the caller needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Logits {
    /// None; the pass only fills the cache.
    None,
    /// The last position.
    Last,
    /// So many of the last positions; at least one.
    Tail(usize),
    /// Every position.
    All,
}

/// A decoder over a cache of what its layers keep.
pub trait LanguageModel {
    /// The input rows of text tokens: (tokens, hidden).
    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor>;

    /// An empty cache for at most `limit` tokens.
    fn new_cache(&self, limit: usize) -> DecoderCache;

    /// Runs rows that follow the cached positions, adds them to the cache, and gives the logits
    /// (wanted positions, vocabulary).
    fn forward(
        &self,
        input: &DecoderInput,
        cache: &mut DecoderCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>>;

    /// Maximum number of text tokens in a pass with the same keys, values and logits, bit for bit,
    /// as passes of one token each. 1 where longer passes round differently; then nothing is
    /// drafted.
    fn exact_pass(&self) -> usize {
        1
    }

    /// The length that the keys of a prompt depend on which ends before position `end`; 0 where
    /// they do not. Keys that were computed for another length are of no use.
    fn rotary_length(&self, end: usize) -> usize {
        let _ = end;
        0
    }
}

impl<L: DecoderLayer> Decoder<L> {
    /// Takes the decoder's weights, whose names begin with `prefix`; the output layer is
    /// `lm_head.weight` in all families.
    pub(crate) fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        prefix: &str,
    ) -> Result<Self, MllmError> {
        let tied = config.is_tied(weights);
        let matrix = [config.vocabulary, config.hidden];
        let embedding = weights.take_matrix(&format!("{prefix}embed_tokens.weight"), matrix)?;
        // A checkpoint that holds both with the tying flag set is not tied (transformers:
        // `tie_weights`).
        let head = if tied && !weights.contains("lm_head.weight") {
            embedding.clone()
        } else {
            weights.take_matrix("lm_head.weight", matrix)?
        };
        // Beside rounded weights, f16 keys and values lose no relevant accuracy, and reads take
        // half of the time.
        let single = weights.is_lossless() || embedding.weight_format() == WeightFormat::F32;
        let precision = if single {
            Precision::Single
        } else {
            Precision::Half
        };
        let mut rotary = RotaryEmbedding::new(&config.rope, config.rotated, config.context);
        let factors = format!("{prefix}rope_freqs.weight");
        // A configuration that says how frequencies are scaled comes first.
        if config.rope.scaling == RopeScaling::None && weights.contains(&factors) {
            rotary = rotary.divided_by(
                &weights
                    .take(&factors, &[config.rotated / 2])?
                    .to_vec1::<f32>()?,
            );
        }
        let layers = (0..config.layers)
            .map(|index| L::take(weights, config, index, &format!("{prefix}layers.{index}")))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            embedding,
            layers,
            norm: rms_norm(weights, &format!("{prefix}norm"), config)?,
            head: Linear::from_matrix(head, None),
            rotary,
            local_rotary: config.gemma.as_ref().map(|gemma| {
                RotaryEmbedding::new(&gemma.local_rope, config.head_dim, config.context)
            }),
            embedding_scale: config.gemma.as_ref().map(|_| (config.hidden as f64).sqrt()),
            layer_inputs: LayerInputs::take(weights, config, prefix)?,
            streams: Streams::take(weights, config, prefix)?,
            softcap: config.softcap,
            precision,
        })
    }
}

impl<L: DecoderLayer> LanguageModel for Decoder<L> {
    fn new_cache(&self, limit: usize) -> DecoderCache {
        let states = self
            .layers
            .iter()
            .map(|layer| layer.new_state(self.precision));
        DecoderCache::new(states.collect(), limit)
    }

    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        let rows = self.embedding.rows(ids)?;
        match self.embedding_scale {
            Some(scale) => rows * scale,
            None => Ok(rows),
        }
    }

    fn exact_pass(&self) -> usize {
        self.layers.iter().map(L::exact_pass).min().unwrap_or(1)
    }

    fn rotary_length(&self, end: usize) -> usize {
        self.rotary.length(end)
    }

    fn forward(
        &self,
        input: &DecoderInput,
        cache: &mut DecoderCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        let tokens = input.rows.dim(0)?;
        let unfinished = cache.begin(tokens)?;
        let _threads = Awake::begin();
        let x = match self.run_layers(input, cache) {
            Ok(x) => x,
            Err(error) => {
                cache.undo(unfinished);
                return Err(error);
            }
        };
        // After the last layer, since every layer writes at the same positions.
        cache.advance(tokens);
        let x = match wanted {
            Logits::None => return Ok(None),
            Logits::Last => x.narrow(0, tokens - 1, 1)?.contiguous()?,
            Logits::Tail(count) => {
                let count = count.clamp(1, tokens);
                x.narrow(0, tokens - count, count)?.contiguous()?
            }
            Logits::All => x,
        };
        let x = match &self.streams {
            Some(streams) => streams.merge(&x)?,
            None => x,
        };
        let logits = self.head.forward(&self.norm.forward(&x)?)?;
        Ok(Some(match self.softcap {
            Some(cap) => ((logits / cap)?.tanh()? * cap)?,
            None => logits,
        }))
    }
}

impl<L: DecoderLayer> Decoder<L> {
    /// The hidden states behind the last layer.
    fn run_layers(
        &self,
        input: &DecoderInput,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        // Angles and inputs of layers are computed once for all layers.
        let mut pass = Pass {
            layer: 0,
            rotary: self.rotary.rows(&input.positions, input.prompt_end)?,
            local_rotary: self
                .local_rotary
                .as_ref()
                .map(|rotary| rotary.rows(&input.positions, input.prompt_end))
                .transpose()?,
            vision: input.vision.clone(),
            layer_inputs: self
                .layer_inputs
                .as_ref()
                .map(|inputs| inputs.forward(&input.rows, &input.tokens))
                .transpose()?,
        };
        let mut x = match &self.streams {
            Some(streams) => streams.split(&input.rows)?,
            None => input.rows.clone(),
        };
        for (index, layer) in self.layers.iter().enumerate() {
            pass.layer = index;
            x = layer.forward(&x, &pass, cache)?;
            if let Some(deep) = input.deep.get(index) {
                x = (x + deep)?;
            }
        }
        Ok(x)
    }
}
