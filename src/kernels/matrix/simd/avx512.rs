//! AVX-512 with VNNI: Intel since Ice Lake, AMD since Zen 4.
#![allow(
    unsafe_code,
    reason = "vector instructions; an `Avx512` value exists only where the CPU has them"
)]
#![allow(
    clippy::wildcard_imports,
    reason = "the names of intrinsics say where they are from"
)]

use super::{Kernel, Simd};
use crate::matrix::line::{CacheLine, LANES};
use std::arch::x86_64::*;

/// A value exists only where the CPU has AVX-512 F, BW and VNNI.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Avx512(());

impl Avx512 {
    #[inline]
    pub(in crate::matrix) fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512vnni");
        all.then_some(Self(()))
    }
}

// SAFETY of all blocks below: `self` exists, so the CPU has the instructions. Loads and stores take
// references to arrays of the operand's size; cache lines have the operand's alignment.
impl Simd for Avx512 {
    type Ints = __m512i;
    type Floats = __m512;
    type Bytes = __m512i;
    type ByteSums = __m512i;
    const REGISTERS: usize = 32;
    const LARGEST_SUM: i32 = i32::MAX;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
        fn with_instructions<K: Kernel>(simd: Avx512, kernel: K) {
            kernel.run(simd);
        }
        // SAFETY: as above.
        unsafe { with_instructions(self, kernel) }
    }

    operations! {
        prefetch(line: *const CacheLine) = _mm_prefetch::<_MM_HINT_T0>(line.cast());
        bytes(line: &CacheLine) -> __m512i = _mm512_load_si512(line.0.as_ptr().cast());
        store_bytes(bytes: __m512i, line: &mut CacheLine) = _mm512_store_si512(line.0.as_mut_ptr().cast(), bytes);
        low(bytes: __m512i) -> __m512i = _mm512_and_si512(bytes, _mm512_set1_epi8(15));
        high(bytes: __m512i) -> __m512i = _mm512_and_si512(_mm512_srli_epi16::<4>(bytes), _mm512_set1_epi8(15));
        lookup(numbers: __m512i, table: &[u8; 16]) -> __m512i =
            _mm512_shuffle_epi8(_mm512_broadcast_i32x4(_mm_loadu_si128(table.as_ptr().cast())), numbers);
        ints(value: i32) -> __m512i = _mm512_set1_epi32(value);
        dot(sum: __m512i, weights: __m512i, activations: i32) -> __m512i =
            _mm512_dpbusd_epi32(sum, weights, _mm512_set1_epi32(activations));
        dot_pairs(sum: __m512i, weights: __m512i, activations: i32) -> __m512i =
            _mm512_dpwssd_epi32(sum, weights, _mm512_set1_epi32(activations));
        load_ints(values: &[i32; LANES]) -> __m512i = _mm512_loadu_si512(values.as_ptr().cast());
        store_ints(values: __m512i, out: &mut [i32; LANES]) = _mm512_storeu_si512(out.as_mut_ptr().cast(), values);
        store_low_bytes(values: __m512i, out: &mut [i8; LANES]) =
            _mm_storeu_si128(out.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(values));
        sum_ints(values: __m512i) -> i32 = _mm512_reduce_add_epi32(values);
        to_ints(values: __m512) -> __m512i = _mm512_cvtps_epi32(values);
        pair(low: __m512i, high: __m512i) -> __m512i = _mm512_mask_blend_epi16(0xaaaa_aaaa, low, _mm512_slli_epi32::<16>(high));
        to_floats(values: __m512i) -> __m512 = _mm512_cvtepi32_ps(values);
        floats(value: f32) -> __m512 = _mm512_set1_ps(value);
        load(values: &[f32; LANES]) -> __m512 = _mm512_loadu_ps(values.as_ptr());
        store(values: __m512, out: &mut [f32; LANES]) = _mm512_storeu_ps(out.as_mut_ptr(), values);
        load_half(values: &[u16; LANES]) -> __m512 = _mm512_cvtph_ps(_mm256_loadu_si256(values.as_ptr().cast()));
        load_signed(values: &[u8; LANES]) -> __m512 =
            _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_loadu_si128(values.as_ptr().cast())));
        load_unsigned(values: &[u8; LANES]) -> __m512i =
            _mm512_cvtepu8_epi32(_mm_loadu_si128(values.as_ptr().cast()));
        mul(a: __m512, b: __m512) -> __m512 = _mm512_mul_ps(a, b);
        mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fmadd_ps(a, b, c);
        mul_sub_from(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fnmadd_ps(a, b, c);
        add(a: __m512, b: __m512) -> __m512 = _mm512_add_ps(a, b);
        max(a: __m512, b: __m512) -> __m512 = _mm512_max_ps(a, b);
        round(a: __m512) -> __m512 =
            _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a);
        two_to_the(n: __m512) -> __m512 = _mm512_scalef_ps(_mm512_set1_ps(1.0), n);
        sum(a: __m512) -> f32 = _mm512_reduce_add_ps(a);
        max_lane(a: __m512) -> f32 = _mm512_reduce_max_ps(a);
    }

    #[inline(always)]
    fn with_high_bits<const FROM: u32, const MASK: u8>(
        self,
        low: __m512i,
        high: __m512i,
    ) -> __m512i {
        // SAFETY: as above.
        unsafe {
            let shifted = match FROM {
                0 => _mm512_slli_epi16::<4>(high),
                1 => _mm512_slli_epi16::<3>(high),
                2 => _mm512_slli_epi16::<2>(high),
                3 => _mm512_slli_epi16::<1>(high),
                4 => high,
                5 => _mm512_srli_epi16::<1>(high),
                6 => _mm512_srli_epi16::<2>(high),
                7 => _mm512_srli_epi16::<3>(high),
                _ => _mm512_srli_epi16::<4>(high),
            };
            _mm512_or_si512(
                low,
                _mm512_and_si512(shifted, _mm512_set1_epi8(MASK.cast_signed())),
            )
        }
    }

    #[inline(always)]
    fn begin_dots(self, sum: __m512i) -> __m512i {
        sum
    }

    #[inline(always)]
    fn end_dots(self, _: __m512i, products: __m512i) -> __m512i {
        products
    }

    // The weights are 128 too large here, which the correction makes up for.
    #[inline(always)]
    fn biased_start(self, correction: i32) -> __m512i {
        self.ints(correction)
    }

    #[inline(always)]
    fn dot_biased(self, sum: __m512i, weights: __m512i, activations: i32) -> __m512i {
        self.dot(sum, weights, activations)
    }
}
