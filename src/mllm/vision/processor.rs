//! The image processor of CLIP: from an RGB image to the pixel values that the vision tower was trained on.

use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use image::RgbImage;
use image::imageops;
use serde_json::Value;

use super::resample::{Filter, resize};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Section, read_json};

/// Mean of the RGB channels that CLIP was trained with (`OPENAI_CLIP_MEAN` in transformers).
const CLIP_MEAN: [f32; 3] = [0.481_454_66, 0.457_827_5, 0.408_210_73];
/// Standard deviation of the RGB channels that CLIP was trained with (`OPENAI_CLIP_STD` in transformers).
const CLIP_STD: [f32; 3] = [0.268_629_54, 0.261_302_6, 0.275_777_1];
/// Side that `CLIPImageProcessor` resizes and crops to when its configuration does not say.
const DEFAULT_SIDE: usize = 224;

/// `CLIPImageProcessor`: resize, centre crop, rescale, normalise.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ClipImageProcessor {
    path: PathBuf,
    resize: Option<(TargetSize, Filter)>,
    /// Height and width.
    crop: Option<(u32, u32)>,
    rescale: Option<f64>,
    normalise: Option<([f32; 3], [f32; 3])>,
}

/// The `size` of a preprocessor configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TargetSize {
    /// The shorter side becomes so long, the ratio stays.
    ShortestEdge(u32),
    /// Exactly this.
    Exact { height: u32, width: u32 },
}

impl ClipImageProcessor {
    /// Reads `preprocessor_config.json`, or the `image_processor` part of `processor_config.json` (transformers 5).
    ///
    /// # Errors
    /// When neither file is there, or a key has a wrong type or an unsupported value.
    pub(crate) fn open(folder: &Path) -> Result<Self, MllmError> {
        let path = folder.join("preprocessor_config.json");
        if path.is_file() {
            let value = read_json(&path)?;
            return Self::from_section(&path, &Section::root(&path, &value)?);
        }
        let path = folder.join("processor_config.json");
        if path.is_file() {
            let value = read_json(&path)?;
            if let Some(section) = Section::root(&path, &value)?.section("image_processor", "image_processor.")? {
                return Self::from_section(&path, &section);
            }
        }
        Err(MllmError::MissingFile { folder: folder.to_path_buf(), file: "preprocessor_config.json".into() })
    }

    fn from_section(path: &Path, section: &Section<'_>) -> Result<Self, MllmError> {
        if let Some(kind) = section.text("image_processor_type")?
            && !kind.starts_with("CLIPImageProcessor")
        {
            return Err(
                section.error("image_processor_type", format!("{kind:?} is not supported; CLIPImageProcessor is"))
            );
        }
        let resize = if section.flag("do_resize", true)? {
            let number = match section.get("resample") {
                None => Some(3),
                Some(value) => value.as_u64(),
            };
            let filter = number
                .and_then(Filter::from_pillow)
                .ok_or_else(|| section.error("resample", "expected 1 (Lanczos), 2 (bilinear) or 3 (bicubic)".into()))?;
            Some((target_size(section)?, filter))
        } else {
            None
        };
        let crop = if section.flag("do_center_crop", true)? {
            Some(match sides(section, "crop_size")? {
                None => (DEFAULT_SIDE as u32, DEFAULT_SIDE as u32),
                Some(Sides::Exact { height, width }) => (height, width),
                Some(Sides::One(side) | Sides::ShortestEdge(side)) => (side, side),
            })
        } else {
            None
        };
        let rescale = if section.flag("do_rescale", true)? {
            Some(section.positive("rescale_factor", 1.0 / 255.0)?)
        } else {
            None
        };
        let normalise = if section.flag("do_normalize", true)? {
            let std = section.triple("image_std", CLIP_STD)?;
            if std.contains(&0.0) {
                return Err(section.error("image_std", "must not be zero".into()));
            }
            Some((section.triple("image_mean", CLIP_MEAN)?, std))
        } else {
            None
        };
        Ok(Self { path: path.to_path_buf(), resize, crop, rescale, normalise })
    }

    /// Checks that every image comes out as a square of the vision tower's side, as far as that is known beforehand.
    ///
    /// # Errors
    /// When the configured size is another.
    pub(crate) fn check_side(&self, side: usize) -> Result<(), MllmError> {
        let (key, height, width) = match (self.crop, self.resize) {
            (Some((height, width)), _) => ("crop_size", height, width),
            (None, Some((TargetSize::Exact { height, width }, _))) => ("size", height, width),
            _ => return Ok(()),
        };
        if height as usize == side && width as usize == side {
            return Ok(());
        }
        Err(MllmError::Config {
            path: self.path.clone(),
            key: key.into(),
            problem: format!("makes images of {width} x {height} pixels, the vision tower takes {side} x {side}"),
        })
    }

    /// Turns an image into pixel values of shape (3, `side`, `side`), channels first.
    ///
    /// # Errors
    /// When the image is empty, or does not become a square of that side.
    pub(crate) fn process(&self, image: &RgbImage, side: usize) -> Result<Tensor, MllmError> {
        if image.width() == 0 || image.height() == 0 {
            return Err(MllmError::Image { problem: "it has no pixels".into() });
        }
        let resized = match self.resize {
            None => None,
            Some((target, filter)) => {
                let (width, height) = target.dimensions(image)?;
                Some(resize(image, width, height, filter))
            }
        };
        let resized = resized.as_ref().unwrap_or(image);
        let cropped = self.crop.map(|(height, width)| center_crop(resized, width, height));
        let pixels = cropped.as_ref().unwrap_or(resized);
        if (pixels.width() as usize, pixels.height() as usize) != (side, side) {
            return Err(MllmError::Image {
                problem: format!(
                    "{} x {} pixels become {} x {}, the vision tower takes {side} x {side}",
                    image.width(),
                    image.height(),
                    pixels.width(),
                    pixels.height()
                ),
            });
        }
        let plane = side * side;
        let mut values = vec![0f32; 3 * plane];
        for (index, pixel) in pixels.pixels().enumerate() {
            for (channel, value) in pixel.0.into_iter().enumerate() {
                let mut value = match self.rescale {
                    Some(factor) => (f64::from(value) * factor) as f32,
                    None => f32::from(value),
                };
                if let Some((mean, std)) = self.normalise {
                    value = (value - mean[channel]) / std[channel];
                }
                values[channel * plane + index] = value;
            }
        }
        Ok(Tensor::from_vec(values, (3, side, side), &Device::Cpu)?)
    }
}

impl TargetSize {
    /// Width and height that an image is resized to.
    fn dimensions(self, image: &RgbImage) -> Result<(u32, u32), MllmError> {
        match self {
            Self::Exact { height, width } => Ok((width, height)),
            Self::ShortestEdge(edge) => {
                let (width, height) = image.dimensions();
                let long = u64::from(edge) * u64::from(width.max(height)) / u64::from(width.min(height));
                let long = u32::try_from(long).ok().filter(|long| *long as usize <= MAX_SIDE).ok_or_else(|| {
                    MllmError::Image { problem: format!("{width} x {height} pixels are too narrow to be resized") }
                })?;
                Ok(if width <= height { (edge, long) } else { (long, edge) })
            }
        }
    }
}

/// Longest side that an image is resized to, pixels.
const MAX_SIDE: usize = 1 << 16;

/// How a configuration writes a size.
enum Sides {
    One(u32),
    ShortestEdge(u32),
    Exact { height: u32, width: u32 },
}

fn sides(section: &Section<'_>, key: &str) -> Result<Option<Sides>, MllmError> {
    let side = |value: &Value| {
        value
            .as_u64()
            .filter(|side| (1..=MAX_SIDE as u64).contains(side))
            .map(|side| side as u32)
            .ok_or_else(|| section.error(key, format!("expected sides from 1 to {MAX_SIDE}, found {value}")))
    };
    match section.get(key) {
        None => Ok(None),
        Some(value @ Value::Number(_)) => Ok(Some(Sides::One(side(value)?))),
        Some(Value::Object(map)) => match (map.get("shortest_edge"), map.get("height"), map.get("width")) {
            (Some(edge), None, None) => Ok(Some(Sides::ShortestEdge(side(edge)?))),
            (None, Some(height), Some(width)) => Ok(Some(Sides::Exact { height: side(height)?, width: side(width)? })),
            _ => Err(section.error(key, "expected shortest_edge, or height and width".into())),
        },
        Some(value) => Err(section.error(key, format!("expected a size, found {value}"))),
    }
}

fn target_size(section: &Section<'_>) -> Result<TargetSize, MllmError> {
    Ok(match sides(section, "size")? {
        None => TargetSize::ShortestEdge(DEFAULT_SIDE as u32),
        Some(Sides::One(edge) | Sides::ShortestEdge(edge)) => TargetSize::ShortestEdge(edge),
        Some(Sides::Exact { height, width }) => TargetSize::Exact { height, width },
    })
}

/// Cuts out the middle; what lies outside of a smaller image is black, as transformers pads it.
fn center_crop(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    // Floor for a margin that is cut off, so that a padded one gets its odd pixel above and left.
    let offset = |have: u32, want: u32| (i64::from(have) - i64::from(want)).div_euclid(2);
    let mut cropped = RgbImage::new(width, height);
    imageops::replace(&mut cropped, image, -offset(image.width(), width), -offset(image.height(), height));
    cropped
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn processor(value: &Value) -> Result<ClipImageProcessor, MllmError> {
        let path = Path::new("preprocessor_config.json");
        ClipImageProcessor::from_section(path, &Section::root(path, value)?)
    }

    #[test]
    fn small_images_are_padded_and_large_ones_cut_in_the_middle() {
        let image = RgbImage::from_fn(2, 5, |_, y| image::Rgb([y as u8 + 1; 3]));
        let cropped = center_crop(&image, 3, 3);
        let column = |x: u32| (0..3).map(|y| cropped.get_pixel(x, y).0[0]).collect::<Vec<_>>();
        assert_eq!([column(0), column(1), column(2)], [[0, 0, 0], [2, 3, 4], [2, 3, 4]]);
    }

    #[test]
    fn values_are_rescaled_then_normalised() {
        let processor = processor(&json!({
            "do_resize": false, "do_center_crop": false,
            "image_mean": [0.5, 0.5, 0.5], "image_std": [0.25, 0.5, 1.0],
        }))
        .unwrap();
        let image = RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 51]));
        let values: Vec<f32> = processor.process(&image, 1).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        for (value, expected) in values.iter().zip([2.0, -1.0, -0.3]) {
            assert!((value - expected).abs() < 1e-6, "{values:?}");
        }
    }

    #[test]
    fn wrong_sizes_and_filters_are_errors() {
        for wrong in [
            json!({"size": {"height": 3}}),
            json!({"size": "big"}),
            json!({"crop_size": 0}),
            json!({"resample": 0}),
            json!({"image_std": [1, 0, 1]}),
            json!({"image_mean": [1, 2]}),
            json!({"image_processor_type": "SiglipImageProcessor"}),
        ] {
            assert!(matches!(processor(&wrong), Err(MllmError::Config { .. })), "{wrong}");
        }
        let fixed = processor(&json!({"crop_size": 32})).unwrap();
        assert!(fixed.check_side(32).is_ok());
        assert!(matches!(fixed.check_side(64), Err(MllmError::Config { .. })));
    }

    #[test]
    fn an_image_that_does_not_become_the_towers_square_is_an_error() {
        let processor = processor(&json!({"size": {"shortest_edge": 8}, "do_center_crop": false})).unwrap();
        assert!(processor.process(&RgbImage::new(4, 4), 8).is_ok());
        let error = processor.process(&RgbImage::new(4, 8), 8).unwrap_err();
        assert!(matches!(error, MllmError::Image { .. }));
        assert!(processor.process(&RgbImage::new(0, 0), 8).is_err());
    }
}
