//! What a model is and needs, from its configuration and the headers of its weights alone.

use super::MemoryNeed;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, Weights};
use crate::families::Families;
use crate::family::ImageSettings;
use crate::source::{Checkpoint, ModelShape};
use planagent_kernels::matrix::WeightFormat;

/// A model as it is known before its weights are read.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOutline {
    /// Name of its family.
    pub family: &'static str,
    /// Number of weights.
    pub parameters: u64,
    /// Side of the image that is drawn for the model, pixels.
    pub image_size: usize,
    /// Tokens of that image.
    pub image_tokens: usize,
    /// Whether the image stands before the system prompt.
    pub image_first: bool,
    /// Longest chat, tokens.
    pub context: usize,
    /// The model in each of [`ModelOutline::FORMATS`], as `--quantize` gives it.
    pub formats: Vec<FormatOutline>,
}

/// A model in one weight format. Some of its matrices may have another: see `docs/models.md`.
#[derive(Debug, Clone, PartialEq)]
pub struct FormatOutline {
    pub weight_format: WeightFormat,
    pub memory: MemoryNeed,
    /// What each token is multiplied with in the decoder's layers.
    pub layers: Vec<MatrixShare>,
    /// What a token is multiplied with in the output layer, if its logits are needed.
    pub output: Vec<MatrixShare>,
    /// Multiplications and additions that encode the drawn image.
    pub image_operations: f64,
}

/// Matrices in one format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatrixShare {
    pub weight_format: WeightFormat,
    /// Their weights.
    pub weights: u64,
}

impl ModelOutline {
    /// The formats of an outline.
    pub const FORMATS: [WeightFormat; 4] =
        [WeightFormat::Q4K, WeightFormat::Q8_0, WeightFormat::F16, WeightFormat::F32];

    /// The outline of a model whose images are shown as `image` says.
    pub(crate) fn of(mut checkpoint: Checkpoint, image: ImageSettings) -> Result<Self, MllmError> {
        let config = (checkpoint.family.family().decoder_config)(&checkpoint.files)?;
        let memory = Self::FORMATS.map(|format| MemoryNeed::of(&checkpoint, &config, Some(format), None));
        let shares = Self::FORMATS.map(|format| decoder(&checkpoint.weights, &config, format));
        let tower = Tower::of(&checkpoint.weights);
        checkpoint.weights.only_look();
        let mut model = checkpoint.open_model()?;
        model.set_images(image)?;
        let info = model.info().clone();
        let side = info.image_size as u32;
        let tokens = model.image_layout(side, side)?.tokens;
        let operations = tower.operations(tokens);
        let formats = Self::FORMATS.into_iter().zip(memory).zip(shares);
        Ok(Self {
            family: info.architecture,
            parameters: info.parameters,
            image_size: info.image_size,
            image_tokens: tokens,
            image_first: info.image_first,
            context: model.context(tokens),
            formats: formats
                .map(|((weight_format, memory), [layers, output])| FormatOutline {
                    weight_format,
                    memory,
                    layers,
                    output,
                    image_operations: operations,
                })
                .collect(),
        })
    }

    /// The outline of a published model, without its files.
    pub fn of_shape(shape: &ModelShape) -> Result<Self, MllmError> {
        Self::of(shape.checkpoint(&Families::default())?, ImageSettings::default())
    }

    /// The model in one of [`Self::FORMATS`].
    pub fn format(&self, weight_format: WeightFormat) -> Option<&FormatOutline> {
        self.formats.iter().find(|format| format.weight_format == weight_format)
    }
}

/// What a token is multiplied with: in the layers, and in the output layer.
fn decoder(weights: &Weights, config: &LlamaConfig, quantize: WeightFormat) -> [Vec<MatrixShare>; 2] {
    let output = if weights.contains("lm_head.weight") { "lm_head.weight" } else { "embed_tokens.weight" };
    let (mut layers, mut head) = (Vec::new(), Vec::new());
    for (name, [outputs, inputs], weight_format) in weights.matrices(Some(quantize)) {
        let share = MatrixShare { weight_format, weights: (outputs * inputs) as u64 };
        if name.ends_with(output) {
            head.push(share);
        } else if !is_vision(name) && !name.ends_with("embed_tokens.weight") {
            layers.push(share);
        }
    }
    // Where a layer has matrices for text and for images, a token is multiplied with one kind of them.
    let all: u64 = layers.iter().map(|share| share.weights).sum();
    let used = config.layer_weights() as f64 * config.layers as f64 / all.max(1) as f64;
    for share in &mut layers {
        share.weights = (share.weights as f64 * used.min(1.0)) as u64;
    }
    [joined(&layers), joined(&head)]
}

/// One share for each format.
fn joined(shares: &[MatrixShare]) -> Vec<MatrixShare> {
    let sum = |weight_format: WeightFormat| {
        let alike = shares.iter().filter(|share| share.weight_format == weight_format);
        MatrixShare { weight_format, weights: alike.map(|share| share.weights).sum() }
    };
    WeightFormat::ALL.map(sum).into_iter().filter(|share| share.weights > 0).collect()
}

/// Names of vision towers and projectors begin so ([`Weights`]).
const TOWER: &str = "vision";
const PROJECTOR: &str = "multi_modal_projector.";

fn is_vision(name: &str) -> bool {
    name.starts_with(TOWER) || name.starts_with(PROJECTOR)
}

/// The sizes of a vision tower that its cost depends on.
#[derive(Debug, Clone, Copy, Default)]
struct Tower {
    /// Weights that a patch is multiplied with.
    weights: usize,
    /// Weights that a token of the image is multiplied with.
    projector: usize,
    /// Numbers that the projector takes for a token.
    merged: usize,
    layers: usize,
    /// Width of the hidden states.
    hidden: usize,
    /// Patches that attend to one another; 0 for all.
    tile: usize,
}

impl Tower {
    fn of(weights: &Weights) -> Self {
        let mut tower = Self::default();
        for (name, shape) in weights.shapes().filter(|(name, _)| is_vision(name)) {
            let numbers: usize = shape.iter().product();
            if name.starts_with(PROJECTOR) {
                tower.projector += numbers;
                // Its first matrix, by name too.
                if let (&[_, inputs], 0) = (shape, tower.merged) {
                    tower.merged = inputs;
                }
                continue;
            }
            if name.contains("position_embedding") {
                tower.tile = shape.iter().rev().nth(1).copied().unwrap_or(0);
            } else {
                tower.weights += numbers;
            }
            let layer = name.split_once("layers.").and_then(|(_, rest)| rest.split('.').next()?.parse::<usize>().ok());
            tower.layers = tower.layers.max(layer.map_or(0, |layer| layer + 1));
            if let ([hidden, _, _, ..], true) = (shape, name.contains("patch_embedding")) {
                tower.hidden = *hidden;
            }
        }
        tower
    }

    /// Multiplications and additions that encode an image to `tokens` tokens.
    fn operations(self, tokens: usize) -> f64 {
        // A token is a block of patches side by side.
        let patches = tokens * (self.merged / self.hidden.max(1)).max(1);
        let attended = if self.tile == 0 { patches } else { self.tile.min(patches) };
        let attention = 4.0 * (self.hidden * self.layers * attended) as f64;
        patches as f64 * (2.0 * self.weights as f64 + attention) + 2.0 * (self.projector * tokens) as f64
    }
}
