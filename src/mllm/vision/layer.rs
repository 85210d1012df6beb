//! The layer of vision transformers with a norm before each part (CLIP, `SigLIP`, `InternViT`,
//! Qwen3-VL).

use super::attention::{Part, SelfAttention};
use crate::MllmError;
use crate::checkpoint::{VisionConfig, Weights};
use candle_core::Tensor;
use planagent_kernels::Activation;
use planagent_kernels::LayerNorm;
use planagent_kernels::Linear;

/// The `wanted` hidden states of a tower, each of shape (images, tokens of an image, hidden): 0 is
/// `state`, its embeddings; n is the state after layer n.
pub(super) fn hidden_states(
    layers: &[VisionLayer],
    state: Tensor,
    images: usize,
    wanted: &[usize],
) -> candle_core::Result<Vec<Tensor>> {
    let (tokens, hidden) = state.dims2()?;
    let parts = Part::images(images, tokens / images.max(1));
    let mut state = state;
    let mut found = vec![None; wanted.len()];
    for index in 0..=layers.len() {
        for (found, _) in found
            .iter_mut()
            .zip(wanted)
            .filter(|(_, wanted)| **wanted == index)
        {
            *found = Some(state.reshape((images, (), hidden))?);
        }
        if let Some(layer) = layers.get(index) {
            state = layer.forward(&state, &parts)?;
        }
    }
    found.into_iter().collect::<Option<_>>().ok_or_else(|| {
        candle_core::Error::Msg(format!("the vision tower has no hidden states {wanted:?}"))
    })
}

/// Takes the first `depth` layers of a tower with CLIP's names. The other layers must be in the
/// checkpoint too.
pub(super) fn take_layers(
    weights: &mut Weights,
    config: &VisionConfig,
    depth: usize,
) -> Result<Vec<VisionLayer>, MllmError> {
    let mut layers = Vec::with_capacity(config.layers.min(depth));
    for index in 0..config.layers {
        let layer = VisionLayer::take(
            weights,
            config,
            &format!("vision_tower.encoder.layers.{index}"),
        )?;
        if index < depth {
            layers.push(layer);
        }
    }
    Ok(layers)
}

/// x + attention(norm₁(x)), then x + mlp(norm₂(x)).
#[derive(Debug)]
pub(crate) struct VisionLayer {
    norm1: LayerNorm,
    attention: SelfAttention,
    norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    act: Activation,
}

impl VisionLayer {
    /// Takes the layer called `name`, which has CLIP's names.
    pub(crate) fn take(
        weights: &mut Weights,
        config: &VisionConfig,
        name: &str,
    ) -> Result<Self, MllmError> {
        let (hidden, wide, eps) = (config.hidden, config.intermediate, config.layer_norm_eps);
        Ok(Self {
            norm1: weights.take_layer_norm(&format!("{name}.layer_norm1"), hidden, eps)?,
            attention: SelfAttention::take(
                weights,
                &format!("{name}.self_attn"),
                hidden,
                config.heads,
            )?,
            norm2: weights.take_layer_norm(&format!("{name}.layer_norm2"), hidden, eps)?,
            fc1: weights.take_linear(&format!("{name}.mlp.fc1"), hidden, wide, true)?,
            fc2: weights.take_linear(&format!("{name}.mlp.fc2"), wide, hidden, true)?,
            act: config.act,
        })
    }

    /// Takes the layer with factors of the channels of both parts (`InternViT`).
    pub(crate) fn take_scaled(
        weights: &mut Weights,
        config: &VisionConfig,
        name: &str,
    ) -> Result<Self, MllmError> {
        let layer = Self::take(weights, config, name)?;
        let mut scale = |number: usize| {
            weights.take(
                &format!("{name}.layer_scale{number}.weight"),
                &[config.hidden],
            )
        };
        let (of_attention, of_mlp) = (scale(1)?, scale(2)?);
        Ok(Self {
            attention: layer.attention.scaled(of_attention),
            fc2: layer.fc2.scaled(of_mlp),
            ..layer
        })
    }

    /// Maps (tokens of all parts, hidden) to the same shape.
    pub(crate) fn forward(&self, x: &Tensor, parts: &[Part]) -> candle_core::Result<Tensor> {
        let x = self
            .attention
            .forward_onto(&self.norm1.forward(x)?, parts, x)?;
        let wide = self.fc1.forward_then(&self.norm2.forward(&x)?, self.act)?;
        self.fc2.forward_onto(&wide, &x)
    }
}
