//! Plain arrays: for CPUs without the other instruction sets, and the reference of their tests.

use super::{Kernel, Simd};
use crate::matrix::line::{CacheLine, LANES};
use half::f16;

#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Portable;

/// The four signed bytes of packed activations.
#[inline]
fn activations(packed: i32) -> [i32; 4] {
    packed
        .to_le_bytes()
        .map(|byte| i32::from(byte.cast_signed()))
}

#[inline]
fn dot(sum: [i32; LANES], weights: [u8; 64], bias: i32, packed: i32) -> [i32; LANES] {
    let activations = activations(packed);
    let mut sum = sum;
    for (sum, weights) in sum.iter_mut().zip(weights.as_chunks::<4>().0) {
        for (weight, activation) in weights.iter().zip(activations) {
            *sum += (i32::from(*weight) - bias) * activation;
        }
    }
    sum
}

impl Simd for Portable {
    type Ints = [i32; LANES];
    type Floats = [f32; LANES];
    type Bytes = [u8; 64];
    type ByteSums = [i32; LANES];
    const REGISTERS: usize = 8;
    const BATCH: usize = 1;
    const LARGEST_SUM: i32 = i32::MAX;

    #[inline]
    fn run<K: Kernel>(self, kernel: K) {
        kernel.run(self);
    }

    #[inline]
    fn prefetch(self, _: *const CacheLine) {}

    #[inline]
    fn bytes(self, line: &CacheLine) -> [u8; 64] {
        line.0
    }

    #[inline]
    fn store_bytes(self, bytes: [u8; 64], line: &mut CacheLine) {
        line.0 = bytes;
    }

    #[inline]
    fn low(self, bytes: [u8; 64]) -> [u8; 64] {
        bytes.map(|byte| byte & 15)
    }

    #[inline]
    fn high(self, bytes: [u8; 64]) -> [u8; 64] {
        bytes.map(|byte| byte >> 4)
    }

    #[inline]
    fn lookup(self, numbers: [u8; 64], table: &[u8; 16]) -> [u8; 64] {
        numbers.map(|number| table[usize::from(number & 15)])
    }

    #[inline]
    fn with_high_bits<const FROM: u32, const MASK: u8>(
        self,
        low: [u8; 64],
        high: [u8; 64],
    ) -> [u8; 64] {
        let mut both = low;
        for (both, high) in both.iter_mut().zip(high) {
            *both |= (u16::from(high) << 4 >> FROM) as u8 & MASK;
        }
        both
    }

    #[inline]
    fn ints(self, value: i32) -> [i32; LANES] {
        [value; LANES]
    }

    #[inline]
    fn begin_dots(self, sum: [i32; LANES]) -> [i32; LANES] {
        sum
    }

    #[inline]
    fn end_dots(self, _: [i32; LANES], products: [i32; LANES]) -> [i32; LANES] {
        products
    }

    #[inline]
    fn dot(self, sum: [i32; LANES], weights: [u8; 64], activations: i32) -> [i32; LANES] {
        dot(sum, weights, 0, activations)
    }

    #[inline]
    fn biased_start(self, _: i32) -> [i32; LANES] {
        [0; LANES]
    }

    #[inline]
    fn dot_biased(self, sum: [i32; LANES], weights: [u8; 64], activations: i32) -> [i32; LANES] {
        dot(sum, weights, 128, activations)
    }

    #[inline]
    fn dot_pairs(self, sum: [i32; LANES], weights: [i32; LANES], activations: i32) -> [i32; LANES] {
        let halves = |pair: i32| [i32::from(pair as i16), pair >> 16];
        let [first, second] = halves(activations);
        let mut sum = sum;
        for (sum, weights) in sum.iter_mut().zip(weights.map(halves)) {
            *sum += weights[0] * first + weights[1] * second;
        }
        sum
    }

    #[inline]
    fn load_ints(self, values: &[i32; LANES]) -> [i32; LANES] {
        *values
    }

    #[inline]
    fn store_ints(self, values: [i32; LANES], out: &mut [i32; LANES]) {
        *out = values;
    }

    #[inline]
    fn to_ints(self, values: [f32; LANES]) -> [i32; LANES] {
        values.map(|value| value.round_ties_even() as i32)
    }

    #[inline]
    fn pair(self, low: [i32; LANES], high: [i32; LANES]) -> [i32; LANES] {
        std::array::from_fn(|lane| low[lane] & 0xffff | high[lane] << 16)
    }

    #[inline]
    fn to_floats(self, values: [i32; LANES]) -> [f32; LANES] {
        values.map(|value| value as f32)
    }

    #[inline]
    fn floats(self, value: f32) -> [f32; LANES] {
        [value; LANES]
    }

    #[inline]
    fn load(self, values: &[f32; LANES]) -> [f32; LANES] {
        *values
    }

    #[inline]
    fn store(self, values: [f32; LANES], out: &mut [f32; LANES]) {
        *out = values;
    }

    #[inline]
    fn load_half(self, values: &[u16; LANES]) -> [f32; LANES] {
        values.map(|bits| f16::from_bits(bits).to_f32())
    }

    #[inline]
    fn load_signed(self, values: &[u8; LANES]) -> [f32; LANES] {
        values.map(|byte| f32::from(byte.cast_signed()))
    }

    #[inline]
    fn load_unsigned(self, values: &[u8; LANES]) -> [i32; LANES] {
        values.map(i32::from)
    }

    #[inline]
    fn mul(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|lane| a[lane] * b[lane])
    }

    // Rounds twice: without the instruction, a fused operation is a slow function call.
    #[inline]
    fn mul_add(self, a: [f32; LANES], b: [f32; LANES], c: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|lane| a[lane] * b[lane] + c[lane])
    }

    #[inline]
    fn mul_sub_from(self, a: [f32; LANES], b: [f32; LANES], c: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|lane| c[lane] - a[lane] * b[lane])
    }

    #[inline]
    fn add(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline]
    fn max(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        std::array::from_fn(|lane| if a[lane] > b[lane] { a[lane] } else { b[lane] })
    }

    #[inline]
    fn round(self, a: [f32; LANES]) -> [f32; LANES] {
        a.map(f32::round_ties_even)
    }

    #[inline]
    fn two_to_the(self, n: [f32; LANES]) -> [f32; LANES] {
        n.map(|n| f32::from_bits(((n as i32 + 127) << 23).cast_unsigned()))
    }
}
