//! The image processor of CLIP: from an RGB image to the pixel values that the vision tower was trained on.

use std::path::{Path, PathBuf};

use candle_core::Tensor;
use image::RgbImage;
use image::imageops;
use serde_json::Value;

use super::pixels::{PixelScale, check_not_empty};
use super::resample::{Filter, resize};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ModelFiles, Section};

/// Side that `CLIPImageProcessor` resizes and crops to when its configuration does not say.
pub(crate) const DEFAULT_SIDE: u32 = 224;

/// `CLIPImageProcessor`: resize, centre crop, rescale, normalise.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ClipImageProcessor {
    path: PathBuf,
    resize: Option<(TargetSize, Filter)>,
    /// Height and width.
    crop: Option<(u32, u32)>,
    scale: PixelScale,
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
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        read_processor(files, Self::from_section)
    }

    fn from_section(path: &Path, section: &Section<'_>) -> Result<Self, MllmError> {
        check_processor(section, "CLIPImageProcessor")?;
        let resize = if section.flag("do_resize", true)? {
            Some((target_size(section)?, resample_filter(section)?))
        } else {
            None
        };
        let crop = if section.flag("do_center_crop", true)? {
            Some(sides(section, "crop_size")?.unwrap_or(Sides::One(DEFAULT_SIDE)).height_width())
        } else {
            None
        };
        Ok(Self { path: path.to_path_buf(), resize, crop, scale: PixelScale::from_section(section)? })
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
        check_not_empty(image)?;
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
        Ok(self.scale.values(pixels)?)
    }
}

/// Reads the image processor of a model: `preprocessor_config.json`, or the `image_processor` part of
/// `processor_config.json` (transformers 5).
///
/// # Errors
/// When neither file is there or is broken, and what `read` returns.
pub(crate) fn read_processor<T>(
    files: &ModelFiles,
    read: impl FnOnce(&Path, &Section<'_>) -> Result<T, MllmError>,
) -> Result<T, MllmError> {
    const NAME: &str = "preprocessor_config.json";
    if let Some(value) = files.json(NAME)? {
        let path = files.path(NAME);
        return read(&path, &Section::root(&path, &value)?);
    }
    if let Some(value) = files.json("processor_config.json")? {
        let path = files.path("processor_config.json");
        if let Some(section) = Section::root(&path, &value)?.section("image_processor", "image_processor.")? {
            return read(&path, &section);
        }
    }
    Err(files.missing(NAME))
}

/// Checks that a section describes an image processor of this kind (its `Fast` and `Pil` forms compute the same).
///
/// # Errors
/// When it names another.
pub(crate) fn check_processor(section: &Section<'_>, expected: &str) -> Result<(), MllmError> {
    match section.text("image_processor_type")? {
        Some(kind) if !kind.starts_with(expected) => {
            Err(section.error("image_processor_type", format!("{kind:?} is not supported; {expected} is")))
        }
        _ => Ok(()),
    }
}

/// Reads `resample`; bicubic if absent.
///
/// # Errors
/// When the filter is not known.
pub(crate) fn resample_filter(section: &Section<'_>) -> Result<Filter, MllmError> {
    let number = match section.get("resample") {
        None => return Ok(Filter::Bicubic),
        Some(value) => value.as_u64(),
    };
    number
        .and_then(Filter::from_pillow)
        .ok_or_else(|| section.error("resample", "expected 1 (Lanczos), 2 (bilinear) or 3 (bicubic)".into()))
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
pub(crate) enum Sides {
    /// A number.
    One(u32),
    /// `shortest_edge`.
    ShortestEdge(u32),
    /// `height` and `width`.
    Exact {
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
    },
}

impl Sides {
    /// Height and width, where one number stands for a square.
    pub(crate) fn height_width(&self) -> (u32, u32) {
        match *self {
            Self::One(side) | Self::ShortestEdge(side) => (side, side),
            Self::Exact { height, width } => (height, width),
        }
    }
}

/// Reads a size; none if absent.
///
/// # Errors
/// When it is none, or out of range.
pub(crate) fn sides(section: &Section<'_>, key: &str) -> Result<Option<Sides>, MllmError> {
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
        None => TargetSize::ShortestEdge(DEFAULT_SIDE),
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
impl ClipImageProcessor {
    /// CLIP's processor for squares of `side` pixels.
    pub(crate) fn square(side: u32) -> Self {
        Self {
            path: PathBuf::new(),
            resize: Some((TargetSize::ShortestEdge(side), Filter::Bicubic)),
            crop: Some((side, side)),
            scale: PixelScale::CLIP,
        }
    }
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
