//! The image processor of CLIP, which converts an RGB image to the input of the vision tower.

use super::pixels::{PixelScale, check_not_empty, check_picture};
use super::resample::{Filter, resize};
use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral};
use candle_core::Tensor;
use image::RgbImage;
use image::imageops;
use serde::Deserialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Default side of `CLIPImageProcessor`.
const DEFAULT_SIDE: u32 = 224;

/// Filters by their number in a configuration.
const BILINEAR: u32 = 2;
const BICUBIC: u32 = 3;

/// The processor of `SigLIP`, which computes what CLIP's does with other defaults.
const SIGLIP: &str = "SiglipImageProcessor";
/// The processor of Gemma 3, which is `SigLIP`'s with another filter where it does not cut crops out
/// of long images ("pan and scan").
const GEMMA: &str = "Gemma3ImageProcessor";
/// The processor of LLaVA, which is CLIP's where it does not pad.
const LLAVA: &str = "LlavaImageProcessor";

/// `CLIPImageProcessor` or `SiglipImageProcessor`: resize, center crop, rescale, normalize.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ClipImageProcessor {
    path: PathBuf,
    resize: Option<(TargetSize, Filter)>,
    /// Height and width.
    crop: Option<(u32, u32)>,
    scale: PixelScale,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TargetSize {
    /// Length of the shorter side; the aspect ratio stays.
    ShortestEdge(u32),
    Exact {
        height: u32,
        width: u32,
    },
}

impl ClipImageProcessor {
    pub(crate) fn open(files: &ModelFiles) -> Result<Self, MllmError> {
        read_processor(files, Self::read)
    }

    pub(crate) fn read(path: &Path, object: &ConfigObject<'_>) -> Result<Self, MllmError> {
        let kind: Option<String> = object.value("image_processor_type")?;
        let is = |known: &str| kind.as_ref().is_some_and(|kind| kind.starts_with(known));
        let (object, expected) = if is(SIGLIP) || is(GEMMA) {
            object.only_neutral(&[("do_pan_and_scan", Neutral::Flag(false))])?;
            let half = [0.5, 0.5, 0.5];
            let defaults = json!({
                "size": {"height": DEFAULT_SIDE, "width": DEFAULT_SIDE}, "do_center_crop": false, "image_mean": half,
                "image_std": half, "resample": if is(GEMMA) { BILINEAR } else { BICUBIC },
            });
            let known = if is(GEMMA) { GEMMA } else { SIGLIP };
            (object.clone().with_defaults(defaults), known)
        } else if is(LLAVA) {
            object.only_neutral(&[("do_pad", Neutral::Flag(false))])?;
            (object.clone(), LLAVA)
        } else {
            (object.clone(), "CLIPImageProcessor")
        };
        let keys = ProcessorKeys::read(&object, expected)?;
        let target = match keys.size {
            Sides::One(edge)
            | Sides::ShortestEdge {
                shortest_edge: edge,
            } => TargetSize::ShortestEdge(edge.0),
            Sides::Exact { height, width } => TargetSize::Exact {
                height: height.0,
                width: width.0,
            },
        };
        let crop = keys.do_center_crop.then(|| keys.crop_size.height_width());
        // A stranger's file decides these sizes, which are memory.
        for (key, made) in [
            ("size", keys.do_resize.then(|| keys.size.height_width())),
            ("crop_size", crop),
        ] {
            if let Some((height, width)) = made {
                check_picture(width, height).map_err(|problem| object.error(key, problem))?;
            }
        }
        Ok(Self {
            path: path.to_path_buf(),
            resize: keys.do_resize.then_some((target, keys.resample)),
            crop,
            scale: PixelScale::read(&object)?,
        })
    }

    /// How pixel values are made.
    pub(crate) fn scale(&self) -> &PixelScale {
        &self.scale
    }

    /// The side of the square that images become, pixels.
    ///
    /// # Errors
    /// When the file configures none.
    pub(crate) fn fixed_side(&self) -> Result<usize, MllmError> {
        match self.made() {
            Some((_, height, width)) if height == width => Ok(height as usize),
            _ => Err(self.wrong_side("is no square; the vision tower takes squares".into())),
        }
    }

    /// The error of a configured size.
    pub(crate) fn wrong_side(&self, problem: String) -> MllmError {
        MllmError::Config {
            path: self.path.clone(),
            key: self.made().map_or("size", |(key, ..)| key).into(),
            problem,
        }
    }

    /// The key of the configured size, and the height and width that images become.
    fn made(&self) -> Option<(&'static str, u32, u32)> {
        match (self.crop, self.resize) {
            (Some((height, width)), _) => Some(("crop_size", height, width)),
            (None, Some((TargetSize::Exact { height, width }, _))) => Some(("size", height, width)),
            _ => None,
        }
    }

    /// Checks that the configured size is the square input of the vision tower, where one is
    /// configured.
    pub(crate) fn check_side(&self, side: usize) -> Result<(), MllmError> {
        match self.made() {
            Some((_, height, width)) if [height, width] != [side as u32; 2] => Err(self
                .wrong_side(format!(
                    "is {width} x {height} pixels; the vision tower takes {side} x {side}"
                ))),
            _ => Ok(()),
        }
    }

    /// Converts an image to pixel values (3, `side`, `side`).
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
        let cropped = self
            .crop
            .map(|(height, width)| center_crop(resized, width, height));
        let pixels = cropped.as_ref().unwrap_or(resized);
        if (pixels.width() as usize, pixels.height() as usize) != (side, side) {
            return Err(MllmError::Image {
                problem: format!(
                    "{} x {} pixels become {} x {}; the vision tower takes {side} x {side}",
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

/// Reads `preprocessor_config.json`, or the `image_processor` of `processor_config.json`
/// (transformers 5).
pub(crate) fn read_processor<T>(
    files: &ModelFiles,
    read: impl FnOnce(&Path, &ConfigObject<'_>) -> Result<T, MllmError>,
) -> Result<T, MllmError> {
    const NAME: &str = "preprocessor_config.json";
    if let Some(value) = files.json(NAME)? {
        let path = files.path(NAME);
        return read(&path, &ConfigObject::root(&path, &value)?);
    }
    if let Some(value) = files.json("processor_config.json")? {
        let path = files.path("processor_config.json");
        if let Some(object) = ConfigObject::root(&path, &value)?.child("image_processor")? {
            return read(&path, &object);
        }
    }
    Err(files.missing(NAME))
}

/// The keys of an image processor, with the defaults of `CLIPImageProcessor`.
#[derive(Deserialize)]
#[serde(default)]
pub(crate) struct ProcessorKeys {
    image_processor_type: Option<String>,
    do_resize: bool,
    pub size: Sides,
    pub resample: Filter,
    do_center_crop: bool,
    pub crop_size: Sides,
}

impl Default for ProcessorKeys {
    fn default() -> Self {
        Self {
            image_processor_type: None,
            do_resize: true,
            size: Sides::One(Side(DEFAULT_SIDE)),
            resample: Filter::Bicubic,
            do_center_crop: true,
            crop_size: Sides::One(Side(DEFAULT_SIDE)),
        }
    }
}

impl ProcessorKeys {
    /// Reads a processor of this type; its `Fast` and `Pil` forms compute the same.
    pub(crate) fn read(object: &ConfigObject<'_>, expected: &str) -> Result<Self, MllmError> {
        let keys: Self = object.read()?;
        match &keys.image_processor_type {
            Some(kind) if !kind.starts_with(expected) => Err(object.error(
                "image_processor_type",
                format!("'{kind}' is not supported; {expected} is"),
            )),
            _ => Ok(keys),
        }
    }
}

impl TargetSize {
    /// Width and height of the resized image.
    fn dimensions(self, image: &RgbImage) -> Result<(u32, u32), MllmError> {
        match self {
            Self::Exact { height, width } => Ok((width, height)),
            Self::ShortestEdge(edge) => {
                let (width, height) = image.dimensions();
                let long =
                    u64::from(edge) * u64::from(width.max(height)) / u64::from(width.min(height));
                let long = u32::try_from(long)
                    .ok()
                    .filter(|long| *long as usize <= MAX_SIDE)
                    .ok_or_else(|| MllmError::Image {
                        problem: format!("{width} x {height} pixels are too narrow to be resized"),
                    })?;
                let (width, height) = if width <= height {
                    (edge, long)
                } else {
                    (long, edge)
                };
                check_picture(width, height).map_err(|problem| MllmError::Image { problem })?;
                Ok((width, height))
            }
        }
    }
}

/// Maximum side of a resized image, pixels.
const MAX_SIDE: usize = 1 << 16;

/// A side, pixels, from 1 to [`MAX_SIDE`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "u64")]
pub(crate) struct Side(pub u32);

impl TryFrom<u64> for Side {
    type Error = String;

    fn try_from(side: u64) -> Result<Self, String> {
        let valid = (1..=MAX_SIDE as u64).contains(&side);
        valid
            .then_some(Self(side as u32))
            .ok_or_else(|| format!("expected a side from 1 to {MAX_SIDE}, found {side}"))
    }
}

/// A size in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "expected a size: a number, shortest_edge, or height and width, each from 1 to 65536"
)]
pub(crate) enum Sides {
    One(Side),
    ShortestEdge { shortest_edge: Side },
    Exact { height: Side, width: Side },
}

impl Sides {
    /// Height and width; one number stands for a square.
    pub(crate) fn height_width(self) -> (u32, u32) {
        match self {
            Self::One(side)
            | Self::ShortestEdge {
                shortest_edge: side,
            } => (side.0, side.0),
            Self::Exact { height, width } => (height.0, width.0),
        }
    }
}

/// Cuts out the middle. A smaller image gets black margins, as in transformers.
fn center_crop(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    // Rounding down puts the odd pixel of a black margin above and left.
    let offset = |have: u32, want: u32| (i64::from(have) - i64::from(want)).div_euclid(2);
    let mut cropped = RgbImage::new(width, height);
    imageops::replace(
        &mut cropped,
        image,
        -offset(image.width(), width),
        -offset(image.height(), height),
    );
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
    use serde_json::{Value, json};

    fn processor(value: &Value) -> Result<ClipImageProcessor, MllmError> {
        let path = Path::new("preprocessor_config.json");
        ClipImageProcessor::read(path, &ConfigObject::root(path, value)?)
    }

    #[test]
    fn small_images_are_padded_and_large_ones_cut_in_the_middle() {
        let image = RgbImage::from_fn(2, 5, |_, y| image::Rgb([y as u8 + 1; 3]));
        let cropped = center_crop(&image, 3, 3);
        let column = |x: u32| {
            (0..3)
                .map(|y| cropped.get_pixel(x, y).0[0])
                .collect::<Vec<_>>()
        };
        assert_eq!(
            [column(0), column(1), column(2)],
            [[0, 0, 0], [2, 3, 4], [2, 3, 4]]
        );
    }

    #[test]
    fn siglips_processor_squeezes_and_centers_pixels_at_one_half() {
        let keys = json!({"image_processor_type": "SiglipImageProcessor", "size": {"height": 4, "width": 4}});
        let processor = processor(&keys).unwrap();
        assert_eq!(processor.crop, None);
        processor.check_side(4).unwrap();
        let values = processor
            .process(&RgbImage::from_pixel(8, 3, image::Rgb([255, 0, 255])), 4)
            .unwrap();
        let values: Vec<f32> = values.flatten_all().unwrap().to_vec1().unwrap();
        let all = |values: &[f32], expected: f32| {
            values.iter().all(|value| (value - expected).abs() < 1e-6)
        };
        assert!(all(&values[..16], 1.0) && all(&values[16..32], -1.0));
    }

    #[test]
    fn values_are_rescaled_then_normalized() {
        let processor = processor(&json!({
            "do_resize": false, "do_center_crop": false,
            "image_mean": [0.5, 0.5, 0.5], "image_std": [0.25, 0.5, 1.0],
        }))
        .unwrap();
        let image = RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 51]));
        let values: Vec<f32> = processor
            .process(&image, 1)
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        for (value, expected) in values.iter().zip([2.0, -1.0, -0.3]) {
            assert!((value - expected).abs() < 1e-6, "{values:?}");
        }
    }

    #[test]
    fn wrong_sizes_and_filters_are_errors() {
        for wrong in [
            json!({"size": {"height": 3}}),
            json!({"size": {"shortest_edge": 3, "height": 3}}),
            json!({"size": "big"}),
            json!({"crop_size": 0}),
            json!({"resample": 0}),
            json!({"image_std": [1, 0, 1]}),
            json!({"image_mean": [1, 2]}),
            json!({"image_processor_type": "BlipImageProcessor"}),
        ] {
            assert!(
                matches!(processor(&wrong), Err(MllmError::Config { .. })),
                "{wrong}"
            );
        }
        let fixed = processor(&json!({"crop_size": 32})).unwrap();
        assert!(fixed.check_side(32).is_ok());
        assert!(matches!(
            fixed.check_side(64),
            Err(MllmError::Config { .. })
        ));
    }

    #[test]
    fn an_image_that_does_not_become_the_towers_square_is_an_error() {
        let processor =
            processor(&json!({"size": {"shortest_edge": 8}, "do_center_crop": false})).unwrap();
        assert!(processor.process(&RgbImage::new(4, 4), 8).is_ok());
        let error = processor.process(&RgbImage::new(4, 8), 8).unwrap_err();
        assert!(matches!(error, MllmError::Image { .. }));
        assert!(processor.process(&RgbImage::new(0, 0), 8).is_err());
    }
}
