//! Input rows of the decoder for pictures and sounds: of a tower's outputs, or of tokens from a table
//! (`Gemma3nMultimodalEmbedder`).

use super::config::{SeenConfig, TableConfig};
use crate::MllmError;
use crate::checkpoint::Weights;
use candle_core::{Result, Tensor};
use planagent_kernels::matrix::Matrix;
use planagent_kernels::{Linear, RmsNorm};

/// A table of tokens, and the way from its rows to the decoder.
#[derive(Debug)]
pub(super) struct TokenTable {
    first: u32,
    rows: Matrix,
    norm: RmsNorm,
    projection: Linear,
    /// Behind the projection, without a weight.
    last_norm: RmsNorm,
}

impl TokenTable {
    /// Takes a table of tensors whose names begin with `name`, for a decoder of `hidden` numbers.
    fn take(
        weights: &mut Weights,
        config: &TableConfig,
        name: &str,
        hidden: usize,
    ) -> std::result::Result<Self, MllmError> {
        let TableConfig {
            first,
            rows,
            width,
            eps,
        } = *config;
        let projection = format!("{name}.embedding_projection");
        Ok(Self {
            first,
            rows: weights.take_matrix(&format!("{name}.embedding.weight"), [rows, width])?,
            norm: weights.take_rms_norm(&format!("{name}.hard_embedding_norm"), width, eps)?,
            projection: weights.take_linear(&projection, width, hidden, false)?,
            last_norm: RmsNorm::new(vec![1.0; hidden], eps),
        })
    }

    /// The input row of a token, (1, hidden).
    fn row(&self, id: u32) -> Result<Tensor> {
        let row = self.rows.rows(&[id.saturating_sub(self.first)])?;
        self.projected(&self.norm.forward(&row)?)
    }

    fn projected(&self, rows: &Tensor) -> Result<Tensor> {
        self.last_norm.forward(&self.projection.forward(rows)?)
    }
}

/// The tables of both kinds, and the norm of what the vision tower gives.
#[derive(Debug)]
pub(super) struct Embedder {
    picture: TokenTable,
    /// None where a folder has no part for sounds.
    sound: Option<TokenTable>,
    soft_norm: RmsNorm,
    /// The root of the width of the tower's outputs.
    scale: f64,
}

/// The tensors for pictures, and for tokens of sounds.
const PICTURE: &str = "multi_modal_projector";
pub(super) const SOUND: &str = "multi_modal_projector.sound";

impl Embedder {
    pub(super) fn take(
        weights: &mut Weights,
        config: &SeenConfig,
        hidden: usize,
    ) -> std::result::Result<Self, MllmError> {
        let TableConfig { width, eps, .. } = config.picture;
        let norm = format!("{PICTURE}.soft_embedding_norm");
        let sound = if weights.lacks(&format!("{SOUND}.embedding.weight")) {
            None
        } else {
            Some(TokenTable::take(weights, &config.sound, SOUND, hidden)?)
        };
        Ok(Self {
            picture: TokenTable::take(weights, &config.picture, PICTURE, hidden)?,
            sound,
            soft_norm: weights.take_rms_norm(&norm, width, eps)?,
            scale: (width as f64).sqrt(),
        })
    }

    /// Maps the vision tower's outputs (tokens, width) to input rows (tokens, hidden).
    pub(super) fn seen(&self, outputs: &Tensor) -> Result<Tensor> {
        let normed = self.soft_norm.forward(&(outputs * self.scale)?)?;
        self.picture.projected(&normed)
    }

    /// The table that has a token; none for a token of the decoder.
    pub(super) fn table(&self, id: u32) -> Option<&TokenTable> {
        let tables = [self.sound.as_ref(), Some(&self.picture)];
        tables.into_iter().flatten().find(|table| id >= table.first)
    }

    /// The input row of a token that one of the tables has, (1, hidden).
    pub(super) fn row(&self, id: u32) -> Result<Tensor> {
        match self.table(id) {
            Some(table) => table.row(id),
            None => candle_core::bail!("token {id} is in no table"),
        }
    }
}
