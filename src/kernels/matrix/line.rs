//! Weights in memory as whole cache lines, the unit that the kernels load.

/// Lanes of a vector, and rows of a weight tile: AVX-512 holds 16 numbers of 32 bits.
pub const LANES: usize = 16;

/// A cache line of weights.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct CacheLine(pub(crate) [u8; 64]);

impl CacheLine {
    pub(crate) const ZERO: Self = Self([0; 64]);

    /// The 16-bit numbers of the first (0) or second (1) half.
    #[inline(always)]
    pub(crate) fn halves(&self, half: usize) -> [u16; LANES] {
        let mut values = [0; LANES];
        for (value, bytes) in values
            .iter_mut()
            .zip(&self.0.as_chunks::<2>().0[half * LANES..])
        {
            *value = u16::from_le_bytes(*bytes);
        }
        values
    }

    /// The line as 32-bit numbers.
    #[inline(always)]
    pub(crate) fn singles(&self) -> [f32; LANES] {
        let mut values = [0.0; LANES];
        for (value, bytes) in values.iter_mut().zip(self.0.as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*bytes);
        }
        values
    }

    /// The bytes of a quarter, 0 to 3.
    #[inline(always)]
    pub(crate) fn quarter(&self, quarter: usize) -> [u8; LANES] {
        self.0.as_chunks::<LANES>().0[quarter]
    }
}
