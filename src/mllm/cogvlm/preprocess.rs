//! `CogVLM`'s preprocessing: the image stretched to a square.

use crate::MllmError;
use crate::vision::{Filter, PixelScale, check_not_empty, resize};
use candle_core::Tensor;
use image::RgbImage;

/// Pixel values (3, side, side): bicubic, without a crop, with CLIP's mean and deviation
/// (`image_transforms` in the model's code; its repositories have no preprocessor configuration).
pub(super) fn pixel_values(image: &RgbImage, side: u32) -> Result<Tensor, MllmError> {
    check_not_empty(image)?;
    Ok(PixelScale::CLIP.values(&resize(image, side, side, Filter::Bicubic))?)
}
