//! Image resampling, bit-identical to Pillow's, which the models were trained with.
//!
//! A separable convolution, first along rows, then along columns, with 8-bit intermediate results. Pillow 13 and later take
//! the columns of tall images first; this is the order of earlier versions. For a smaller target, the filter is stretched by
//! the same factor against aliasing. Coefficients are 22-bit fixed point (Pillow, `libImaging/Resample.c`).

use image::RgbImage;
use serde::Deserialize;

/// Bits after the point of the filter coefficients.
const PRECISION_BITS: u32 = 32 - 8 - 2;

/// Pillow's filters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "u64")]
pub(crate) enum Filter {
    /// Windowed sinc of three lobes.
    Lanczos,
    /// Triangle.
    Bilinear,
    /// Catmull-Rom cubic (a = −0.5).
    Bicubic,
}

impl Filter {
    /// Half width, in source pixels at scale 1.
    fn support(self) -> f64 {
        match self {
            Self::Lanczos => 3.0,
            Self::Bilinear => 1.0,
            Self::Bicubic => 2.0,
        }
    }

    fn weight(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Self::Lanczos if x < 3.0 => sinc(x) * sinc(x / 3.0),
            Self::Bilinear if x < 1.0 => 1.0 - x,
            Self::Bicubic if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            Self::Bicubic if x < 2.0 => (((x - 5.0) * x + 8.0) * x - 4.0) * -0.5,
            _ => 0.0,
        }
    }
}

impl TryFrom<u64> for Filter {
    type Error = &'static str;

    /// The filter of a number in `preprocessor_config.json` (`PIL.Image.Resampling`).
    fn try_from(number: u64) -> Result<Self, Self::Error> {
        match number {
            1 => Ok(Self::Lanczos),
            2 => Ok(Self::Bilinear),
            3 => Ok(Self::Bicubic),
            _ => Err("expected 1 (Lanczos), 2 (bilinear) or 3 (bicubic)"),
        }
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else {
        let x = x * std::f64::consts::PI;
        x.sin() / x
    }
}

/// Source pixels and fixed-point weights of one target pixel.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

fn taps(source: usize, target: usize, filter: Filter) -> Vec<Taps> {
    let scale = source as f64 / target as f64;
    let stretch = scale.max(1.0);
    let support = filter.support() * stretch;
    (0..target)
        .map(|index| {
            let center = (index as f64 + 0.5) * scale;
            let first = (center - support + 0.5).max(0.0) as usize;
            let end = ((center + support + 0.5) as usize).min(source);
            let weights: Vec<f64> =
                (first..end).map(|pixel| filter.weight((pixel as f64 - center + 0.5) / stretch)).collect();
            let sum: f64 = weights.iter().sum();
            let norm = if sum == 0.0 { 1.0 } else { sum };
            let weights = weights
                .iter()
                .map(|weight| {
                    let fixed = weight / norm * f64::from(1 << PRECISION_BITS);
                    (fixed + 0.5f64.copysign(fixed)) as i32
                })
                .collect();
            Taps { first, weights }
        })
        .collect()
}

/// Resizes an image to `width` x `height` pixels.
pub(crate) fn resize(image: &RgbImage, width: u32, height: u32, filter: Filter) -> RgbImage {
    let mut current = image.clone();
    if width != image.width() {
        let taps = taps(image.width() as usize, width as usize, filter);
        let source = current;
        current = RgbImage::from_fn(width, source.height(), |x, y| {
            convolve(&taps[x as usize], |pixel| source.get_pixel(pixel as u32, y).0)
        });
    }
    if height != image.height() {
        let taps = taps(image.height() as usize, height as usize, filter);
        let source = current;
        current = RgbImage::from_fn(width, height, |x, y| {
            convolve(&taps[y as usize], |pixel| source.get_pixel(x, pixel as u32).0)
        });
    }
    current
}

fn convolve(taps: &Taps, pixel: impl Fn(usize) -> [u8; 3]) -> image::Rgb<u8> {
    let mut sums = [1i32 << (PRECISION_BITS - 1); 3];
    for (offset, weight) in taps.weights.iter().enumerate() {
        let values = pixel(taps.first + offset);
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += i32::from(value) * weight;
        }
    }
    image::Rgb(sums.map(|sum| (sum >> PRECISION_BITS).clamp(0, 255) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_image_stays_constant() {
        let image = RgbImage::from_pixel(7, 5, image::Rgb([10, 200, 255]));
        for filter in [Filter::Lanczos, Filter::Bilinear, Filter::Bicubic] {
            let resized = resize(&image, 13, 3, filter);
            assert_eq!(resized.dimensions(), (13, 3));
            assert!(resized.pixels().all(|pixel| pixel.0 == [10, 200, 255]));
        }
    }

    #[test]
    fn halving_with_the_triangle_filter_weighs_one_three_three_one() {
        // Pillow: Image.new("L", (4, 1)); putdata([0, 0, 255, 255]); resize((2, 1), BILINEAR) gives [36, 219].
        let image = RgbImage::from_fn(4, 1, |x, _| image::Rgb([if x < 2 { 0 } else { 255 }; 3]));
        let resized = resize(&image, 2, 1, Filter::Bilinear);
        assert_eq!(resized.get_pixel(0, 0).0, [36; 3]);
        assert_eq!(resized.get_pixel(1, 0).0, [219; 3]);
    }
}
