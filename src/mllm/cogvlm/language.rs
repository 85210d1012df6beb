//! The decoder with visual experts, and the positions of an image's tokens.

use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use crate::decoder::{
    CausalAttention, DecoderCache, DecoderLayer, LayerState, Pass, SwiGlu, rms_norm,
};
use candle_core::Tensor;
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;
use planagent_kernels::attention::Precision;
use std::ops::Range;

/// Positions that an image takes: one for its beginning, one for all its patches, one for its end.
pub(super) const IMAGE_POSITIONS: usize = 3;

/// A Llama layer with two sets of matrices, one for text and one for the image. They share norms
/// and attention.
#[derive(Debug)]
pub(super) struct ExpertLayer {
    input_norm: RmsNorm,
    attention: CausalAttention,
    post_norm: RmsNorm,
    language: Expert,
    vision: Expert,
}

/// The matrices of one expert.
#[derive(Debug)]
struct Expert {
    qkv: Linear,
    out: Linear,
    mlp: SwiGlu,
}

impl Expert {
    /// Takes the matrices of the expert `kind` (`language`, `vision`) of the layer called `name`.
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        name: &str,
        kind: &str,
    ) -> Result<Self, MllmError> {
        let queries = config.heads * config.head_dim;
        let all = queries + 2 * config.kv_heads * config.head_dim;
        let attention = format!("{name}.self_attn.{kind}_expert");
        Ok(Self {
            qkv: weights.take_linear(
                &format!("{attention}_query_key_value"),
                config.hidden,
                all,
                false,
            )?,
            out: weights.take_linear(
                &format!("{attention}_dense"),
                queries,
                config.hidden,
                false,
            )?,
            mlp: SwiGlu::take_mlp(
                weights,
                &format!("{name}.mlp.{kind}_mlp"),
                config,
                config.intermediate,
            )?,
        })
    }
}

impl ExpertLayer {
    /// Applies a part of the vision expert to the rows of images and of the language expert to the
    /// others.
    fn route(
        &self,
        x: &Tensor,
        vision: &[Range<usize>],
        part: impl Fn(&Expert, &Tensor) -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<Tensor> {
        if vision.is_empty() {
            return part(&self.language, x);
        }
        let mut spans = Vec::new();
        let mut end = 0;
        for rows in vision {
            spans.extend([
                (&self.language, end..rows.start),
                (&self.vision, rows.clone()),
            ]);
            end = rows.end;
        }
        spans.push((&self.language, end..x.dim(0)?));
        let routed = spans
            .into_iter()
            .filter(|(_, rows)| !rows.is_empty())
            .map(|(expert, rows)| part(expert, &x.narrow(0, rows.start, rows.len())?))
            .collect::<candle_core::Result<Vec<_>>>()?;
        Tensor::cat(&routed, 0)
    }
}

impl DecoderLayer for ExpertLayer {
    fn take(
        weights: &mut Weights,
        config: &LlamaConfig,
        layer: usize,
        name: &str,
    ) -> Result<Self, MllmError> {
        Ok(Self {
            input_norm: rms_norm(weights, &format!("{name}.input_layernorm"), config)?,
            attention: CausalAttention::new(config, layer),
            post_norm: rms_norm(weights, &format!("{name}.post_attention_layernorm"), config)?,
            language: Expert::take(weights, config, name, "language")?,
            vision: Expert::take(weights, config, name, "vision")?,
        })
    }

    fn exact_pass(&self) -> usize {
        self.attention.exact_pass()
    }

    fn new_state(&self, precision: Precision) -> LayerState {
        self.attention.new_state(precision)
    }

    fn forward(
        &self,
        x: &Tensor,
        pass: &Pass,
        cache: &mut DecoderCache,
    ) -> candle_core::Result<Tensor> {
        let normed = self.input_norm.forward(x)?;
        let qkv = self.route(&normed, &pass.vision, |expert, rows| {
            expert.qkv.forward(rows)
        })?;
        let mixed = self.attention.forward(&qkv, pass, cache)?;
        let x = (x + self.route(&mixed, &pass.vision, |expert, rows| {
            expert.out.forward(rows)
        })?)?;
        let normed = self.post_norm.forward(&x)?;
        &x + self.route(&normed, &pass.vision, |expert, rows| {
            expert.mlp.forward(rows)
        })?
    }
}

/// Positions of the tokens `tokens` of a chat whose image has the tokens `image` (empty for none).
/// All patches share one position (`build_position_ids` in the model's code).
pub(super) fn positions(tokens: Range<usize>, image: &Range<usize>) -> Vec<u32> {
    let position = |index: usize| {
        if image.is_empty() || index <= image.start {
            index
        } else if index + 1 < image.end {
            image.start + 1
        } else {
            (index + IMAGE_POSITIONS).saturating_sub(image.len())
        }
    };
    tokens.map(|index| position(index) as u32).collect()
}

/// The rows of the tokens `tokens` that go through the vision expert: the image without its end
/// (`get_expert_mask` in the model's code).
pub(super) fn vision_rows(tokens: &Range<usize>, image: &Range<usize>) -> Range<usize> {
    let last = image.end.saturating_sub(1);
    let begin = image.start.clamp(tokens.start, tokens.end);
    let end = last.clamp(begin, tokens.end);
    begin - tokens.start..end - tokens.start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_share_a_position_and_text_goes_on_behind() {
        // Begin 1, four patches 2 to 5, end 6.
        let image = 1..7;
        assert_eq!(positions(0..10, &image), [0, 1, 2, 2, 2, 2, 3, 4, 5, 6]);
        assert_eq!(positions(4..8, &image), [2, 2, 3, 4]);
        assert_eq!(positions(2..5, &(0..0)), [2, 3, 4]);
    }

    #[test]
    fn the_end_of_the_image_is_text_to_the_experts() {
        let image = 1..7;
        assert_eq!(vision_rows(&(0..10), &image), 1..6);
        assert_eq!(vision_rows(&(3..5), &image), 0..2);
        assert_eq!(vision_rows(&(5..9), &image), 0..1);
        assert!(vision_rows(&(6..9), &image).is_empty());
        assert!(vision_rows(&(0..1), &image).is_empty());
        assert!(vision_rows(&(0..5), &(0..0)).is_empty());
    }
}
