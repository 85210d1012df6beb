//! The layout of packed weights: tiles of sixteen rows that the kernels load as vectors.
//!
//! A vector register holds one number, or four bytes, of each row of a tile. A tile is cut into
//! groups along its inputs. A group holds the bytes of the rows' blocks in another order, so the
//! original blocks can be written again bit for bit. The packed weights take hardly more memory
//! than the file.

use super::line::{CacheLine, LANES};
use super::weight_format::WeightFormat;
use rayon::prelude::*;
use std::io::{self, Write};

/// Bytes of a cache line, the unit in which tiles are stored.
const LINE: usize = size_of::<CacheLine>();

/// The byte order of a group.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// Numbers of a row in a group.
    span: usize,
    /// Bytes of a row in a group.
    row_bytes: usize,
    lines: usize,
    runs: Vec<Run>,
}

/// Bytes of a row that stay adjacent.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Offset in the row's bytes.
    from: usize,
    width: usize,
    /// Offset in the group for row 0; the other rows follow.
    to: usize,
    change: Change,
}

/// What becomes of the bytes of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Change {
    None,
    /// 128 is added, which makes signed numbers unsigned.
    Bias,
    /// Four bytes with a bit of each of 32 numbers: byte k gets those of the numbers 4 n + k, so
    /// that a kernel adds them to four numbers at once.
    Spread,
}

impl Change {
    fn apply(self, bytes: &mut [u8]) {
        match (self, bytes) {
            (Self::None, _) => {}
            (Self::Bias, bytes) => bytes.iter_mut().for_each(|byte| *byte ^= 0x80),
            (Self::Spread, bytes) => move_bits(bytes, |bit| (bit % 4 * 8) + bit / 4),
        }
    }

    fn revert(self, bytes: &mut [u8]) {
        match self {
            Self::None | Self::Bias => self.apply(bytes),
            Self::Spread => move_bits(bytes, |bit| (bit % 8 * 4) + bit / 8),
        }
    }
}

/// Moves each bit of four bytes to another place.
fn move_bits(bytes: &mut [u8], place: impl Fn(u32) -> u32) {
    if let Ok(four) = <&mut [u8; 4]>::try_from(bytes) {
        let bits = u32::from_le_bytes(*four);
        *four = (0..32)
            .fold(0, |moved, bit| moved | (bits >> bit & 1) << place(bit))
            .to_le_bytes();
    }
}

impl Layout {
    pub(super) fn for_format(weight_format: WeightFormat) -> Self {
        use Change::{Bias, None, Spread};
        // Byte numbers come first, four of each row a cache line; then the scales of whole blocks.
        // Each entry is the first byte, the width and the count of runs, and their change. Two
        // blocks of one scale each fill a cache line with scales.
        let (span, entries): (usize, &[(usize, usize, usize, Change)]) = match weight_format {
            WeightFormat::F32 => (1, &[(0, 4, 1, None)]),
            WeightFormat::F16 => (2, &[(0, 2, 2, None)]),
            WeightFormat::Q8_0 => (
                64,
                &[
                    (2, 4, 8, Bias),
                    (36, 4, 8, Bias),
                    (0, 2, 1, None),
                    (34, 2, 1, None),
                ],
            ),
            WeightFormat::Q8Of256 => (256, &[(2, 4, 64, Bias), (0, 2, 1, None)]),
            WeightFormat::Q6K => (
                256,
                &[(0, 4, 48, None), (192, 1, 16, None), (208, 2, 1, None)],
            ),
            WeightFormat::Q5_1 => (32, &[(8, 4, 4, None), (4, 4, 1, Spread), (0, 2, 2, None)]),
            WeightFormat::Q5_0 => (
                64,
                &[
                    (6, 4, 4, None),
                    (28, 4, 4, None),
                    (2, 4, 1, Spread),
                    (24, 4, 1, Spread),
                    (0, 2, 1, None),
                    (22, 2, 1, None),
                ],
            ),
            WeightFormat::Q5K => (
                256,
                &[
                    (48, 4, 32, None),
                    (16, 4, 8, None),
                    (0, 2, 2, None),
                    (4, 1, 12, None),
                ],
            ),
            WeightFormat::Q4_1 => (32, &[(4, 4, 4, None), (0, 2, 2, None)]),
            WeightFormat::Q4K => (256, &[(16, 4, 32, None), (0, 2, 2, None), (4, 1, 12, None)]),
            WeightFormat::Q4_0 => (
                64,
                &[
                    (2, 4, 4, None),
                    (20, 4, 4, None),
                    (0, 2, 1, None),
                    (18, 2, 1, None),
                ],
            ),
            WeightFormat::Iq4Nl => return Self::for_format(WeightFormat::Q4_0),
            WeightFormat::Iq4Xs => (
                256,
                &[
                    (8, 4, 32, None),
                    (0, 2, 1, None),
                    (2, 2, 1, None),
                    (4, 1, 4, None),
                ],
            ),
            // Four exponents of a byte fill a cache line.
            WeightFormat::Mxfp4 => (
                128,
                &[
                    (1, 4, 4, None),
                    (18, 4, 4, None),
                    (35, 4, 4, None),
                    (52, 4, 4, None),
                    (0, 1, 1, None),
                    (17, 1, 1, None),
                    (34, 1, 1, None),
                    (51, 1, 1, None),
                ],
            ),
            WeightFormat::Q3K => (
                256,
                &[
                    (32, 4, 16, None),
                    (0, 4, 8, None),
                    (96, 1, 12, None),
                    (108, 2, 1, None),
                ],
            ),
        };
        let (mut runs, mut end) = (Vec::new(), 0);
        for &(from, width, count, change) in entries {
            for index in 0..count {
                runs.push(Run {
                    from: from + index * width,
                    width,
                    to: end,
                    change,
                });
                end += width * LANES;
            }
        }
        let row_bytes = span / weight_format.block() * weight_format.block_bytes();
        Self {
            span,
            row_bytes,
            lines: end.div_ceil(LINE),
            runs,
        }
    }

    /// Writes a row's bytes of a group. The last group of a row may get fewer bytes.
    fn pack(&self, row: usize, bytes: &[u8], group: &mut [CacheLine]) {
        for run in self.runs_within(bytes.len()) {
            let to = run.to + row * run.width;
            // No run crosses a cache line, because its width divides one.
            let to = &mut group[to / LINE].0[to % LINE..][..run.width];
            to.copy_from_slice(&bytes[run.from..run.from + run.width]);
            run.change.apply(to);
        }
    }

    /// Reads a row's bytes of a group.
    fn unpack(&self, row: usize, bytes: &mut [u8], group: &[CacheLine]) {
        for run in self.runs_within(bytes.len()) {
            let from = run.to + row * run.width;
            let to = &mut bytes[run.from..run.from + run.width];
            to.copy_from_slice(&group[from / LINE].0[from % LINE..][..run.width]);
            run.change.revert(to);
        }
    }

    fn runs_within(&self, bytes: usize) -> impl Iterator<Item = &Run> {
        self.runs
            .iter()
            .filter(move |run| run.from + run.width <= bytes)
    }
}

/// Rows of a matrix in tiles; zeros pad the last tile.
#[derive(Debug)]
pub(super) struct PackedTiles {
    weight_format: WeightFormat,
    outputs: usize,
    inputs: usize,
    layout: Layout,
    lines: Vec<CacheLine>,
}

impl PackedTiles {
    /// Packs row-major blocks. `bytes` has exactly the size of the shape.
    pub(super) fn pack(
        weight_format: WeightFormat,
        outputs: usize,
        inputs: usize,
        bytes: &[u8],
    ) -> Self {
        let layout = Layout::for_format(weight_format);
        let mut tiles = Self {
            weight_format,
            outputs,
            inputs,
            layout,
            lines: Vec::new(),
        };
        tiles.lines = vec![CacheLine::ZERO; outputs.div_ceil(LANES) * tiles.tile_lines()];
        let row_bytes = bytes.len() / outputs;
        let layout = &tiles.layout;
        let rows = bytes.par_chunks(row_bytes * LANES);
        tiles
            .lines
            // Threads share tiles and not rows: the rows of a tile lie interleaved in the same
            // cache lines.
            .par_chunks_mut(inputs.div_ceil(layout.span) * layout.lines)
            .zip(rows)
            .for_each(|(tile, rows)| {
                for (row, bytes) in rows.chunks_exact(row_bytes).enumerate() {
                    for (group, bytes) in tile
                        .chunks_exact_mut(layout.lines)
                        .zip(bytes.chunks(layout.row_bytes))
                    {
                        layout.pack(row, bytes, group);
                    }
                }
            });
        tiles
    }

    /// Tiles without a row, with memory for this many.
    pub(super) fn with_room(weight_format: WeightFormat, outputs: usize, inputs: usize) -> Self {
        let mut tiles = Self {
            weight_format,
            outputs: 0,
            inputs,
            layout: Layout::for_format(weight_format),
            lines: Vec::new(),
        };
        let lines = outputs.div_ceil(LANES) * tiles.tile_lines();
        tiles.lines.reserve_exact(lines);
        tiles
    }

    /// Appends rows of the same weight format; returns false where that is not possible.
    pub(super) fn append(&mut self, other: &Self) -> bool {
        let whole = self.outputs.is_multiple_of(LANES);
        let alike =
            whole && self.weight_format == other.weight_format && self.inputs == other.inputs;
        if alike {
            self.lines.reserve_exact(other.lines.len());
            self.lines.extend_from_slice(&other.lines);
            self.outputs += other.outputs;
        }
        alike
    }

    pub(super) fn outputs(&self) -> usize {
        self.outputs
    }

    pub(super) fn inputs(&self) -> usize {
        self.inputs
    }

    pub(super) fn weight_format(&self) -> WeightFormat {
        self.weight_format
    }

    /// Size in memory, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.lines.as_slice())
    }

    /// Cache lines of a tile.
    pub(super) fn tile_lines(&self) -> usize {
        self.inputs.div_ceil(self.layout.span) * self.layout.lines
    }

    pub(super) fn lines(&self) -> &[CacheLine] {
        &self.lines
    }

    /// The original blocks of a row.
    fn row_blocks(&self, index: usize) -> Vec<u8> {
        let blocks = self.inputs.div_ceil(self.weight_format.block());
        let mut bytes = vec![0; blocks * self.weight_format.block_bytes()];
        let tile = self
            .lines
            .chunks_exact(self.tile_lines())
            .nth(index / LANES)
            .expect("the row is one of the matrix");
        for (bytes, group) in bytes
            .chunks_mut(self.layout.row_bytes)
            .zip(tile.chunks_exact(self.layout.lines))
        {
            self.layout.unpack(index % LANES, bytes, group);
        }
        bytes
    }

    pub(super) fn read_row(&self, index: usize, row: &mut [f32]) -> candle_core::Result<()> {
        let mut numbers = self.weight_format.stored().widen(self.row_blocks(index))?;
        // Zeros may fill the last block.
        numbers.truncate(self.inputs);
        row.copy_from_slice(&numbers);
        Ok(())
    }

    /// Writes the original row-major blocks, bit for bit.
    pub(super) fn write_blocks(&self, out: &mut dyn Write) -> io::Result<()> {
        (0..self.outputs).try_for_each(|index| out.write_all(&self.row_blocks(index)))
    }
}
