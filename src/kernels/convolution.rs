//! Convolutions over an image whose pixels are the rows of a table, (rows · columns, channels), with
//! zeros around it: as many as give ceil(length / stride) windows along an axis, half of them before
//! and the odd one behind ("same" padding in TensorFlow).
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

use super::linear::Linear;
use super::matrix::{Instructions, Kernel, Simd};
use super::values::{in_parts, with_values};
use super::work::Work;
use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;
use std::ops::Range;

/// Numbers of the windows that are laid out at once: 64 MiB.
const MAX_LAID_OUT: usize = 1 << 24;

/// Rows and columns of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Pixels from top to bottom.
    pub rows: usize,
    /// Pixels from left to right.
    pub columns: usize,
}

impl Grid {
    /// A square of `side` by `side` pixels.
    pub fn square(side: usize) -> Self {
        Self {
            rows: side,
            columns: side,
        }
    }

    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.rows * self.columns
    }

    /// The windows that are `stride` pixels apart.
    #[must_use]
    pub fn strided(self, stride: usize) -> Self {
        Self {
            rows: self.rows.div_ceil(stride),
            columns: self.columns.div_ceil(stride),
        }
    }
}

/// Square windows of `side` pixels, `stride` pixels apart. Neither is 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Windows {
    /// Pixels along a side of a window.
    side: usize,
    /// Pixels from a window to the next.
    stride: usize,
}

/// The part of a window within the image, along an axis.
struct Seen {
    /// The first pixel of the image.
    first: usize,
    /// The pixels of the window.
    taps: Range<usize>,
}

impl Windows {
    fn check(self) -> Result<()> {
        if self.side == 0 || self.stride == 0 {
            bail!("{self:?} are no windows");
        }
        Ok(())
    }

    /// The part of window `index` within an axis of `length` pixels.
    fn seen(self, index: usize, length: usize) -> Seen {
        let last = length.div_ceil(self.stride).saturating_sub(1) * self.stride;
        let before = (last + self.side).saturating_sub(length) / 2;
        let start = index * self.stride;
        let first = before.saturating_sub(start);
        let end = self.side.min((length + before).saturating_sub(start));
        Seen {
            first: start + first - before,
            taps: first..end.max(first),
        }
    }

    /// The windows of some rows of windows, (windows, side · side · channels), pixels in raster order
    /// and their channels last.
    fn laid_out(
        self,
        values: &[f32],
        grid: Grid,
        channels: usize,
        rows: Range<usize>,
    ) -> Result<Tensor> {
        let columns = grid.strided(self.stride).columns;
        let window = self.side * self.side * channels;
        let mut out = vec![0f32; rows.len() * columns * window];
        out.par_chunks_mut(columns * window)
            .zip(rows.clone())
            .for_each(|(line, row)| {
                let down = self.seen(row, grid.rows);
                for (column, window) in line.chunks_exact_mut(window).enumerate() {
                    let across = self.seen(column, grid.columns);
                    let count = across.taps.len() * channels;
                    for (offset, tap) in down.taps.clone().enumerate() {
                        let pixel = (down.first + offset) * grid.columns + across.first;
                        let place = (tap * self.side + across.taps.start) * channels;
                        window[place..place + count]
                            .copy_from_slice(&values[pixel * channels..][..count]);
                    }
                }
            });
        Tensor::from_vec(out, (rows.len() * columns, window), &Device::Cpu)
    }
}

/// Checks that a table has the pixels of an image, and gives its channels.
fn channels_of(x: &Tensor, grid: Grid) -> Result<usize> {
    let (pixels, channels) = x.dims2()?;
    if pixels != grid.pixels() || pixels == 0 || channels == 0 {
        bail!("{pixels} pixels of {channels} channels are no image of {grid:?}");
    }
    Ok(channels)
}

/// A convolution over all channels.
#[derive(Debug)]
pub struct Convolution {
    windows: Windows,
    inputs: usize,
    weight: Linear,
}

impl Convolution {
    /// Of a weight (outputs, inputs, side, side) and a bias of as many numbers as outputs.
    ///
    /// # Errors
    /// When the weight is no such tensor of f32, or the stride is 0.
    pub fn new(weight: &Tensor, bias: Option<Tensor>, stride: usize) -> Result<Self> {
        let (outputs, inputs, side, other) = weight.dims4()?;
        let windows = Windows { side, stride };
        windows.check()?;
        if side != other || inputs == 0 {
            bail!("a convolution of {:?} is not supported", weight.shape());
        }
        let weight = weight
            .permute((0, 2, 3, 1))?
            .contiguous()?
            .reshape((outputs, side * side * inputs))?;
        Ok(Self {
            windows,
            inputs,
            weight: Linear::from_tensors(&weight, bias)?,
        })
    }

    /// Maps an image (rows · columns, inputs) to (windows, outputs).
    ///
    /// # Errors
    /// When the table is no such image.
    pub fn forward(&self, x: &Tensor, grid: Grid) -> Result<Tensor> {
        let channels = channels_of(x, grid)?;
        if channels != self.inputs {
            bail!("{channels} channels, where {} are expected", self.inputs);
        }
        let out = grid.strided(self.windows.stride);
        let line = out.columns * self.windows.side * self.windows.side * channels;
        let strip = (MAX_LAID_OUT / line).clamp(1, out.rows);
        with_values(x, |values| {
            let strips = (0..out.rows).step_by(strip).map(|first| {
                let rows = first..out.rows.min(first + strip);
                let windows = self.windows.laid_out(values, grid, channels, rows)?;
                self.weight.forward(&windows)
            });
            let strips = strips.collect::<Result<Vec<_>>>()?;
            Tensor::cat(&strips, 0)
        })
    }
}

/// A convolution of each channel by itself.
#[derive(Debug)]
pub struct Depthwise {
    windows: Windows,
    channels: usize,
    /// (side · side, channels)
    taps: Vec<f32>,
}

impl Depthwise {
    /// Of a weight (channels, 1, side, side).
    ///
    /// # Errors
    /// When the weight is no such tensor of f32, or the stride is 0.
    pub fn new(weight: &Tensor, stride: usize) -> Result<Self> {
        let (channels, one, side, other) = weight.dims4()?;
        let windows = Windows { side, stride };
        windows.check()?;
        if one != 1 || side != other || channels == 0 {
            bail!("a convolution of {:?} is not supported", weight.shape());
        }
        let taps = weight.reshape((channels, side * side))?.t()?;
        Ok(Self {
            windows,
            channels,
            taps: taps.flatten_all()?.to_vec1()?,
        })
    }

    /// Maps an image (rows · columns, channels) to (windows, channels).
    ///
    /// # Errors
    /// When the table is no such image.
    pub fn forward(&self, x: &Tensor, grid: Grid) -> Result<Tensor> {
        let channels = channels_of(x, grid)?;
        if channels != self.channels {
            bail!("{channels} channels, where {} are expected", self.channels);
        }
        let out = grid.strided(self.windows.stride);
        let taps = self.windows.side * self.windows.side;
        Work::count(out.pixels(), taps, channels, size_of_val(&*self.taps));
        with_values(x, |values| {
            let line = out.columns * channels;
            let sums = in_parts(out.pixels() * channels, line, |row, sums| {
                Instructions::best().run(Line {
                    convolution: self,
                    values,
                    grid,
                    row,
                    sums,
                });
            });
            Tensor::from_vec(sums, (out.pixels(), channels), &Device::Cpu)
        })
    }
}

/// A row of windows of a [`Depthwise`].
struct Line<'a> {
    convolution: &'a Depthwise,
    values: &'a [f32],
    grid: Grid,
    row: usize,
    sums: &'a mut [f32],
}

impl Kernel for Line<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Depthwise {
            windows,
            channels,
            taps,
        } = self.convolution;
        let down = windows.seen(self.row, self.grid.rows);
        for (column, sums) in self.sums.chunks_exact_mut(*channels).enumerate() {
            let across = windows.seen(column, self.grid.columns);
            let count = across.taps.len() * channels;
            for (offset, tap) in down.taps.clone().enumerate() {
                let pixel = (down.first + offset) * self.grid.columns + across.first;
                let place = (tap * windows.side + across.taps.start) * channels;
                let pixels = self.values[pixel * channels..][..count].chunks_exact(*channels);
                let taps = taps[place..][..count].chunks_exact(*channels);
                for (pixel, tap) in pixels.zip(taps) {
                    for ((sum, value), weight) in sums.iter_mut().zip(pixel).zip(tap) {
                        *sum += value * weight;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from -1 to 1 without a pattern.
    fn numbers(shape: &[usize]) -> Tensor {
        let count: usize = shape.iter().product();
        let values: Vec<f32> = (0..count)
            .map(|index| ((index * index) as f32).sin())
            .collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    /// candle's convolution of an image with zeros around it by the rule.
    fn expected(image: &Tensor, weight: &Tensor, stride: usize, groups: usize) -> Tensor {
        let side = weight.dims()[3];
        let mut padded = image.clone();
        for axis in [2, 3] {
            let length = image.dims()[axis];
            let all = ((length.div_ceil(stride) - 1) * stride + side).saturating_sub(length);
            padded = padded.pad_with_zeros(axis, all / 2, all - all / 2).unwrap();
        }
        let found = padded.conv2d(weight, 0, stride, 1, groups).unwrap();
        let outputs = found.dims()[1];
        found
            .permute((0, 2, 3, 1))
            .unwrap()
            .reshape(((), outputs))
            .unwrap()
    }

    /// Sums of up to 500 products in another order differ by some units in the last place of the
    /// largest: torch's own in 32 bits by up to 6e-7 of it from those in 64.
    fn assert_near(found: &Tensor, expected: &Tensor) {
        let largest = |x: &Tensor| x.abs().unwrap().max_all().unwrap();
        assert_eq!(found.dims(), expected.dims());
        let off = largest(&(found - expected).unwrap());
        let [off, all] = [off, largest(expected)].map(|x| x.to_scalar::<f32>().unwrap());
        assert!(off < 4e-6 * all.max(1.0), "{off} of {all}");
    }

    const CASES: [(usize, usize, Grid); 7] = [
        (
            3,
            1,
            Grid {
                rows: 5,
                columns: 4,
            },
        ),
        (
            3,
            2,
            Grid {
                rows: 8,
                columns: 9,
            },
        ),
        (
            3,
            2,
            Grid {
                rows: 7,
                columns: 6,
            },
        ),
        (
            5,
            2,
            Grid {
                rows: 6,
                columns: 12,
            },
        ),
        (
            5,
            1,
            Grid {
                rows: 3,
                columns: 2,
            },
        ),
        (
            1,
            2,
            Grid {
                rows: 4,
                columns: 3,
            },
        ),
        (
            5,
            2,
            Grid {
                rows: 1,
                columns: 1,
            },
        ),
    ];

    #[test]
    fn convolutions_are_candles_with_the_odd_zero_behind() {
        for (side, stride, grid) in CASES {
            let image = numbers(&[1, 20, grid.rows, grid.columns]);
            let pixels = image.permute((0, 2, 3, 1)).unwrap();
            let pixels = pixels.reshape((grid.pixels(), 20)).unwrap();
            let weight = numbers(&[7, 20, side, side]);
            let bias = numbers(&[7]);
            let all = Convolution::new(&weight, Some(bias.clone()), stride).unwrap();
            let sums = expected(&image, &weight, stride, 1);
            let sums = sums.broadcast_add(&bias).unwrap();
            assert_near(&all.forward(&pixels, grid).unwrap(), &sums);
            let weight = numbers(&[20, 1, side, side]);
            let each = Depthwise::new(&weight, stride).unwrap();
            assert_near(
                &each.forward(&pixels, grid).unwrap(),
                &expected(&image, &weight, stride, 20),
            );
        }
    }

    /// So large that it is laid out in strips.
    #[test]
    fn strips_of_windows_follow_one_another() {
        let grid = Grid {
            rows: 300,
            columns: 200,
        };
        let image = numbers(&[1, 32, grid.rows, grid.columns]);
        assert!(grid.pixels() * 9 * 32 > MAX_LAID_OUT);
        let pixels = image.permute((0, 2, 3, 1)).unwrap();
        let pixels = pixels.reshape((grid.pixels(), 32)).unwrap();
        let weight = numbers(&[2, 32, 3, 3]);
        let found = Convolution::new(&weight, None, 1).unwrap();
        assert_near(
            &found.forward(&pixels, grid).unwrap(),
            &expected(&image, &weight, 1, 1),
        );
    }

    #[test]
    fn other_shapes_are_refused() {
        let weight = numbers(&[4, 1, 3, 3]);
        assert!(Depthwise::new(&weight, 0).is_err());
        assert!(Depthwise::new(&numbers(&[4, 2, 3, 3]), 1).is_err());
        assert!(Convolution::new(&numbers(&[4, 2, 3, 1]), None, 1).is_err());
        let each = Depthwise::new(&weight, 1).unwrap();
        for (shape, grid) in [([6, 4], Grid::square(2)), ([4, 3], Grid::square(2))] {
            assert!(each.forward(&numbers(&shape), grid).is_err());
        }
    }
}
