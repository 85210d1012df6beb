//! Conversion of 8-bit pixels to the input of a vision tower.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, positive};
use candle_core::{Device, Tensor};
use image::RgbImage;
use rayon::prelude::*;
use serde::Deserialize;

/// Mean of the RGB channels in CLIP's training (`OPENAI_CLIP_MEAN` in transformers).
const CLIP_MEAN: [f32; 3] = [0.481_454_66, 0.457_827_5, 0.408_210_73];
/// Standard deviation of the RGB channels in CLIP's training (`OPENAI_CLIP_STD` in transformers).
const CLIP_STD: [f32; 3] = [0.268_629_54, 0.261_302_6, 0.275_777_1];
/// Most pixels of a picture that is made for a tower: 0.5 GB with its values. Published processors
/// make up to 17 million.
pub(crate) const MAX_PICTURE: u64 = 1 << 25;
/// Most tiles of a picture. Published processors make up to 144.
pub(crate) const MAX_TILES: u64 = 1 << 10;

/// Factor from an 8-bit channel to [0, 1].
const UNIT: f64 = 1.0 / 255.0;

#[derive(Deserialize)]
#[serde(default)]
struct ScaleKeys {
    do_rescale: bool,
    #[serde(deserialize_with = "positive")]
    rescale_factor: f64,
    do_normalize: bool,
    image_mean: [f32; 3],
    image_std: [f32; 3],
}

impl Default for ScaleKeys {
    fn default() -> Self {
        Self {
            do_rescale: true,
            rescale_factor: UNIT,
            do_normalize: true,
            image_mean: CLIP_MEAN,
            image_std: CLIP_STD,
        }
    }
}

/// Rescaling and normalization of pixel values.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PixelScale {
    rescale: Option<f64>,
    /// Mean and standard deviation of the channels.
    normalize: Option<([f32; 3], [f32; 3])>,
}

impl PixelScale {
    /// To [0, 1], then by CLIP's mean and standard deviation.
    pub(crate) const CLIP: Self = Self {
        rescale: Some(UNIT),
        normalize: Some((CLIP_MEAN, CLIP_STD)),
    };

    /// Reads the keys of an image processor; absent keys have CLIP's values.
    pub(crate) fn read(processor: &ConfigObject<'_>) -> Result<Self, MllmError> {
        let keys: ScaleKeys = processor.read()?;
        let finite = |numbers: [f32; 3]| numbers.iter().all(|number| number.is_finite());
        if !finite(keys.image_mean) {
            return Err(processor.error("image_mean", "must be finite"));
        }
        if !finite(keys.image_std) || keys.image_std.contains(&0.0) {
            return Err(processor.error("image_std", "must be finite and not zero"));
        }
        Ok(Self {
            rescale: keys.do_rescale.then_some(keys.rescale_factor),
            normalize: keys
                .do_normalize
                .then_some((keys.image_mean, keys.image_std)),
        })
    }

    /// Mean and standard deviation of pixels rescaled to [0, 1]; `None` for any other rescaling.
    pub(crate) fn mean_and_deviation(&self) -> Option<[[f32; 3]; 2]> {
        let to_unit = self
            .rescale
            .is_some_and(|factor| (factor - UNIT).abs() < 1e-9);
        self.normalize
            .filter(|_| to_unit)
            .map(|(mean, deviation)| [mean, deviation])
    }

    /// Pixel values of shape (3, height, width).
    pub(crate) fn values(&self, pixels: &RgbImage) -> candle_core::Result<Tensor> {
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        let tables = [0, 1, 2].map(|channel| self.table(channel));
        let mut values = vec![0.0; 3 * width * height];
        // Rows of the image, channel by channel.
        let rows = values.par_chunks_mut(width.max(1)).enumerate();
        rows.for_each(|(index, row)| {
            let (channel, y) = (index / height, index % height);
            let pixels = pixels.as_chunks::<3>().0[y * width..].iter();
            for (value, pixel) in row.iter_mut().zip(pixels) {
                *value = tables[channel][usize::from(pixel[channel])];
            }
        });
        Tensor::from_vec(values, (3, height, width), &Device::Cpu)
    }

    /// The value of each byte in a channel.
    fn table(&self, channel: usize) -> [f32; 256] {
        std::array::from_fn(|byte| {
            let value = match self.rescale {
                Some(factor) => (byte as f64 * factor) as f32,
                None => byte as f32,
            };
            self.normalize
                .map_or(value, |(mean, std)| (value - mean[channel]) / std[channel])
        })
    }
}

/// Checks a picture that is to be made before memory is taken for it; the error says what is wrong.
pub(crate) fn check_picture(width: u32, height: u32) -> Result<(), String> {
    if u64::from(width) * u64::from(height) <= MAX_PICTURE {
        return Ok(());
    }
    Err(format!(
        "a picture of {width} x {height} pixels; at most {MAX_PICTURE} pixels are supported"
    ))
}

/// Checks the tiles of `tile` pixels a side that a picture is cut into.
pub(crate) fn check_tiles(width: u32, height: u32, tile: u32) -> Result<(), String> {
    check_picture(width, height)?;
    let tiles = u64::from(width / tile.max(1)) * u64::from(height / tile.max(1));
    if tiles <= MAX_TILES {
        return Ok(());
    }
    Err(format!(
        "{tiles} tiles of {tile} pixels a side; at most {MAX_TILES} are supported"
    ))
}

pub(crate) fn check_not_empty(image: &RgbImage) -> Result<(), MllmError> {
    if image.width() == 0 || image.height() == 0 {
        return Err(MllmError::Image {
            problem: "the image has no pixels".into(),
        });
    }
    Ok(())
}
