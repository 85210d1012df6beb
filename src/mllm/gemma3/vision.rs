//! The vision tower of Gemma 3, and its projector.

use super::config::Gemma3Config;
use crate::MllmError;
use crate::checkpoint::Weights;
use crate::vision::SiglipVisionTower;
use candle_core::{Result, Tensor};
use planagent_kernels::Linear;
use planagent_kernels::RmsNorm;
use planagent_kernels::matrix::Matrix;

/// Tower and projector, from pixel values to input rows of the decoder.
#[derive(Debug)]
pub(crate) struct ImageEncoder {
    pub(super) tower: SiglipVisionTower,
    /// Patches along a side.
    patches: usize,
    /// Side of the blocks of patches that become one token.
    pool: usize,
    norm: RmsNorm,
    projection: Linear,
}

const PROJECTOR: &str = "multi_modal_projector";

impl ImageEncoder {
    pub(super) fn take(
        weights: &mut Weights,
        config: &Gemma3Config,
    ) -> std::result::Result<Self, MllmError> {
        let vision = &config.vision;
        let tower = SiglipVisionTower::take_whole(weights, vision)?;
        let offset = if weights.norms_have_one() { 0.0 } else { 1.0 };
        let stored: Vec<f32> = weights
            .take(
                &format!("{PROJECTOR}.mm_soft_emb_norm.weight"),
                &[vision.hidden],
            )?
            .to_vec1()?;
        let weight = stored.into_iter().map(|weight| weight + offset).collect();
        // Stored as inputs by outputs.
        let projection = weights.take(
            &format!("{PROJECTOR}.mm_input_projection_weight"),
            &[vision.hidden, config.text.hidden],
        )?;
        Ok(Self {
            tower,
            patches: vision.image_size / vision.patch_size,
            pool: config.pool,
            norm: RmsNorm::new(weight, vision.layer_norm_eps),
            projection: Linear::from_matrix(
                Matrix::from_tensor(&projection.t()?.contiguous()?)?,
                None,
            ),
        })
    }

    /// Encodes pixel values (3, side, side) to (image tokens, decoder width).
    pub(super) fn encode(&self, pixels: &Tensor) -> Result<Tensor> {
        self.project(&self.pooled(&self.tower.forward(pixels)?)?)
    }

    /// The averages of blocks of patches, (image tokens, tower width).
    fn pooled(&self, patches: &Tensor) -> Result<Tensor> {
        let side = self.patches / self.pool;
        let width = patches.dim(1)?;
        patches
            .reshape(vec![side, self.pool, side, self.pool, width])?
            .mean(3)?
            .mean(1)?
            .reshape((side * side, width))
    }

    /// Maps (image tokens, tower width) to (image tokens, decoder width).
    pub(super) fn project(&self, pooled: &Tensor) -> Result<Tensor> {
        self.projection.forward(&self.norm.forward(pooled)?)
    }
}
