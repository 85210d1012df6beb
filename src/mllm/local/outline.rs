//! What a model is and needs, from its configuration and the headers of its weights alone.

use super::work::{ModelWork, token_bytes};
use super::{MemoryNeed, PictureNeed};
use crate::MllmError;
use crate::checkpoint::MergedAdapter;
use crate::family::{ImageRange, ImageSettings};
use crate::source::Checkpoint;
use planagent_kernels::matrix::WeightFormat;

/// A model as it is known before its weights are read.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOutline {
    /// Name of its family.
    pub family: &'static str,
    /// Number of weights.
    pub parameters: u64,
    /// Side of the image that is drawn for the model, pixels; none for a model that reads text
    /// alone.
    pub image_size: Option<usize>,
    /// Tokens of that image; 0 without one.
    pub image_tokens: usize,
    /// How many tokens an image may become; none where the tower decides.
    pub image_range: Option<ImageRange>,
    /// Longest chat, tokens.
    pub context: usize,
    /// Whether the system prompt stands behind the image.
    pub image_first: bool,
    /// What it computes.
    pub work: ModelWork,
    /// What is merged into its weights.
    pub adapter: Option<MergedAdapter>,
    /// The model in each of [`ModelOutline::FORMATS`], as `--quantize` gives it.
    pub formats: Vec<FormatOutline>,
}

/// A model in one weight format. Some of its matrices may have another: see `docs/models.md`.
#[derive(Debug, Clone, PartialEq)]
pub struct FormatOutline {
    pub weight_format: WeightFormat,
    pub memory: MemoryNeed,
    /// Bytes of weights that a decoded token reads.
    pub token_bytes: u64,
}

impl ModelOutline {
    /// The formats of an outline.
    pub const FORMATS: [WeightFormat; 4] = [
        WeightFormat::Q4K,
        WeightFormat::Q8_0,
        WeightFormat::F16,
        WeightFormat::F32,
    ];

    /// The outline of a model whose images are shown as `image` says.
    pub(crate) fn from_checkpoint(
        mut checkpoint: Checkpoint,
        image: ImageSettings,
    ) -> Result<Self, MllmError> {
        let config = checkpoint.decoder_config()?;
        let picture = PictureNeed::estimate(&checkpoint, image);
        let memory = Self::FORMATS
            .map(|format| MemoryNeed::estimate(&checkpoint, &config, picture, Some(format), None));
        let work = ModelWork::from_weights(&checkpoint.weights, &config, picture);
        let read = Self::FORMATS.map(|format| token_bytes(&checkpoint.weights, format));
        // From here on, tensors are taken out and nothing can be counted any more.
        checkpoint.weights.only_look();
        let mut model = checkpoint.open_model()?;
        model.set_images(image)?;
        let info = model.info().clone();
        let tokens = model.drawn_layout()?.map_or(0, |layout| layout.tokens);
        let formats = Self::FORMATS.into_iter().zip(memory).zip(read);
        Ok(Self {
            adapter: checkpoint.weights.report().adapter.clone(),
            family: info.architecture,
            parameters: info.parameters,
            image_size: info.image_size,
            image_tokens: tokens,
            image_range: info.image_range,
            image_first: info.image_first,
            work,
            context: model.context(tokens),
            formats: formats
                .map(|((weight_format, memory), token_bytes)| FormatOutline {
                    weight_format,
                    memory,
                    token_bytes,
                })
                .collect(),
        })
    }
}
