//! `Qwen2VLImageProcessor`, which resizes an image to whole tokens, and the embedding of its
//! patches.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Neutral, Weights};
use crate::family::{ImageLayout, ImageRange, ImageSettings, ModelInfo};
use crate::vision::{Filter, PixelScale, check_not_empty, check_picture, read_processor, resize};
use candle_core::Tensor;
use image::RgbImage;
use planagent_kernels::Linear;
use planagent_kernels::matrix::Matrix;
use serde::Deserialize;
use serde_json::json;

/// Largest ratio of an image's sides (`smart_resize` in transformers).
const MAX_RATIO: f64 = 200.0;
/// Most pixels of an image: beyond it a configuration is taken for broken.
const MAX_PIXELS: f64 = 268_435_456.0;

/// Tokens of an image that Qwen's makers and llama.cpp advise at least where the model has to say
/// where something stands.
const ADVISED_TOKENS: usize = 1024;

/// Resizes images to whole tokens within a number of pixels.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PatchProcessor {
    /// Side of a token, pixels.
    token: u32,
    /// Least and most pixels of an image.
    pixels: [f64; 2],
    filter: Filter,
    scale: PixelScale,
}

/// Least and most pixels, under the names of edges.
#[derive(Deserialize)]
struct Size {
    shortest_edge: Option<u64>,
    longest_edge: Option<u64>,
}

#[derive(Deserialize)]
#[serde(default)]
struct Keys {
    image_processor_type: Option<String>,
    size: Size,
    min_pixels: Option<u64>,
    max_pixels: Option<u64>,
    patch_size: Option<u32>,
    merge_size: Option<u32>,
    resample: Filter,
}

/// The defaults of `Qwen2VLImageProcessor`.
impl Default for Keys {
    fn default() -> Self {
        Self {
            image_processor_type: None,
            size: Size {
                shortest_edge: None,
                longest_edge: None,
            },
            min_pixels: None,
            max_pixels: None,
            patch_size: None,
            merge_size: None,
            resample: Filter::Bicubic,
        }
    }
}

impl PatchProcessor {
    /// Reads the image processor of a model with patches of `patch` pixels, of which `merge` by
    /// `merge` become a token.
    pub(crate) fn open(files: &ModelFiles, patch: u32, merge: u32) -> Result<Self, MllmError> {
        read_processor(files, |_, object| Self::read(object, patch, merge))
    }

    pub(crate) fn read(
        object: &ConfigObject<'_>,
        patch: u32,
        merge: u32,
    ) -> Result<Self, MllmError> {
        object.only_neutral(&[("do_resize", Neutral::Flag(true))])?;
        let keys: Keys = object.read()?;
        if let Some(kind) = keys.image_processor_type.filter(|kind| !is_known(kind)) {
            let problem = format!("'{kind}' is not supported; Qwen2VLImageProcessor is");
            return Err(object.error("image_processor_type", problem));
        }
        for (key, found, expected) in [
            ("patch_size", keys.patch_size, patch),
            ("merge_size", keys.merge_size, merge),
        ] {
            if let Some(found) = found.filter(|found| *found != expected) {
                return Err(
                    object.error(key, format!("is {found}; the vision tower has {expected}"))
                );
            }
        }
        // Older files have their own keys for both bounds, and these go before `size`.
        let least = keys
            .min_pixels
            .or(keys.size.shortest_edge)
            .unwrap_or(56 * 56);
        let most = keys
            .max_pixels
            .or(keys.size.longest_edge)
            .unwrap_or(28 * 28 * 1280);
        let pixels = [least, most].map(|pixels| pixels as f64);
        let token = patch * merge;
        if least == 0
            || least > most
            || pixels[1] > MAX_PIXELS
            || pixels[1] < f64::from(token).powi(2)
        {
            return Err(object.error(
                "max_pixels",
                format!("images of {least} to {most} pixels cannot be made"),
            ));
        }
        Ok(Self {
            token,
            pixels,
            filter: keys.resample,
            scale: PixelScale::read(object)?,
        })
    }

    /// Least and most pixels of an image.
    pub(crate) fn pixels(&self) -> [u64; 2] {
        self.pixels.map(|pixels| pixels as u64)
    }

    /// How pixel values are made.
    pub(crate) fn scale(&self) -> &PixelScale {
        &self.scale
    }

    /// Side of a token, pixels.
    pub(crate) fn token_side(&self) -> usize {
        self.token as usize
    }

    /// Takes the side of the drawn image. Images of this family have no tiles.
    pub(crate) fn set_images(
        &self,
        settings: ImageSettings,
        info: &mut ModelInfo,
    ) -> Result<(), MllmError> {
        if let Some(tiles) = settings.tiles {
            let problem = format!(
                "image.tiles = {tiles}: this family takes an image in one piece; set image.size"
            );
            return Err(MllmError::Image { problem });
        }
        if let Some(side) = settings.size {
            let layout = self.layout(side, side)?;
            (info.image_size, info.max_image_tokens) = (Some(side as usize), layout.tokens);
        }
        Ok(())
    }

    /// How many tokens an image may become.
    pub(crate) fn range(&self) -> ImageRange {
        let [least, most] = self
            .pixels
            .map(|pixels| pixels / f64::from(self.token).powi(2));
        ImageRange {
            least: (least.ceil() as usize).max(1),
            most: most as usize,
            advised: ADVISED_TOKENS,
        }
    }

    /// Bound of an image's tokens.
    pub(crate) fn max_tokens(&self) -> usize {
        (self.pixels[1] / f64::from(self.token).powi(2)) as usize
    }

    /// Width and height of the resized image (`smart_resize` in transformers).
    pub(crate) fn resized(&self, width: u32, height: u32) -> Result<(u32, u32), MllmError> {
        let [least, most] = self.pixels;
        let (long, short) = (f64::from(width.max(height)), f64::from(width.min(height)));
        if short == 0.0 || long / short > MAX_RATIO {
            let problem =
                format!("{width} x {height} pixels: the ratio of the sides is above {MAX_RATIO}");
            return Err(MllmError::Image { problem });
        }
        let token = f64::from(self.token);
        let area = f64::from(width) * f64::from(height);
        let both = |side: &dyn Fn(f64) -> f64| (side(f64::from(width)), side(f64::from(height)));
        let mut sides = both(&|side| (side / token).round_ties_even() * token);
        if sides.0 * sides.1 > most {
            let shrink = (area / most).sqrt();
            sides = both(&|side| ((side / shrink / token).floor() * token).max(token));
        } else if sides.0 * sides.1 < least {
            let grow = (least / area).sqrt();
            sides = both(&|side| (side * grow / token).ceil() * token);
        }
        let (width, height) = (sides.0 as u32, sides.1 as u32);
        check_picture(width, height).map_err(|problem| MllmError::Image { problem })?;
        Ok((width, height))
    }

    /// How an image of this size lies in a chat.
    pub(crate) fn layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        let (width, height) = self.resized(width, height)?;
        let [rows, columns] = [height, width].map(|side| (side / self.token) as usize);
        Ok(ImageLayout {
            tokens: rows * columns,
            rows,
            columns,
        })
    }

    /// Pixel values, (3, height, width), of whole tokens.
    pub(crate) fn process(&self, image: &RgbImage) -> Result<Tensor, MllmError> {
        check_not_empty(image)?;
        let (width, height) = self.resized(image.width(), image.height())?;
        Ok(self
            .scale
            .values(&resize(image, width, height, self.filter))?)
    }

    /// The processor's configuration with these limits, for files that have none.
    pub(crate) fn limits(pixels: [u64; 2]) -> serde_json::Value {
        json!({"shortest_edge": pixels[0], "longest_edge": pixels[1]})
    }
}

/// Whether this is the processor of Qwen2-VL, in one of its forms.
fn is_known(kind: &str) -> bool {
    [
        "Qwen2VLImageProcessor",
        "Qwen3VLImageProcessor",
        "Qwen2_5_VLImageProcessor",
    ]
    .iter()
    .any(|known| kind.starts_with(known))
}

/// Takes the embedding of patches, a convolution over `frames` equal frames, whose kernels are
/// added for a still image. llama.cpp stores the kernels of two frames as two tensors.
pub(crate) fn take_patch_embedding(
    weights: &mut Weights,
    hidden: usize,
    patch: usize,
    frames: usize,
    bias: bool,
) -> Result<Linear, MllmError> {
    const NAME: &str = "vision_tower.embeddings.patch_embedding";
    let second = format!("{NAME}.second.weight");
    let frame = [hidden, 3, patch, patch];
    let kernel = if weights.contains(&second) {
        (weights.take(&format!("{NAME}.weight"), &frame)? + weights.take(&second, &frame)?)?
    } else {
        weights
            .take_of_any_rank(
                &format!("{NAME}.weight"),
                &[hidden, 3, frames, patch, patch],
            )?
            .sum(2)?
    };
    let bias = if bias {
        Some(weights.take(&format!("{NAME}.bias"), &[hidden])?)
    } else {
        None
    };
    Ok(Linear::from_matrix(
        Matrix::from_tensor(&kernel.flatten_from(1)?)?,
        bias,
    ))
}
