//! AVX2 with FMA and F16C: Intel since Haswell, AMD since Zen. A vector takes two registers.
#![allow(unsafe_code, reason = "vector instructions; an `Avx2` value exists only where the CPU has them")]

use std::arch::x86_64::{
    __m256, __m256i, _MM_FROUND_NO_EXC, _MM_FROUND_TO_NEAREST_INT, _MM_HINT_T0, _mm_loadl_epi64, _mm_loadu_si128,
    _mm_prefetch, _mm256_abs_epi8, _mm256_add_epi32, _mm256_add_ps, _mm256_and_si256, _mm256_castsi256_ps,
    _mm256_cvtepi8_epi32, _mm256_cvtepi32_ps, _mm256_cvtepu8_epi32, _mm256_cvtph_ps, _mm256_cvtps_epi32,
    _mm256_fmadd_ps, _mm256_fnmadd_ps, _mm256_load_si256, _mm256_loadu_ps, _mm256_loadu_si256, _mm256_madd_epi16,
    _mm256_maddubs_epi16, _mm256_max_ps, _mm256_mul_ps, _mm256_or_si256, _mm256_round_ps, _mm256_set1_epi8,
    _mm256_set1_epi16, _mm256_set1_epi32, _mm256_set1_ps, _mm256_setzero_si256, _mm256_sign_epi8, _mm256_slli_epi16,
    _mm256_slli_epi32, _mm256_srli_epi16, _mm256_store_si256, _mm256_storeu_ps, _mm256_xor_si256,
};

use super::{Kernel, Simd};
use crate::mllm::matrix::line::{CacheLine, LANES};

/// A value exists only where the CPU has AVX2, FMA and F16C.
#[derive(Debug, Clone, Copy)]
pub(in crate::mllm::matrix) struct Avx2(());

impl Avx2 {
    pub(in crate::mllm::matrix) fn detect() -> Option<Self> {
        let all =
            is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("f16c");
        all.then_some(Self(()))
    }
}

/// Applies a function to both registers of vectors.
#[inline(always)]
fn both<A: Copy, B>(a: [A; 2], function: impl Fn(A) -> B) -> [B; 2] {
    [function(a[0]), function(a[1])]
}

/// Applies a function to both registers of three vectors.
#[inline(always)]
fn both_of_three<A: Copy>(a: [A; 2], b: [A; 2], c: [A; 2], function: impl Fn(A, A, A) -> A) -> [A; 2] {
    [function(a[0], b[0], c[0]), function(a[1], b[1], c[1])]
}

// SAFETY of all blocks below: `self` exists, so the CPU has the instructions. Loads and stores take references to arrays
// of twice the operand's size; cache lines have the operand's alignment.
impl Simd for Avx2 {
    type Ints = [__m256i; 2];
    type Floats = [__m256; 2];
    type Bytes = [__m256i; 2];
    const REGISTERS: usize = 8;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        #[target_feature(enable = "avx2,fma,f16c")]
        fn with_instructions<K: Kernel>(simd: Avx2, kernel: K) {
            kernel.run(simd);
        }
        // SAFETY: as above.
        unsafe { with_instructions(self, kernel) }
    }

    #[inline(always)]
    fn prefetch(self, line: &CacheLine) {
        // SAFETY: as above.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.0.as_ptr().cast()) }
    }

    #[inline(always)]
    fn bytes(self, line: &CacheLine) -> Self::Bytes {
        let start = line.0.as_ptr();
        // SAFETY: as above.
        unsafe { [_mm256_load_si256(start.cast()), _mm256_load_si256(start.add(32).cast())] }
    }

    #[inline(always)]
    fn store_bytes(self, bytes: Self::Bytes, line: &mut CacheLine) {
        let start = line.0.as_mut_ptr();
        // SAFETY: as above.
        unsafe {
            _mm256_store_si256(start.cast(), bytes[0]);
            _mm256_store_si256(start.add(32).cast(), bytes[1]);
        }
    }

    #[inline(always)]
    fn low(self, bytes: Self::Bytes) -> Self::Bytes {
        // SAFETY: as above.
        both(bytes, |bytes| unsafe { _mm256_and_si256(bytes, _mm256_set1_epi8(15)) })
    }

    #[inline(always)]
    fn high(self, bytes: Self::Bytes) -> Self::Bytes {
        // SAFETY: as above.
        both(bytes, |bytes| unsafe { _mm256_and_si256(_mm256_srli_epi16::<4>(bytes), _mm256_set1_epi8(15)) })
    }

    #[inline(always)]
    fn with_two_bits<const RUN: u32>(self, low: Self::Bytes, high: Self::Bytes) -> Self::Bytes {
        // SAFETY: as above.
        both_of_three(low, high, high, |low, high, _| unsafe {
            let shifted = match RUN {
                0 => _mm256_slli_epi16::<4>(high),
                1 => _mm256_slli_epi16::<2>(high),
                2 => high,
                _ => _mm256_srli_epi16::<2>(high),
            };
            _mm256_or_si256(low, _mm256_and_si256(shifted, _mm256_set1_epi8(0x30)))
        })
    }

    #[inline(always)]
    fn ints(self, value: i32) -> Self::Ints {
        // SAFETY: as above.
        unsafe { [_mm256_set1_epi32(value); 2] }
    }

    #[inline(always)]
    fn dot(self, sum: Self::Ints, weights: Self::Bytes, activations: i32) -> Self::Ints {
        // Two products of a weight below 128 and a signed byte fit in 16 bits.
        // SAFETY: as above.
        both_of_three(sum, weights, weights, |sum, weights, _| unsafe {
            let pairs = _mm256_maddubs_epi16(weights, _mm256_set1_epi32(activations));
            _mm256_add_epi32(sum, _mm256_madd_epi16(pairs, _mm256_set1_epi16(1)))
        })
    }

    #[inline(always)]
    fn biased_start(self, _: i32) -> Self::Ints {
        // SAFETY: as above.
        unsafe { [_mm256_setzero_si256(); 2] }
    }

    // Two products of an unsigned byte above 127 and a signed byte can overflow 16 bits, so the activation takes the
    // weight's sign.
    #[inline(always)]
    fn dot_biased(self, sum: Self::Ints, weights: Self::Bytes, activations: i32) -> Self::Ints {
        // SAFETY: as above.
        both_of_three(sum, weights, weights, |sum, weights, _| unsafe {
            let signed = _mm256_xor_si256(weights, _mm256_set1_epi8(i8::MIN));
            let turned = _mm256_sign_epi8(_mm256_set1_epi32(activations), signed);
            let pairs = _mm256_maddubs_epi16(_mm256_abs_epi8(signed), turned);
            _mm256_add_epi32(sum, _mm256_madd_epi16(pairs, _mm256_set1_epi16(1)))
        })
    }

    #[inline(always)]
    fn dot_pairs(self, sum: Self::Ints, weights: Self::Ints, activations: i32) -> Self::Ints {
        // SAFETY: as above.
        both_of_three(sum, weights, weights, |sum, weights, _| unsafe {
            _mm256_add_epi32(sum, _mm256_madd_epi16(weights, _mm256_set1_epi32(activations)))
        })
    }

    #[inline(always)]
    fn load_ints(self, values: &[i32; LANES]) -> Self::Ints {
        let start = values.as_ptr();
        // SAFETY: as above.
        unsafe { [_mm256_loadu_si256(start.cast()), _mm256_loadu_si256(start.add(8).cast())] }
    }

    #[inline(always)]
    fn to_floats(self, values: Self::Ints) -> Self::Floats {
        // SAFETY: as above.
        both(values, |values| unsafe { _mm256_cvtepi32_ps(values) })
    }

    #[inline(always)]
    fn floats(self, value: f32) -> Self::Floats {
        // SAFETY: as above.
        unsafe { [_mm256_set1_ps(value); 2] }
    }

    #[inline(always)]
    fn load(self, values: &[f32; LANES]) -> Self::Floats {
        // SAFETY: as above.
        unsafe { [_mm256_loadu_ps(values.as_ptr()), _mm256_loadu_ps(values.as_ptr().add(8))] }
    }

    #[inline(always)]
    fn store(self, values: Self::Floats, out: &mut [f32; LANES]) {
        // SAFETY: as above.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), values[0]);
            _mm256_storeu_ps(out.as_mut_ptr().add(8), values[1]);
        }
    }

    #[inline(always)]
    fn load_half(self, values: &[u16; LANES]) -> Self::Floats {
        let start = values.as_ptr();
        // SAFETY: as above.
        both([start, start.wrapping_add(8)], |start| unsafe { _mm256_cvtph_ps(_mm_loadu_si128(start.cast())) })
    }

    #[inline(always)]
    fn load_signed(self, values: &[u8; LANES]) -> Self::Floats {
        let start = values.as_ptr();
        // SAFETY: as above.
        both([start, start.wrapping_add(8)], |start| unsafe {
            _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64(start.cast())))
        })
    }

    #[inline(always)]
    fn load_unsigned(self, values: &[u8; LANES]) -> Self::Ints {
        let start = values.as_ptr();
        // SAFETY: as above.
        both([start, start.wrapping_add(8)], |start| unsafe { _mm256_cvtepu8_epi32(_mm_loadl_epi64(start.cast())) })
    }

    #[inline(always)]
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        both_of_three(a, b, b, |a, b, _| unsafe { _mm256_mul_ps(a, b) })
    }

    #[inline(always)]
    fn mul_add(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        both_of_three(a, b, c, |a, b, c| unsafe { _mm256_fmadd_ps(a, b, c) })
    }

    #[inline(always)]
    fn mul_sub_from(self, a: Self::Floats, b: Self::Floats, c: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        both_of_three(a, b, c, |a, b, c| unsafe { _mm256_fnmadd_ps(a, b, c) })
    }

    #[inline(always)]
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn max(self, a: Self::Floats, b: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        unsafe { [_mm256_max_ps(a[0], b[0]), _mm256_max_ps(a[1], b[1])] }
    }

    #[inline(always)]
    fn round(self, a: Self::Floats) -> Self::Floats {
        const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
        // SAFETY: as above.
        unsafe { [_mm256_round_ps::<NEAREST>(a[0]), _mm256_round_ps::<NEAREST>(a[1])] }
    }

    #[inline(always)]
    fn two_to_the(self, n: Self::Floats) -> Self::Floats {
        // SAFETY: as above.
        unsafe {
            let bias = _mm256_set1_epi32(127);
            let low = _mm256_slli_epi32::<23>(_mm256_add_epi32(_mm256_cvtps_epi32(n[0]), bias));
            let high = _mm256_slli_epi32::<23>(_mm256_add_epi32(_mm256_cvtps_epi32(n[1]), bias));
            [_mm256_castsi256_ps(low), _mm256_castsi256_ps(high)]
        }
    }
}
