//! Image resampling, bit-identical to Pillow's, which the models were trained with.
//!
//! A separable convolution, first along rows, then along columns, with 8-bit intermediate results.
//! Pillow 13 and later take the columns of tall images first; this is the order of earlier
//! versions. For a smaller target, the filter is stretched by the same factor against aliasing.
//! Coefficients are 22-bit fixed point (Pillow, `libImaging/Resample.c`).

use image::RgbImage;
use rayon::prelude::*;
use serde::Deserialize;

/// Bytes of a pixel.
const CHANNELS: usize = 3;
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
            let weights: Vec<f64> = (first..end)
                .map(|pixel| filter.weight((pixel as f64 - center + 0.5) / stretch))
                .collect();
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
        current = along_rows(
            &current,
            &taps(image.width() as usize, width as usize, filter),
        );
    }
    if height != image.height() {
        current = along_columns(
            &current,
            &taps(image.height() as usize, height as usize, filter),
        );
    }
    current
}

/// What a sum starts from, so that the shift rounds it.
const HALF: i32 = 1 << (PRECISION_BITS - 1);

fn rounded(sum: i32) -> u8 {
    (sum >> PRECISION_BITS).clamp(0, 255) as u8
}

fn along_rows(source: &RgbImage, taps: &[Taps]) -> RgbImage {
    let mut target = RgbImage::new(taps.len() as u32, source.height());
    let from = source.par_chunks_exact(CHANNELS * (source.width() as usize).max(1));
    target
        .par_chunks_exact_mut(CHANNELS * taps.len().max(1))
        .zip(from)
        .for_each(|(row, source)| {
            let pixels = source.as_chunks::<CHANNELS>().0;
            for (target, taps) in row.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(taps) {
                let mut sums = [HALF; CHANNELS];
                for (weight, pixel) in taps.weights.iter().zip(pixels.iter().skip(taps.first)) {
                    for (sum, value) in sums.iter_mut().zip(pixel) {
                        *sum += i32::from(*value) * weight;
                    }
                }
                *target = sums.map(rounded);
            }
        });
    target
}

fn along_columns(source: &RgbImage, taps: &[Taps]) -> RgbImage {
    let mut target = RgbImage::new(source.width(), taps.len() as u32);
    let width = CHANNELS * (source.width() as usize).max(1);
    target
        .par_chunks_exact_mut(width)
        .zip(taps)
        .for_each(|(row, taps)| {
            let mut sums = vec![HALF; width];
            for (weight, source) in taps
                .weights
                .iter()
                .zip(source.chunks_exact(width).skip(taps.first))
            {
                for (sum, value) in sums.iter_mut().zip(source) {
                    *sum += i32::from(*value) * weight;
                }
            }
            row.iter_mut()
                .zip(sums)
                .for_each(|(value, sum)| *value = rounded(sum));
        });
    target
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
        // Pillow: Image.new("L", (4, 1)); putdata([0, 0, 255, 255]); resize((2, 1), BILINEAR) gives
        // [36, 219].
        let image = RgbImage::from_fn(4, 1, |x, _| image::Rgb([if x < 2 { 0 } else { 255 }; 3]));
        let resized = resize(&image, 2, 1, Filter::Bilinear);
        assert_eq!(resized.get_pixel(0, 0).0, [36; 3]);
        assert_eq!(resized.get_pixel(1, 0).0, [219; 3]);
    }
}
