//! Image resampling, bit-identical to Pillow's, which the models were trained with.
//!
//! A separable convolution, first along rows, then along columns, with 8-bit intermediate results.
//! Pillow 13 and later take the columns of tall images first; this is the order of earlier
//! versions. For a smaller target, the filter is stretched by the same factor against aliasing.
//! Coefficients are 22-bit fixed point (Pillow, `libImaging/Resample.c`).
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

use image::RgbImage;
use planagent_kernels::matrix::{Instructions, Kernel, LANES, Simd};
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

#[inline(always)]
fn rounded(sum: i32) -> u8 {
    (sum >> PRECISION_BITS).clamp(0, 255) as u8
}

fn along_rows(source: &RgbImage, taps: &[Taps]) -> RgbImage {
    let mut target = RgbImage::new(taps.len() as u32, source.height());
    let width = CHANNELS * (source.width() as usize).max(1);
    let from = source.par_chunks(LANES * width);
    target
        .par_chunks_mut(LANES * CHANNELS * taps.len().max(1))
        .zip(from)
        .for_each(|(rows, source)| {
            Instructions::best().run(RowsKernel {
                source,
                width,
                taps,
                rows,
            });
        });
    target
}

/// Resizes some rows, at most as many as a vector has lanes.
struct RowsKernel<'a> {
    source: &'a [u8],
    /// Bytes of a row of the source.
    width: usize,
    taps: &'a [Taps],
    rows: &'a mut [u8],
}

impl Kernel for RowsKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        // A vector has the same byte of all rows.
        let mut columns = vec![[0i32; LANES]; self.width];
        for (lane, row) in self.source.chunks_exact(self.width).enumerate() {
            for (column, byte) in columns.iter_mut().zip(row) {
                column[lane] = i32::from(*byte);
            }
        }
        let width = CHANNELS * self.taps.len();
        for (index, taps) in self.taps.iter().enumerate() {
            for channel in 0..CHANNELS {
                let columns = columns[CHANNELS * taps.first + channel..].iter();
                let mut sums = [HALF; LANES];
                for (weight, column) in taps.weights.iter().zip(columns.step_by(CHANNELS)) {
                    for (sum, value) in sums.iter_mut().zip(column) {
                        *sum += weight * value;
                    }
                }
                let place = CHANNELS * index + channel;
                for (row, sum) in self.rows.chunks_exact_mut(width).zip(sums) {
                    row[place] = rounded(sum);
                }
            }
        }
    }
}

fn along_columns(source: &RgbImage, taps: &[Taps]) -> RgbImage {
    let mut target = RgbImage::new(source.width(), taps.len() as u32);
    let width = CHANNELS * (source.width() as usize).max(1);
    target
        .par_chunks_exact_mut(width)
        .zip(taps)
        .for_each(|(row, taps)| {
            Instructions::best().run(ColumnKernel { source, taps, row });
        });
    target
}

/// Computes one row from the source rows of its taps.
struct ColumnKernel<'a> {
    source: &'a RgbImage,
    taps: &'a Taps,
    row: &'a mut [u8],
}

impl Kernel for ColumnKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let mut sums = vec![HALF; self.row.len()];
        let rows = self.source.chunks_exact(self.row.len());
        for (weight, row) in self.taps.weights.iter().zip(rows.skip(self.taps.first)) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += i32::from(*value) * weight;
            }
        }
        for (value, sum) in self.row.iter_mut().zip(sums) {
            *value = rounded(sum);
        }
    }
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

    /// Both passes, pixel by pixel.
    fn plain(image: &RgbImage, width: u32, height: u32, filter: Filter) -> RgbImage {
        let sum = |taps: &Taps, pixel: &dyn Fn(u32) -> [u8; CHANNELS]| {
            let mut sums = [HALF; CHANNELS];
            for (at, weight) in (taps.first as u32..).zip(&taps.weights) {
                for (sum, value) in sums.iter_mut().zip(pixel(at)) {
                    *sum += i32::from(value) * weight;
                }
            }
            image::Rgb(sums.map(rounded))
        };
        let rows = taps(image.width() as usize, width as usize, filter);
        let wide = RgbImage::from_fn(width, image.height(), |x, y| {
            sum(&rows[x as usize], &|at| image.get_pixel(at, y).0)
        });
        let columns = taps(image.height() as usize, height as usize, filter);
        RgbImage::from_fn(width, height, |x, y| {
            sum(&columns[y as usize], &|at| wide.get_pixel(x, at).0)
        })
    }

    #[test]
    fn vectors_give_the_pixels_of_plain_sums() {
        // Black and white, so that sums leave the range of a byte.
        let noise = |x: u32, y: u32| (x * 7919 + y * 104_729 + x * y * 31) % 5;
        let picture = RgbImage::from_fn(61, 37, |x, y| {
            image::Rgb([0, 1, 2].map(|channel| 255 * u8::from(noise(x + channel, y) > 1)))
        });
        for filter in [Filter::Lanczos, Filter::Bilinear, Filter::Bicubic] {
            for (width, height) in [(61, 90), (200, 37), (130, 111), (9, 5), (1, 1), (60, 36)] {
                let found = resize(&picture, width, height, filter);
                let expected = plain(&picture, width, height, filter);
                assert!(found == expected, "{filter:?} to {width} x {height}");
            }
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
