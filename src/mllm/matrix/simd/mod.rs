//! Vectors of sixteen outputs, in each instruction set that the kernels are compiled for.
//!
//! A kernel is written once, over [`Simd`], and [`dispatch`] runs it with the best instructions that this machine has.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

use super::line::CacheLine;

/// Outputs that a vector holds: the rows of a tile.
pub(crate) const LANES: usize = 16;

/// Operations on sixteen lanes. A value of such a type exists only where the machine has the instructions.
///
/// Products of bytes: each lane holds four unsigned bytes of its output's weights; the activations are four signed bytes in
/// an `i32`, the same for all lanes.
pub(crate) trait Simd: Copy + Send + Sync {
    /// 16 lanes of i32, or 32 of i16.
    type Ints: Copy;
    /// 16 lanes of f32.
    type Floats: Copy;
    /// 16 lanes of four bytes.
    type Bytes: Copy;

    /// Vectors of f32 that the registers hold: how large a tile of sums may be.
    const REGISTERS: usize;

    /// Runs a kernel where the compiler may use the instructions.
    fn run<K: Kernel>(self, kernel: K);

    /// Asks for a line that is soon wanted.
    fn prefetch(self, line: &CacheLine);
    /// Loads a line.
    fn bytes(self, line: &CacheLine) -> Self::Bytes;
    /// Stores a line.
    fn store_bytes(self, bytes: Self::Bytes, line: &mut CacheLine);
    /// The low four bits of each byte.
    fn low(self, bytes: Self::Bytes) -> Self::Bytes;
    /// The high four bits of each byte.
    fn high(self, bytes: Self::Bytes) -> Self::Bytes;
    /// Adds to numbers of four bits the two bits that stand at bit 2 · RUN of `high` as bits 4 and 5.
    fn with_two_bits<const RUN: u32>(self, low: Self::Bytes, high: Self::Bytes) -> Self::Bytes;

    /// The same number in every lane.
    fn ints(self, value: i32) -> Self::Ints;
    /// sum + Σ weight · activation over the four bytes of each lane; weights are below 128.
    fn dot(self, sum: Self::Ints, weights: Self::Bytes, activations: i32) -> Self::Ints;
    /// The start of a sum by [`Self::dot_biased`], where `sum` is the sum of all its activations.
    fn biased_start(self, sum: i32) -> Self::Ints;
    /// sum + Σ (weight − 128) · activation over the four bytes of each lane.
    fn dot_biased(self, sum: Self::Ints, weights: Self::Bytes, activations: i32) -> Self::Ints;
    /// sum + Σ weight · activation over the two i16 of each lane; the activations are two i16 in an `i32`.
    fn dot_pairs(self, sum: Self::Ints, weights: Self::Ints, activations: i32) -> Self::Ints;
    /// Loads 16 i32.
    fn load_ints(self, values: &[i32; LANES]) -> Self::Ints;
    /// To floating point.
    fn to_floats(self, values: Self::Ints) -> Self::Floats;

    /// The same number in every lane.
    fn floats(self, value: f32) -> Self::Floats;
    /// Loads 16 f32.
    fn load(self, values: &[f32; LANES]) -> Self::Floats;
    /// Stores 16 f32.
    fn store(self, values: Self::Floats, out: &mut [f32; LANES]);
    /// Loads 16 f16.
    fn load_half(self, values: &[u16; LANES]) -> Self::Floats;
    /// Loads 16 bytes as signed numbers.
    fn load_signed(self, values: &[u8; LANES]) -> Self::Floats;
    /// Loads 16 bytes as unsigned numbers.
    fn load_unsigned(self, values: &[u8; LANES]) -> Self::Ints;
    /// a · b.
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// a · b + c, rounded once where the instructions do so.
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// c − a · b, rounded once where the instructions do so.
    fn mul_sub_from(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats;
    /// a + b.
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// The greater of both; b where one is not a number.
    fn max(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// To the nearest whole number.
    fn round(self, a: Self::Floats) -> Self::Floats;
    /// 2ⁿ of whole numbers from -126 to 127.
    fn two_to_the(self, n: Self::Floats) -> Self::Floats;
    /// The sum of the lanes.
    #[inline(always)]
    fn sum(self, a: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(a, &mut lanes);
        fold(lanes, |a, b| a + b)
    }
    /// The max_lane lane.
    #[inline(always)]
    fn max_lane(self, a: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(a, &mut lanes);
        fold(lanes, |a, b| if a > b { a } else { b })
    }

    /// eˣ for x ≤ 0, to two units in the last place; below -87 it stays what it is there.
    ///
    /// eˣ = 2ⁿ eʳ with n = round(x / ln 2), the latter by its Taylor series; ln 2 in two parts, so that products of the
    /// first with n are exact (W. Cody, W. Waite, "Software Manual for the Elementary Functions", 1980).
    #[inline(always)]
    fn exp(self, x: Self::Floats) -> Self::Floats {
        const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
        const SERIES: [f32; 7] = [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];
        // In this order, what is not a number stays so.
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

/// Folds halves of lanes onto each other.
#[inline(always)]
fn fold(mut lanes: [f32; LANES], operation: impl Fn(f32, f32) -> f32) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        let (low, high) = lanes.split_at_mut(half);
        low.iter_mut().zip(high).for_each(|(low, high)| *low = operation(*low, *high));
        half /= 2;
    }
    lanes[0]
}

/// Work that is compiled for every instruction set.
pub(crate) trait Kernel {
    /// Does it with these instructions; to be inlined into [`Simd::run`].
    fn run<S: Simd>(self, simd: S);
}

/// Instruction sets that kernels are compiled for, the best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Instructions {
    /// AVX-512 with VNNI.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// AVX2 with FMA and F16C.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// None in particular.
    Portable,
}

impl Instructions {
    /// Those that this machine has, the best first.
    pub(crate) fn available() -> impl Iterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let vectors = [avx512::Avx512::detect().map(|_| Self::Avx512), avx2::Avx2::detect().map(|_| Self::Avx2)];
        #[cfg(not(target_arch = "x86_64"))]
        let vectors = [None];
        vectors.into_iter().flatten().chain([Self::Portable])
    }

    /// The best that this machine has.
    pub(crate) fn best() -> Self {
        Self::available().next().unwrap_or(Self::Portable)
    }

    /// Runs a kernel with these instructions, or plainly if the machine lacks them.
    pub(crate) fn run<K: Kernel>(self, kernel: K) {
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
        portable::Portable.run(kernel);
    }
}
