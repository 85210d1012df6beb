//! Vectors of sixteen lanes in each instruction set that the kernels are compiled for.
//!
//! A kernel is generic over [`Simd`]. [`Instructions::run`] picks the instruction set at run time.
//! x86-64 and Arm have vector code of their own; other processors run [`portable`], which the
//! compiler vectorizes as far as it can.

/// Writes methods of [`Simd`] that are one expression of intrinsics. The CPU has them where `self`
/// exists.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
macro_rules! operations {
    ($($name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)? = $value:expr;)*) => {$(
        #[inline(always)]
        fn $name(self, $($argument: $type),*) $(-> $result)? {
            // SAFETY: see the head of the implementation.
            unsafe { $value }
        }
    )*};
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;

use super::format::MAX_BATCH;
use super::line::{CacheLine, LANES};

/// Operations on sixteen lanes. A value of an implementing type exists only where the CPU has the
/// instructions.
///
/// Byte products: each lane holds four unsigned bytes of its output's weights. The activations are
/// four signed bytes in an `i32`, the same for all lanes.
pub trait Simd: Copy + Send + Sync {
    /// 16 lanes of i32, or 32 of i16.
    type Ints: Copy;
    /// 16 lanes of f32.
    type Floats: Copy;
    /// 16 lanes of four bytes.
    type Bytes: Copy;
    /// Sums of byte products that continue an [`Self::Ints`]: of any number where a lane is an i32,
    /// else of a few ([`Self::LARGEST_SUM`]).
    type ByteSums: Copy;

    /// f32 vectors that fit in the registers; limits how many sums a kernel keeps at once.
    const REGISTERS: usize;
    /// Rows of activations in a batch. Each number of rows up to it has code of its own.
    const BATCH: usize = MAX_BATCH;
    /// Largest magnitude of a sum of byte products in [`Self::ByteSums`].
    const LARGEST_SUM: i32;

    /// Runs a kernel in a function that enables the instructions.
    fn run<K: Kernel>(self, kernel: K);

    /// Starts to load a line into the second-level cache. Past it, an Intel Xeon reads half as
    /// fast; into the first level too, Zen 4 reads a quarter slower in `q4_k`. An address that does
    /// not exist is ignored.
    fn prefetch(self, line: *const CacheLine);
    /// Loads a line.
    fn bytes(self, line: &CacheLine) -> Self::Bytes;
    /// Writes a line.
    fn store_bytes(self, bytes: Self::Bytes, line: &mut CacheLine);
    /// The low four bits of each byte.
    fn low(self, bytes: Self::Bytes) -> Self::Bytes;
    /// The high four bits of each byte.
    fn high(self, bytes: Self::Bytes) -> Self::Bytes;
    /// The bytes of a table that four-bit numbers choose.
    fn lookup(self, numbers: Self::Bytes, table: &[u8; 16]) -> Self::Bytes;
    /// Adds bits to numbers: those of `high`, moved so that bit FROM comes to bit 4, as far as MASK
    /// has them. FROM is at most 8; MASK names only bits that come from the same byte.
    fn with_high_bits<const FROM: u32, const MASK: u8>(
        self,
        low: Self::Bytes,
        high: Self::Bytes,
    ) -> Self::Bytes;

    /// The same number in every lane.
    fn ints(self, value: i32) -> Self::Ints;
    /// Sums of byte products that continue `sum`.
    fn begin_dots(self, sum: Self::Ints) -> Self::ByteSums;
    /// `sum` with the byte products that were added since [`Self::begin_dots`] took it.
    fn end_dots(self, sum: Self::Ints, products: Self::ByteSums) -> Self::Ints;
    /// sum + Σ weight · activation over the four bytes of each lane, for weights below 128.
    fn dot(self, sum: Self::ByteSums, weights: Self::Bytes, activations: i32) -> Self::ByteSums;
    /// The value that a sum by [`Self::dot_biased`] starts from; `correction` is −128 times the
    /// sum of all its activations.
    fn biased_start(self, correction: i32) -> Self::Ints;
    /// sum + Σ (weight − 128) · activation over the four bytes of each lane.
    fn dot_biased(
        self,
        sum: Self::ByteSums,
        weights: Self::Bytes,
        activations: i32,
    ) -> Self::ByteSums;
    /// sum + Σ weight · activation over the two i16 of each lane; the activations are two i16 in an
    /// `i32`.
    fn dot_pairs(self, sum: Self::Ints, weights: Self::Ints, activations: i32) -> Self::Ints;
    /// Loads 16 integers.
    fn load_ints(self, values: &[i32; LANES]) -> Self::Ints;
    /// Writes 16 integers.
    fn store_ints(self, values: Self::Ints, out: &mut [i32; LANES]);
    /// Writes the low bytes of 16 integers.
    #[inline(always)]
    fn store_low_bytes(self, values: Self::Ints, out: &mut [i8; LANES]) {
        let mut integers = [0; LANES];
        self.store_ints(values, &mut integers);
        for (byte, integer) in out.iter_mut().zip(integers) {
            *byte = integer as i8;
        }
    }
    /// The sum of 16 integers.
    #[inline(always)]
    fn sum_ints(self, values: Self::Ints) -> i32 {
        let mut integers = [0; LANES];
        self.store_ints(values, &mut integers);
        integers.into_iter().sum()
    }
    /// The integers as floats.
    fn to_floats(self, values: Self::Ints) -> Self::Floats;
    /// The nearest integers, ties to even, of floats that have one in i32.
    fn to_ints(self, values: Self::Floats) -> Self::Ints;
    /// Lanes of two i16: the low halves of `low` and `high`.
    fn pair(self, low: Self::Ints, high: Self::Ints) -> Self::Ints;

    /// The same number in every lane.
    fn floats(self, value: f32) -> Self::Floats;
    /// Loads 16 floats.
    fn load(self, values: &[f32; LANES]) -> Self::Floats;
    /// Writes 16 floats.
    fn store(self, values: Self::Floats, out: &mut [f32; LANES]);
    /// Loads the bits of 16 f16.
    fn load_half(self, values: &[u16; LANES]) -> Self::Floats;
    /// Loads 16 bytes as signed numbers.
    fn load_signed(self, values: &[u8; LANES]) -> Self::Floats;
    /// Loads 16 bytes as unsigned numbers.
    fn load_unsigned(self, values: &[u8; LANES]) -> Self::Ints;
    /// a · b.
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// a · b + c, rounded once where the CPU has fused operations.
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// c − a · b, rounded once where the CPU has fused operations.
    fn mul_sub_from(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// a + b.
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// The larger of both; b where one is NaN.
    fn max(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// To the nearest integer, ties to even.
    fn round(self, a: Self::Floats) -> Self::Floats;
    /// 2ⁿ of integers from -126 to 127.
    fn two_to_the(self, n: Self::Floats) -> Self::Floats;
    /// The sum of the lanes.
    #[inline(always)]
    fn sum(self, a: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(a, &mut lanes);
        fold(lanes, |a, b| a + b)
    }
    /// The largest lane.
    #[inline(always)]
    fn max_lane(self, a: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(a, &mut lanes);
        fold(lanes, |a, b| if a > b { a } else { b })
    }

    /// eˣ for x ≤ 0, to two units in the last place; e⁻⁸⁷ for every x below -87.
    ///
    /// eˣ = 2ⁿ eʳ with n = round(x / ln 2) and eʳ by its Taylor series. ln 2 has two parts, so that
    /// products of the first part with n are exact (W. Cody, W. Waite, "Software Manual for the
    /// Elementary Functions", 1980).
    #[inline(always)]
    fn exp(self, x: Self::Floats) -> Self::Floats {
        /// ln 2 in two parts, see above.
        const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
        /// 1/k! for k from 6 down to 0; the sum starts at 1/7!.
        const SERIES: [f32; 7] = [
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            0.5,
            1.0,
            1.0,
        ];
        // In this order, NaN stays NaN.
        let x = self.max(self.floats(-87.0), x);
        let n = self.round(self.mul(x, self.floats(std::f32::consts::LOG2_E)));
        let r = self.mul_sub_from(n, self.floats(LN_2[0]), x);
        let r = self.mul_sub_from(n, self.floats(LN_2[1]), r);
        let mut series = self.floats(1.0 / 5040.0);
        for coefficient in SERIES {
            series = self.mul_add(series, r, self.floats(coefficient));
        }
        self.mul(series, self.two_to_the(n))
    }
}

/// Reduces the lanes by halves, so that the order of operations is fixed.
#[inline(always)]
fn fold(mut lanes: [f32; LANES], operation: impl Fn(f32, f32) -> f32) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        let (low, high) = lanes.split_at_mut(half);
        low.iter_mut()
            .zip(high)
            .for_each(|(low, high)| *low = operation(*low, *high));
        half /= 2;
    }
    lanes[0]
}

/// Work that is compiled for every instruction set.
pub trait Kernel {
    /// Must be inlined into [`Simd::run`].
    fn run<S: Simd>(self, simd: S);
}

/// Instruction sets that kernels are compiled for, fastest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Instructions {
    /// AVX-512 with VNNI.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// AVX2 with FMA and F16C.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// NEON with dot products.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// Without vector instructions of any CPU.
    Portable,
}

impl Instructions {
    /// Those that this CPU has, fastest first.
    pub(crate) fn available() -> impl Iterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let vectors = [
            avx512::Avx512::detect().map(|_| Self::Avx512),
            avx2::Avx2::detect().map(|_| Self::Avx2),
        ];
        #[cfg(target_arch = "aarch64")]
        let vectors = [neon::Neon::detect().map(|_| Self::Neon)];
        #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
        let vectors = [None];
        vectors.into_iter().flatten().chain([Self::Portable])
    }

    /// The fastest that this CPU has.
    #[inline]
    pub fn best() -> Self {
        Self::available().next().unwrap_or(Self::Portable)
    }

    /// Rows of activations in a batch.
    pub(super) fn batch(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => avx512::Avx512::BATCH,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => avx2::Avx2::BATCH,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::Neon::BATCH,
            Self::Portable => portable::Portable::BATCH,
        }
    }

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "AVX-512 VNNI",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "AVX2",
            #[cfg(target_arch = "aarch64")]
            Self::Neon => "NEON",
            Self::Portable => "plain",
        }
    }

    /// Runs a kernel with these instructions, or with the portable ones if the CPU lacks them.
    pub fn run<K: Kernel>(self, kernel: K) {
        #[cfg(target_arch = "x86_64")]
        match self {
            Self::Avx512 => {
                if let Some(simd) = avx512::Avx512::detect() {
                    return simd.run(kernel);
                }
            }
            Self::Avx2 => {
                if let Some(simd) = avx2::Avx2::detect() {
                    return simd.run(kernel);
                }
            }
            Self::Portable => {}
        }
        #[cfg(target_arch = "aarch64")]
        if self == Self::Neon
            && let Some(simd) = neon::Neon::detect()
        {
            return simd.run(kernel);
        }
        portable::Portable.run(kernel);
    }
}
