//! Memory in cache lines, the unit in which the kernels read weights.

use super::simd::LANES;

/// A cache line of weights.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct CacheLine(pub(crate) [u8; 64]);

impl CacheLine {
    /// A line of zeros.
    pub(crate) const ZERO: Self = Self([0; 64]);

    /// The 16-bit numbers of a half of the line.
    #[inline(always)]
    pub(crate) fn halves(&self, half: usize) -> [u16; LANES] {
        let mut values = [0; LANES];
        for (value, bytes) in values.iter_mut().zip(&self.0.as_chunks::<2>().0[half * LANES..]) {
            *value = u16::from_le_bytes(*bytes);
        }
        values
    }

    /// The bytes of a quarter of the line.
    #[inline(always)]
    pub(crate) fn quarter(&self, quarter: usize) -> [u8; LANES] {
        self.0.as_chunks::<LANES>().0[quarter]
    }
}
