//! The Llama decoder: RMS norm, rotary embedding, grouped-query attention, `SwiGLU`.

mod attention;
mod cache;
mod rotary;

use candle_core::Tensor;
use candle_nn::{Module, RmsNorm};

use attention::Attention;
pub(crate) use cache::{KvCache, KvPrefix};
use rotary::RotaryTable;

use super::MllmError;
use super::checkpoint::{LlamaConfig, LlavaConfig, Weights};
use super::linear::Linear;

/// A Llama decoder with its embedding and output layer.
#[derive(Debug)]
pub(crate) struct LlamaDecoder {
    embedding: Tensor,
    layers: Vec<Layer>,
    norm: RmsNorm,
    head: Linear,
    rotary: RotaryTable,
    config: LlamaConfig,
}

/// Of which positions of a forward pass the logits are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Logits {
    /// None: the pass only fills the cache.
    None,
    /// The last one.
    Last,
    /// Every one.
    #[cfg_attr(not(test), allow(dead_code))]
    All,
}

#[derive(Debug)]
struct Layer {
    input_norm: RmsNorm,
    attention: Attention,
    post_norm: RmsNorm,
    gate_up: Linear,
    down: Linear,
}

impl LlamaDecoder {
    /// Takes the decoder's weights.
    ///
    /// # Errors
    /// When a tensor is missing or misshapen.
    pub(crate) fn take(weights: &mut Weights, config: &LlavaConfig) -> Result<Self, MllmError> {
        let text = &config.text;
        let matrix = [text.vocabulary, text.hidden];
        let embedding = weights.take("language_model.embed_tokens.weight", &matrix)?;
        // A checkpoint that holds both with the tying flag set is not tied (transformers: `tie_weights`).
        let head = if config.tie_word_embeddings && !weights.contains("lm_head.weight") {
            embedding.clone()
        } else {
            weights.take("lm_head.weight", &matrix)?
        };
        let layers = (0..text.layers)
            .map(|index| Layer::take(weights, text, &format!("language_model.layers.{index}")))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            embedding,
            layers,
            norm: rms_norm(weights, "language_model.norm", text)?,
            head: Linear::from_matrix(&head)?,
            rotary: RotaryTable::new(text)?,
            config: text.clone(),
        })
    }

    /// An empty cache for this decoder.
    pub(crate) fn new_cache(&self) -> KvCache {
        KvCache::new(&self.config)
    }

    /// The input rows of tokens, shape (tokens, hidden).
    pub(crate) fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        let ids = Tensor::new(ids, self.embedding.device())?;
        self.embedding.index_select(&ids, 0)
    }

    /// Runs input rows (tokens, hidden) that follow what the cache holds, adds them to the cache, and gives the logits of
    /// shape (wanted positions, vocabulary).
    pub(crate) fn forward(
        &self,
        input: &Tensor,
        cache: &mut KvCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        let tokens = input.dim(0)?;
        cache.reserve(self.layers.len(), tokens)?;
        let mut x = input.clone();
        for (index, layer) in self.layers.iter().enumerate() {
            x = layer.forward(&x, index, &self.rotary, cache)?;
        }
        cache.advance(tokens);
        let x = match wanted {
            Logits::None => return Ok(None),
            Logits::Last => x.narrow(0, tokens - 1, 1)?.contiguous()?,
            Logits::All => x,
        };
        Ok(Some(self.head.forward(&self.norm.forward(&x)?)?))
    }
}

impl Layer {
    fn take(weights: &mut Weights, config: &LlamaConfig, name: &str) -> Result<Self, MllmError> {
        let (hidden, wide) = (config.hidden, config.intermediate);
        let gate_up = [(format!("{name}.mlp.gate_proj"), wide), (format!("{name}.mlp.up_proj"), wide)];
        Ok(Self {
            input_norm: rms_norm(weights, &format!("{name}.input_layernorm"), config)?,
            attention: Attention::take(weights, config, &format!("{name}.self_attn"))?,
            post_norm: rms_norm(weights, &format!("{name}.post_attention_layernorm"), config)?,
            gate_up: Linear::take_fused(weights, &gate_up, hidden, config.mlp_bias)?,
            down: Linear::take(weights, &format!("{name}.mlp.down_proj"), wide, hidden, config.mlp_bias)?,
        })
    }

    fn forward(
        &self,
        x: &Tensor,
        index: usize,
        rotary: &RotaryTable,
        cache: &mut KvCache,
    ) -> candle_core::Result<Tensor> {
        let x = (x + self.attention.forward(&self.input_norm.forward(x)?, index, rotary, cache)?)?;
        let gate_up = self.gate_up.forward(&self.post_norm.forward(&x)?)?;
        let wide = gate_up.dim(1)? / 2;
        // Contiguous halves: element-wise operations on strided rows are several times slower than the copy.
        let gate = gate_up.narrow(1, 0, wide)?.contiguous()?;
        let up = gate_up.narrow(1, wide, wide)?.contiguous()?;
        &x + self.down.forward(&(gate.silu()? * up)?)?
    }
}

fn rms_norm(weights: &mut Weights, name: &str, config: &LlamaConfig) -> Result<RmsNorm, MllmError> {
    let weight = weights.take(&format!("{name}.weight"), &[config.hidden])?;
    Ok(RmsNorm::new(weight, config.rms_norm_eps))
}
