//! `CogVLM`'s preprocessing: the image stretched to a square, whatever its shape.

use candle_core::Tensor;
use image::RgbImage;

use crate::mllm::MllmError;
use crate::mllm::vision::{Filter, PixelScale, check_not_empty, resize};

/// Turns an image into pixel values (3, side, side): bicubic, without a crop, normalised as CLIP's
/// (`image_transforms` in the model's code; its repositories have no preprocessor configuration).
///
/// # Errors
/// When the image is empty.
pub(super) fn pixel_values(image: &RgbImage, side: u32) -> Result<Tensor, MllmError> {
    check_not_empty(image)?;
    Ok(PixelScale::CLIP.values(&resize(image, side, side, Filter::Bicubic))?)
}
