//! The configuration of a decoder of Llama's kind: Llama, Mistral, Qwen, Gemma and LFM2.

use super::config::{
    ConfigObject, MAX_CONTEXT, MAX_HEAD, MAX_LAYERS, MAX_WIDTH, check_ranges, check_width, count,
    optional_count, positive,
};
use super::convolution_config::{ConvolutionConfig, feed_forward_width};
use super::decoder_type::DecoderType;
use super::delta_config::DeltaConfig;
use super::gemma_config::GemmaConfig;
use super::layer_shape::{LayerInputConfig, LayerKeys, LayerShape};
use super::rope_config::{ReadRope, read_rope};
use super::stream_config::{StreamConfig, split_widths};
use super::weights::Weights;
use crate::MllmError;
use planagent_kernels::Linear;
use planagent_kernels::attention::{Rope, RopeScaling, RotarySections, frequencies};
use serde::Deserialize;

/// A Llama decoder (`LlamaConfig`), or one of its relatives with other defaults: Mistral has a
/// window, Qwen 2 (`Qwen2Config`) biases of queries, keys and values, Qwen 3 (`Qwen3Config`) norms
/// of queries and keys, Gemma 3, 3n and 4 (`Gemma3TextConfig`, `Gemma3nTextConfig`, `Gemma4TextConfig`) what [`Self::gemma`] has, and LFM2
/// (`Lfm2Config`) and Qwen 3.5 (`Qwen3_5TextConfig`) layers without attention.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "these are the keys of configuration files"
)]
pub struct LlamaConfig {
    /// Number of token ids.
    #[serde(rename = "vocab_size", deserialize_with = "count")]
    pub vocabulary: usize,
    /// Width of the hidden states.
    #[serde(rename = "hidden_size", deserialize_with = "count")]
    pub hidden: usize,
    /// Width of the feed-forward layers.
    #[serde(rename = "intermediate_size", deserialize_with = "count")]
    pub intermediate: usize,
    #[serde(rename = "num_hidden_layers", deserialize_with = "count")]
    pub layers: usize,
    /// Number of query heads.
    #[serde(rename = "num_attention_heads", deserialize_with = "count")]
    pub heads: usize,
    /// Number of key and value heads, a divisor of the query heads. The default is as many as query
    /// heads.
    #[serde(rename = "num_key_value_heads", deserialize_with = "count")]
    pub kv_heads: usize,
    /// Width of a head. The default is the hidden width divided by the heads.
    #[serde(deserialize_with = "count")]
    pub head_dim: usize,
    /// Positions that a chat may have: those of the training, or those that its rotary embedding is
    /// lengthened to.
    #[serde(rename = "max_position_embeddings", deserialize_with = "count")]
    pub context: usize,
    #[serde(deserialize_with = "positive")]
    pub rms_norm_eps: f64,
    #[serde(skip)]
    pub(crate) rope: Rope,
    /// Channels of a head that are rotated, the first ones.
    #[serde(skip)]
    pub(crate) rotated: usize,
    /// Whether the projections to queries, keys and values have biases.
    pub attention_bias: bool,
    /// Whether the attention's output projection has a bias.
    #[serde(skip)]
    pub(crate) output_bias: bool,
    /// Whether queries and keys are normalized in each head.
    #[serde(skip)]
    pub(crate) head_norms: bool,
    /// Whether values are normalized in each head too, without a weight.
    #[serde(skip)]
    pub(crate) value_norms: bool,
    /// Whether a layer multiplies its rows by a number at last.
    #[serde(skip)]
    pub(crate) layer_scales: bool,
    /// Whether the attention's output is multiplied by a gate that each query has beside it.
    #[serde(skip)]
    pub(crate) output_gate: bool,
    /// Whether norms multiply by 1 + weight.
    #[serde(skip)]
    pub(crate) norms_add_one: bool,
    /// Whether the feed-forward layers have biases.
    pub mlp_bias: bool,
    /// Positions that a token sees, its own among them; none for all.
    #[serde(rename = "sliding_window", deserialize_with = "optional_count")]
    pub window: Option<usize>,
    /// Whether the output layer may share the embedding's weights.
    pub tie_word_embeddings: bool,
    /// Bound of logits: l becomes cap · tanh(l / cap).
    #[serde(skip)]
    pub(crate) softcap: Option<f64>,
    /// Numbers of a token for each layer.
    #[serde(skip)]
    pub(crate) layer_inputs: Option<LayerInputConfig>,
    /// Several streams of hidden states, of which layers work on one.
    #[serde(skip)]
    pub(crate) streams: Option<StreamConfig>,
    /// What Gemma 3, 3n and 4 have beyond the others.
    #[serde(skip)]
    pub(crate) gemma: Option<GemmaConfig>,
    /// The layers that convolve the last positions in the place of attention.
    #[serde(skip)]
    pub(crate) convolution: Option<ConvolutionConfig>,
    /// The layers with a gated delta rule in the place of attention.
    #[serde(skip)]
    pub(crate) delta: Option<DeltaConfig>,
}

/// The defaults of `LlamaConfig`. Zero heads and widths are set once the others are known.
impl Default for LlamaConfig {
    fn default() -> Self {
        // The numbers are those of the class in transformers.
        Self {
            vocabulary: 32_000,
            hidden: 4096,
            intermediate: 11_008,
            layers: 32,
            heads: 32,
            kv_heads: 0,
            head_dim: 0,
            context: 2048,
            rms_norm_eps: 1e-6,
            rope: Rope::default(),
            rotated: 0,
            attention_bias: false,
            output_bias: false,
            head_norms: false,
            value_norms: false,
            layer_scales: false,
            output_gate: false,
            norms_add_one: false,
            mlp_bias: false,
            window: None,
            tie_word_embeddings: false,
            softcap: None,
            layer_inputs: None,
            streams: None,
            gemma: None,
            convolution: None,
            delta: None,
        }
    }
}

impl LlamaConfig {
    /// Makes a layer of one whose inputs no norm precedes. In Gemma 3 these have outliers, so that
    /// one term of eight bits loses too much (docs/decisions/131-two-terms.md).
    pub(crate) fn without_norm_before(&self, layer: Linear) -> Linear {
        match self.gemma {
            Some(_) => layer.in_two_terms(),
            None => layer,
        }
    }

    /// Reads a `text_config`, of the class `unnamed` if it has no `model_type`.
    pub(crate) fn read(text: ConfigObject<'_>, unnamed: DecoderType) -> Result<Self, MllmError> {
        let kind = text.value("model_type")?.unwrap_or(unnamed);
        Self::read_as(text, kind)
    }

    /// Reads the keys of a decoder of this kind.
    pub(crate) fn read_as(text: ConfigObject<'_>, kind: DecoderType) -> Result<Self, MllmError> {
        let (text, widths) = if kind == DecoderType::Gemma3n {
            split_widths(text)?
        } else {
            (text, None)
        };
        let mut text = text.with_defaults(kind.defaults());
        text.only_neutral(kind.neutral())?;
        // Left out, it has the class's default; null means as many as query heads.
        if text.is_null(KV_HEADS) {
            text.remove(KV_HEADS);
        }
        let mut config: Self = text.read()?;
        // First, because the width of a head may follow from it.
        check_ranges(&text, &[("num_attention_heads", config.heads, MAX_LAYERS)])?;
        let context = [("max_position_embeddings", config.context, MAX_CONTEXT)];
        check_ranges(&text, &context)?;
        let ReadRope {
            rope,
            context,
            part,
        } = read_rope(&text, kind, config.context)?;
        (config.rope, config.context) = (rope, context);
        if config.kv_heads == 0 {
            config.kv_heads = config.heads;
        }
        if config.head_dim == 0 {
            if !config.hidden.is_multiple_of(config.heads) {
                let problem = format!(
                    "{} is no multiple of {} attention heads",
                    config.hidden, config.heads
                );
                return Err(text.error("hidden_size", problem));
            }
            config.head_dim = config.hidden / config.heads;
        }
        // Rounded off, as in transformers; the small number is far below a channel.
        config.rotated = (config.head_dim as f64 * part + 1e-6) as usize;
        if kind.is_qwen() {
            check_no_window(&text, config.layers)?;
        }
        if kind == DecoderType::Gemma3 {
            config.gemma = Some(GemmaConfig::read(&text, &config)?);
        }
        if kind == DecoderType::Gemma3n {
            config.read_gemma3n(&text, widths)?;
        }
        if kind == DecoderType::Gemma4 {
            config.read_gemma4(&text)?;
        }
        if kind == DecoderType::Lfm2 {
            config.read_lfm2(&text)?;
        }
        if kind == DecoderType::Qwen35 {
            config.delta = Some(DeltaConfig::read(&text, config.layers)?);
            config.output_gate = true;
        }
        config.norms_add_one = matches!(kind, DecoderType::Gemma3 | DecoderType::Qwen35);
        if kind != DecoderType::Mistral {
            config.window = None;
        }
        config.attention_bias &= kind != DecoderType::Lfm2;
        config.output_bias = config.attention_bias && !kind.is_qwen2();
        config.attention_bias |= kind.is_qwen2();
        let normed = config.gemma.is_some() || config.convolution.is_some();
        config.head_norms = normed || kind.is_qwen() && !kind.is_qwen2();
        config.mlp_bias &= !kind.is_qwen() && !normed;
        config.check_sizes(&text)?;
        config
            .validate()
            .map_err(|(key, problem)| text.error(key, problem))?;
        Ok(config)
    }

    /// Reads the keys of `Gemma4TextConfig` that Llama does not have.
    fn read_gemma4(&mut self, text: &ConfigObject<'_>) -> Result<(), MllmError> {
        // Before anything is made for each layer.
        check_ranges(text, &[("num_hidden_layers", self.layers, MAX_LAYERS)])?;
        let gemma = GemmaConfig::read_varied(text, self)?;
        if let Some(shapes) = &gemma.shapes {
            self.rotated = shapes.global[1];
        }
        self.gemma = Some(gemma);
        self.layer_inputs = LayerInputConfig::read(text, self)?;
        self.softcap = text.positive("final_logit_softcapping")?;
        (self.value_norms, self.layer_scales) = (true, true);
        Ok(())
    }

    /// Reads the keys of `Gemma3nTextConfig` that Llama does not have; `widths` are those of the
    /// layers' feed-forward networks where they are listed.
    fn read_gemma3n(
        &mut self,
        text: &ConfigObject<'_>,
        widths: Option<Vec<usize>>,
    ) -> Result<(), MllmError> {
        // Before anything is made for each layer.
        check_ranges(text, &[("num_hidden_layers", self.layers, MAX_LAYERS)])?;
        self.gemma = Some(GemmaConfig::read_sharing(text, self)?);
        self.layer_inputs = Some(LayerInputConfig::read_shorter(text, self)?);
        self.streams = Some(StreamConfig::read(text, self, widths)?);
        self.softcap = text.positive("final_logit_softcapping")?;
        self.value_norms = true;
        Ok(())
    }

    /// The width of a layer's feed-forward network, by its number from 0.
    pub(super) fn width(&self, layer: usize) -> usize {
        let streams = self.streams.as_ref();
        let own = streams.and_then(|streams| streams.widths.get(layer));
        own.copied().unwrap_or(self.intermediate)
    }

    /// The shape of a layer with attention, by its number from 0.
    pub(crate) fn shape(&self, layer: usize) -> LayerShape {
        let gemma = self.gemma.as_ref();
        let varied = gemma.and_then(|gemma| Some((gemma.shapes?, gemma.is_local(layer))));
        match varied {
            Some((shapes, is_local)) => shapes.layer(self, layer, is_local),
            None => LayerShape {
                kv_heads: self.kv_heads,
                head_dim: self.head_dim,
                intermediate: self.intermediate,
                keys: LayerKeys::Projected,
            },
        }
    }

    /// Numbers of the keys that a layer keeps of a position; none of a layer that keeps none.
    pub(crate) fn kept_keys(&self, layer: usize) -> Option<usize> {
        let shape = self.shape(layer);
        let shares = matches!(shape.keys, LayerKeys::Of(_));
        (self.attends(layer) && !shares).then(|| shape.kv_heads.saturating_mul(shape.head_dim))
    }

    /// Numbers of the queries that a layer asks for a position; 0 for a layer without attention.
    pub(crate) fn queries(&self, layer: usize) -> usize {
        let width = self.heads.saturating_mul(self.shape(layer).head_dim);
        if self.attends(layer) { width } else { 0 }
    }

    /// Whether a layer attends to earlier positions in place of a state of its own.
    fn attends(&self, layer: usize) -> bool {
        let delta = self.delta.as_ref();
        let convolution = self.convolution.as_ref();
        !delta.is_some_and(|own| own.is_in(layer))
            && !convolution.is_some_and(|own| own.is_in(layer))
    }

    /// Reads the keys of `Lfm2Config` that Llama does not have, or calls otherwise.
    fn read_lfm2(&mut self, text: &ConfigObject<'_>) -> Result<(), MllmError> {
        self.rms_norm_eps = text.positive("norm_eps")?.unwrap_or(self.rms_norm_eps);
        // The name of older files.
        if let Some(tied) = text.value("tie_embedding")? {
            self.tie_word_embeddings = tied;
        }
        self.intermediate = feed_forward_width(text, self.intermediate)?;
        self.convolution = Some(ConvolutionConfig::read(text, self.layers)?);
        Ok(())
    }

    /// Layers that keep keys and values.
    #[cfg(test)]
    pub(crate) fn attention_layers(&self) -> usize {
        (0..self.layers)
            .filter(|layer| self.kept_keys(*layer).is_some())
            .count()
    }

    /// What layers keep that keep no keys and values.
    pub(crate) fn own_state(&self) -> OwnState {
        let count =
            |is_in: &dyn Fn(usize) -> bool| (0..self.layers).filter(|layer| is_in(*layer)).count();
        if let Some(delta) = &self.delta {
            return OwnState {
                layers: count(&|layer| delta.is_in(layer)),
                state: delta.state(),
                row: delta.row(),
            };
        }
        let Some(convolution) = &self.convolution else {
            return OwnState::default();
        };
        OwnState {
            layers: count(&|layer| convolution.is_in(layer)),
            state: (convolution.taps - 1).saturating_mul(self.hidden),
            row: self.hidden,
        }
    }

    /// Whether the embedding is the output layer: the configuration says so, or the files have no
    /// other. One rule for all families; the second case is noted.
    pub(crate) fn is_tied(&self, weights: &mut Weights) -> bool {
        let lacking = weights.lacks("lm_head.weight");
        if lacking && !self.tie_word_embeddings {
            weights.note(
                "the files have no lm_head.weight, which the configuration promises (tie_word_embeddings: false): the \
                 embedding is the output layer"
                    .into(),
            );
        }
        lacking || self.tie_word_embeddings
    }

    /// Checks each number, then the products that decide how much memory is taken.
    fn check_sizes(&self, text: &ConfigObject<'_>) -> Result<(), MllmError> {
        check_ranges(
            text,
            &[
                ("hidden_size", self.hidden, MAX_WIDTH),
                ("intermediate_size", self.intermediate, MAX_WIDTH),
                ("num_hidden_layers", self.layers, MAX_LAYERS),
                (KV_HEADS, self.kv_heads, MAX_LAYERS),
                ("head_dim", self.head_dim, MAX_HEAD),
            ],
        )?;
        if self.layer_inputs.is_some() {
            check_width(text, "intermediate_size", self.intermediate, 2)?;
        }
        check_width(text, "num_attention_heads", self.heads, self.head_dim)
    }

    /// The first key that contradicts another, and why.
    fn validate(&self) -> Result<(), (&'static str, String)> {
        let Self {
            heads,
            kv_heads,
            head_dim,
            rotated,
            ..
        } = self;
        if !heads.is_multiple_of(*kv_heads) {
            return Err((
                KV_HEADS,
                format!("{kv_heads} does not divide {heads} attention heads"),
            ));
        }
        if !head_dim.is_multiple_of(2) {
            return Err((
                "head_dim",
                format!("{head_dim} is odd; rotary embeddings need pairs"),
            ));
        }
        if !rotated.is_multiple_of(2) || *rotated == 0 {
            let problem = format!(
                "{rotated} of {head_dim} channels are rotated; an even number above 0 is needed"
            );
            return Err(("partial_rotary_factor", problem));
        }
        if let Some(RotarySections { lengths, .. }) = self.rope.sections
            && lengths
                .iter()
                .try_fold(0, |sum: usize, length| sum.checked_add(*length))
                != Some(rotated / 2)
        {
            let problem = format!(
                "{lengths:?} do not add up to the {} pairs of a head",
                rotated / 2
            );
            return Err(("mrope_section", problem));
        }
        // The first frequencies that are not finite would show as logits that are not, thousands of
        // products later.
        let some_are_zero = matches!(self.rope.scaling, RopeScaling::Proportional { .. });
        let usable = |frequency: &f32| {
            frequency.is_finite() && (*frequency > 0.0 || some_are_zero && *frequency == 0.0)
        };
        if !frequencies(&self.rope, *rotated).iter().all(usable) {
            let problem = format!(
                "{} gives no usable frequencies for heads of {head_dim} channels",
                self.rope.theta
            );
            return Err(("rope_theta", problem));
        }
        if let RopeScaling::Dynamic { .. } = self.rope.scaling
            && *head_dim < 4
        {
            let problem = format!("{head_dim} is too narrow for a dynamic base; 4 is the least");
            return Err(("head_dim", problem));
        }
        Ok(())
    }
}

/// The layers of a decoder that keep a state of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct OwnState {
    /// How many there are.
    pub layers: usize,
    /// Numbers of the state of each.
    pub state: usize,
    /// Numbers of a row that each reads, of which it keeps the last ones.
    pub row: usize,
}

/// The key whose null differs from its absence.
const KV_HEADS: &str = "num_key_value_heads";

/// Checks that no layer of a Qwen has a window. Its configuration may say one that begins behind
/// the last layer.
fn check_no_window(text: &ConfigObject<'_>, layers: usize) -> Result<(), MllmError> {
    const KEY: &str = "use_sliding_window";
    let windowed = text.value(KEY)?.unwrap_or(false)
        && text.contains("sliding_window")
        && !text.is_null("sliding_window");
    let first = text.value("max_window_layers")?.unwrap_or(0_usize);
    if windowed && first < layers {
        return Err(text.error(
            KEY,
            format!("a window in the layers from {first} of {layers} is not supported"),
        ));
    }
    Ok(())
}
