//! AVX2 with FMA and F16C: Intel since Haswell, AMD since Zen. A vector takes two registers.
#![allow(
    unsafe_code,
    reason = "vector instructions; an `Avx2` value exists only where the CPU has them"
)]
#![allow(
    clippy::wildcard_imports,
    reason = "the names of intrinsics say where they are from"
)]

use super::{Kernel, Simd};
use crate::matrix::line::{CacheLine, LANES};
use std::arch::x86_64::*;

/// A value exists only where the CPU has AVX2, FMA and F16C.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Avx2(());

impl Avx2 {
    #[inline]
    pub(in crate::matrix) fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("f16c");
        all.then_some(Self(()))
    }
}

type Ints = [__m256i; 2];
type Floats = [__m256; 2];

/// Applies a function to both registers of vectors.
#[inline(always)]
fn both<A: Copy, B>(a: [A; 2], function: impl Fn(A) -> B) -> [B; 2] {
    [function(a[0]), function(a[1])]
}

/// Applies a function to both registers of three vectors.
#[inline(always)]
fn both_of_three<A: Copy>(
    a: [A; 2],
    b: [A; 2],
    c: [A; 2],
    function: impl Fn(A, A, A) -> A,
) -> [A; 2] {
    [function(a[0], b[0], c[0]), function(a[1], b[1], c[1])]
}

/// Where the numbers of each register begin.
#[inline(always)]
fn halves<T>(values: &[T; LANES]) -> [*const T; 2] {
    [values.as_ptr(), values[LANES / 2..].as_ptr()]
}

// SAFETY of all blocks below: `self` exists, so the CPU has the instructions. Loads and stores take
// references to arrays of twice the operand's size; cache lines have the operand's alignment.
impl Simd for Avx2 {
    type Ints = Ints;
    type Floats = Floats;
    type Bytes = Ints;
    /// 16 lanes of two i16, each the sum of half of the products.
    type ByteSums = Ints;
    const REGISTERS: usize = 8;
    const LARGEST_SUM: i32 = i16::MAX as i32;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        #[target_feature(enable = "avx2,fma,f16c")]
        fn with_instructions<K: Kernel>(simd: Avx2, kernel: K) {
            kernel.run(simd);
        }
        // SAFETY: as above.
        unsafe { with_instructions(self, kernel) }
    }

    operations! {
        prefetch(line: *const CacheLine) = _mm_prefetch::<_MM_HINT_T1>(line.cast());
        bytes(line: &CacheLine) -> Ints =
            both([line.0.as_ptr(), line.0[32..].as_ptr()], |start| _mm256_load_si256(start.cast()));
        low(bytes: Ints) -> Ints = both(bytes, |bytes| _mm256_and_si256(bytes, _mm256_set1_epi8(15)));
        high(bytes: Ints) -> Ints =
            both(bytes, |bytes| _mm256_and_si256(_mm256_srli_epi16::<4>(bytes), _mm256_set1_epi8(15)));
        lookup(numbers: Ints, table: &[u8; 16]) -> Ints = both(numbers, |numbers| {
            let table = _mm256_broadcastsi128_si256(_mm_loadu_si128(table.as_ptr().cast()));
            _mm256_shuffle_epi8(table, numbers)
        });
        ints(value: i32) -> Ints = [_mm256_set1_epi32(value); 2];
        begin_dots(_sum: Ints) -> Ints = [_mm256_setzero_si256(); 2];
        end_dots(sum: Ints, products: Ints) -> Ints = both_of_three(sum, products, products, |sum, products, _| {
            _mm256_add_epi32(sum, _mm256_madd_epi16(products, _mm256_set1_epi16(1)))
        });
        dot(sum: Ints, weights: Ints, activations: i32) -> Ints = both_of_three(sum, weights, weights, |sum, weights, _| {
            _mm256_add_epi16(sum, _mm256_maddubs_epi16(weights, _mm256_set1_epi32(activations)))
        });
        biased_start(_correction: i32) -> Ints = [_mm256_setzero_si256(); 2];
        // Two products of an unsigned byte above 127 and a signed byte can overflow 16 bits, so the
        // activation takes the weight's sign.
        dot_biased(sum: Ints, weights: Ints, activations: i32) -> Ints =
            both_of_three(sum, weights, weights, |sum, weights, _| {
                let signed = _mm256_xor_si256(weights, _mm256_set1_epi8(i8::MIN));
                let turned = _mm256_sign_epi8(_mm256_set1_epi32(activations), signed);
                _mm256_add_epi16(sum, _mm256_maddubs_epi16(_mm256_abs_epi8(signed), turned))
            });
        dot_pairs(sum: Ints, weights: Ints, activations: i32) -> Ints =
            both_of_three(sum, weights, weights, |sum, weights, _| {
                _mm256_add_epi32(sum, _mm256_madd_epi16(weights, _mm256_set1_epi32(activations)))
            });
        load_ints(values: &[i32; LANES]) -> Ints = both(halves(values), |start| _mm256_loadu_si256(start.cast()));
        to_ints(values: Floats) -> Ints = both(values, |values| _mm256_cvtps_epi32(values));
        pair(low: Ints, high: Ints) -> Ints = both_of_three(low, high, high, |low, high, _| {
            _mm256_blend_epi16::<0xaa>(low, _mm256_slli_epi32::<16>(high))
        });
        to_floats(values: Ints) -> Floats = both(values, |values| _mm256_cvtepi32_ps(values));
        floats(value: f32) -> Floats = [_mm256_set1_ps(value); 2];
        load(values: &[f32; LANES]) -> Floats = both(halves(values), |start| _mm256_loadu_ps(start));
        load_half(values: &[u16; LANES]) -> Floats =
            both(halves(values), |start| _mm256_cvtph_ps(_mm_loadu_si128(start.cast())));
        load_signed(values: &[u8; LANES]) -> Floats =
            both(halves(values), |start| _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64(start.cast()))));
        load_unsigned(values: &[u8; LANES]) -> Ints =
            both(halves(values), |start| _mm256_cvtepu8_epi32(_mm_loadl_epi64(start.cast())));
        mul(a: Floats, b: Floats) -> Floats = both_of_three(a, b, b, |a, b, _| _mm256_mul_ps(a, b));
        mul_add(a: Floats, b: Floats, c: Floats) -> Floats =
            both_of_three(a, b, c, |a, b, c| _mm256_fmadd_ps(a, b, c));
        mul_sub_from(a: Floats, b: Floats, c: Floats) -> Floats =
            both_of_three(a, b, c, |a, b, c| _mm256_fnmadd_ps(a, b, c));
        add(a: Floats, b: Floats) -> Floats = both_of_three(a, b, b, |a, b, _| _mm256_add_ps(a, b));
        max(a: Floats, b: Floats) -> Floats = both_of_three(a, b, b, |a, b, _| _mm256_max_ps(a, b));
        round(a: Floats) -> Floats =
            both(a, |a| _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a));
        two_to_the(n: Floats) -> Floats = both(n, |n| {
            let biased = _mm256_add_epi32(_mm256_cvtps_epi32(n), _mm256_set1_epi32(127));
            _mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased))
        });
    }

    #[inline(always)]
    fn store_bytes(self, bytes: Ints, line: &mut CacheLine) {
        let start = line.0.as_mut_ptr();
        // SAFETY: as above.
        unsafe {
            _mm256_store_si256(start.cast(), bytes[0]);
            _mm256_store_si256(start.add(32).cast(), bytes[1]);
        }
    }

    #[inline(always)]
    fn store(self, values: Floats, out: &mut [f32; LANES]) {
        // SAFETY: as above.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), values[0]);
            _mm256_storeu_ps(out.as_mut_ptr().add(8), values[1]);
        }
    }

    #[inline(always)]
    fn store_ints(self, values: Ints, out: &mut [i32; LANES]) {
        let start = out.as_mut_ptr();
        // SAFETY: as above.
        unsafe {
            _mm256_storeu_si256(start.cast(), values[0]);
            _mm256_storeu_si256(start.add(8).cast(), values[1]);
        }
    }

    #[inline(always)]
    fn with_high_bits<const FROM: u32, const MASK: u8>(self, low: Ints, high: Ints) -> Ints {
        // SAFETY: as above.
        both_of_three(low, high, high, |low, high, _| unsafe {
            let shifted = match FROM {
                0 => _mm256_slli_epi16::<4>(high),
                1 => _mm256_slli_epi16::<3>(high),
                2 => _mm256_slli_epi16::<2>(high),
                3 => _mm256_slli_epi16::<1>(high),
                4 => high,
                5 => _mm256_srli_epi16::<1>(high),
                6 => _mm256_srli_epi16::<2>(high),
                7 => _mm256_srli_epi16::<3>(high),
                _ => _mm256_srli_epi16::<4>(high),
            };
            _mm256_or_si256(
                low,
                _mm256_and_si256(shifted, _mm256_set1_epi8(MASK.cast_signed())),
            )
        })
    }
}
