//! NEON with dot products (`sdot`): Arm since v8.4, and most cores since Cortex-A76. A vector takes
//! four registers.
#![allow(
    unsafe_code,
    reason = "vector instructions; a `Neon` value exists only where the CPU has them"
)]
#![allow(
    clippy::wildcard_imports,
    reason = "the names of intrinsics say where they are from"
)]

use super::{Kernel, Simd};
use crate::matrix::line::{CacheLine, LANES};
use std::arch::aarch64::*;
use std::arch::{asm, is_aarch64_feature_detected};

/// A value exists only where the CPU has NEON and its dot products.
#[derive(Debug, Clone, Copy)]
pub(in crate::matrix) struct Neon(());

impl Neon {
    #[inline]
    pub(in crate::matrix) fn detect() -> Option<Self> {
        let all = is_aarch64_feature_detected!("neon") && is_aarch64_feature_detected!("dotprod");
        all.then_some(Self(()))
    }
}

type Ints = [int32x4_t; 4];
type Floats = [float32x4_t; 4];
type Bytes = [uint8x16_t; 4];

/// Applies a function to the registers of vectors.
#[inline(always)]
fn each<A: Copy, B>(a: [A; 4], function: impl Fn(A) -> B) -> [B; 4] {
    [
        function(a[0]),
        function(a[1]),
        function(a[2]),
        function(a[3]),
    ]
}

/// Applies a function to the registers of two vectors.
#[inline(always)]
fn each_of_two<A: Copy, B: Copy, C>(a: [A; 4], b: [B; 4], function: impl Fn(A, B) -> C) -> [C; 4] {
    [
        function(a[0], b[0]),
        function(a[1], b[1]),
        function(a[2], b[2]),
        function(a[3], b[3]),
    ]
}

/// Applies a function to the registers of three vectors of floats.
#[inline(always)]
fn each_of_three(
    a: Floats,
    b: Floats,
    c: Floats,
    function: impl Fn(float32x4_t, float32x4_t, float32x4_t) -> float32x4_t,
) -> Floats {
    [
        function(a[0], b[0], c[0]),
        function(a[1], b[1], c[1]),
        function(a[2], b[2], c[2]),
        function(a[3], b[3], c[3]),
    ]
}

/// Where the numbers of each register begin.
#[inline(always)]
fn quarters<T>(values: &[T; LANES]) -> [*const T; 4] {
    [
        values.as_ptr(),
        values[4..].as_ptr(),
        values[8..].as_ptr(),
        values[12..].as_ptr(),
    ]
}

/// Where the bytes of each register begin.
#[inline(always)]
fn registers(line: &CacheLine) -> [*const u8; 4] {
    [
        line.0.as_ptr(),
        line.0[16..].as_ptr(),
        line.0[32..].as_ptr(),
        line.0[48..].as_ptr(),
    ]
}

/// sum + Σ weight · activation over the four signed bytes of each lane. The intrinsic is not stable
/// yet.
///
/// # Safety
/// The CPU has the dot products.
#[inline(always)]
unsafe fn signed_dot(mut sum: int32x4_t, weights: int8x16_t, activations: int8x16_t) -> int32x4_t {
    // SAFETY: as the caller promises.
    unsafe {
        asm!(
            ".arch_extension dotprod",
            "sdot {sum:v}.4s, {weights:v}.16b, {activations:v}.16b",
            sum = inout(vreg) sum,
            weights = in(vreg) weights,
            activations = in(vreg) activations,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
    sum
}

/// Four f16 as f32. The intrinsic is not stable in the oldest Rust that compiles this.
///
/// # Safety
/// The CPU has NEON.
#[inline(always)]
unsafe fn widen_half(bits: uint16x4_t) -> float32x4_t {
    let wide: float32x4_t;
    // SAFETY: as the caller promises.
    unsafe {
        asm!(
            "fcvtl {wide:v}.4s, {bits:v}.4h",
            wide = lateout(vreg) wide,
            bits = in(vreg) bits,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
    wide
}

/// The integers of signed bytes.
///
/// # Safety
/// The CPU has NEON.
#[inline(always)]
unsafe fn widen_signed(bytes: int8x16_t) -> Ints {
    // SAFETY: as the caller promises.
    unsafe {
        let (low, high) = (vmovl_s8(vget_low_s8(bytes)), vmovl_high_s8(bytes));
        [
            vmovl_s16(vget_low_s16(low)),
            vmovl_high_s16(low),
            vmovl_s16(vget_low_s16(high)),
            vmovl_high_s16(high),
        ]
    }
}

/// The integers of unsigned bytes.
///
/// # Safety
/// The CPU has NEON.
#[inline(always)]
unsafe fn widen_unsigned(bytes: uint8x16_t) -> Ints {
    // SAFETY: as the caller promises.
    unsafe {
        let (low, high) = (vmovl_u8(vget_low_u8(bytes)), vmovl_high_u8(bytes));
        let wide = [
            vmovl_u16(vget_low_u16(low)),
            vmovl_high_u16(low),
            vmovl_u16(vget_low_u16(high)),
            vmovl_high_u16(high),
        ];
        each(wide, |values| vreinterpretq_s32_u32(values))
    }
}

// SAFETY of all blocks below: `self` exists, so the CPU has the instructions. Loads and stores take
// references to arrays of four times the operand's size.
impl Simd for Neon {
    type Ints = Ints;
    type Floats = Floats;
    type Bytes = Bytes;
    type ByteSums = Ints;
    const REGISTERS: usize = 8;
    const LARGEST_SUM: i32 = i32::MAX;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        #[target_feature(enable = "neon,dotprod")]
        fn with_instructions<K: Kernel>(simd: Neon, kernel: K) {
            kernel.run(simd);
        }
        // SAFETY: as above.
        unsafe { with_instructions(self, kernel) }
    }

    operations! {
        bytes(line: &CacheLine) -> Bytes = each(registers(line), |start| vld1q_u8(start));
        low(bytes: Bytes) -> Bytes = each(bytes, |bytes| vandq_u8(bytes, vdupq_n_u8(15)));
        high(bytes: Bytes) -> Bytes = each(bytes, |bytes| vshrq_n_u8::<4>(bytes));
        lookup(numbers: Bytes, table: &[u8; 16]) -> Bytes =
            each(numbers, |numbers| vqtbl1q_u8(vld1q_u8(table.as_ptr()), numbers));
        ints(value: i32) -> Ints = [vdupq_n_s32(value); 4];
        // Weights below 128 are the same signed and unsigned.
        dot(sum: Ints, weights: Bytes, activations: i32) -> Ints = each_of_two(sum, weights, |sum, weights| {
            signed_dot(sum, vreinterpretq_s8_u8(weights), vreinterpretq_s8_s32(vdupq_n_s32(activations)))
        });
        biased_start(_correction: i32) -> Ints = [vdupq_n_s32(0); 4];
        dot_biased(sum: Ints, weights: Bytes, activations: i32) -> Ints = each_of_two(sum, weights, |sum, weights| {
            let signed = vreinterpretq_s8_u8(veorq_u8(weights, vdupq_n_u8(128)));
            signed_dot(sum, signed, vreinterpretq_s8_s32(vdupq_n_s32(activations)))
        });
        dot_pairs(sum: Ints, weights: Ints, activations: i32) -> Ints = each_of_two(sum, weights, |sum, weights| {
            let (weights, activations) = (vreinterpretq_s16_s32(weights), vreinterpretq_s16_s32(vdupq_n_s32(activations)));
            let low = vmull_s16(vget_low_s16(weights), vget_low_s16(activations));
            vaddq_s32(sum, vpaddq_s32(low, vmull_high_s16(weights, activations)))
        });
        load_ints(values: &[i32; LANES]) -> Ints = each(quarters(values), |start| vld1q_s32(start));
        to_ints(values: Floats) -> Ints = each(values, |values| vcvtnq_s32_f32(values));
        pair(low: Ints, high: Ints) -> Ints = each_of_two(low, high, |low, high| vsliq_n_s32::<16>(low, high));
        to_floats(values: Ints) -> Floats = each(values, |values| vcvtq_f32_s32(values));
        floats(value: f32) -> Floats = [vdupq_n_f32(value); 4];
        load(values: &[f32; LANES]) -> Floats = each(quarters(values), |start| vld1q_f32(start));
        load_half(values: &[u16; LANES]) -> Floats = each(quarters(values), |start| widen_half(vld1_u16(start)));
        load_signed(values: &[u8; LANES]) -> Floats =
            each(widen_signed(vreinterpretq_s8_u8(vld1q_u8(values.as_ptr()))), |values| vcvtq_f32_s32(values));
        load_unsigned(values: &[u8; LANES]) -> Ints = widen_unsigned(vld1q_u8(values.as_ptr()));
        mul(a: Floats, b: Floats) -> Floats = each_of_two(a, b, |a, b| vmulq_f32(a, b));
        mul_add(a: Floats, b: Floats, c: Floats) -> Floats = each_of_three(a, b, c, |a, b, c| vfmaq_f32(c, a, b));
        mul_sub_from(a: Floats, b: Floats, c: Floats) -> Floats = each_of_three(a, b, c, |a, b, c| vfmsq_f32(c, a, b));
        add(a: Floats, b: Floats) -> Floats = each_of_two(a, b, |a, b| vaddq_f32(a, b));
        // The maximum instruction prefers NaN on either side.
        max(a: Floats, b: Floats) -> Floats = each_of_two(a, b, |a, b| vbslq_f32(vcgtq_f32(a, b), a, b));
        round(a: Floats) -> Floats = each(a, |a| vrndnq_f32(a));
        two_to_the(n: Floats) -> Floats = each(n, |n| {
            vreinterpretq_f32_s32(vshlq_n_s32::<23>(vaddq_s32(vcvtq_s32_f32(n), vdupq_n_s32(127))))
        });
    }

    #[inline(always)]
    fn begin_dots(self, sum: Ints) -> Ints {
        sum
    }

    #[inline(always)]
    fn end_dots(self, _: Ints, products: Ints) -> Ints {
        products
    }

    #[inline(always)]
    fn prefetch(self, line: *const CacheLine) {
        // SAFETY: a prefetch changes nothing.
        unsafe {
            asm!("prfm pldl1keep, [{}]", in(reg) line, options(readonly, nostack, preserves_flags))
        };
    }

    #[inline(always)]
    fn store_bytes(self, bytes: Bytes, line: &mut CacheLine) {
        for (part, bytes) in line.0.as_chunks_mut::<16>().0.iter_mut().zip(bytes) {
            // SAFETY: as above.
            unsafe { vst1q_u8(part.as_mut_ptr(), bytes) };
        }
    }

    #[inline(always)]
    fn store(self, values: Floats, out: &mut [f32; LANES]) {
        for (part, values) in out.as_chunks_mut::<4>().0.iter_mut().zip(values) {
            // SAFETY: as above.
            unsafe { vst1q_f32(part.as_mut_ptr(), values) };
        }
    }

    #[inline(always)]
    fn store_ints(self, values: Ints, out: &mut [i32; LANES]) {
        for (part, values) in out.as_chunks_mut::<4>().0.iter_mut().zip(values) {
            // SAFETY: as above.
            unsafe { vst1q_s32(part.as_mut_ptr(), values) };
        }
    }

    #[inline(always)]
    fn with_high_bits<const FROM: u32, const MASK: u8>(self, low: Bytes, high: Bytes) -> Bytes {
        // SAFETY: as above.
        each_of_two(low, high, |low, high| unsafe {
            let shifted = match FROM {
                0 => vshlq_n_u8::<4>(high),
                1 => vshlq_n_u8::<3>(high),
                2 => vshlq_n_u8::<2>(high),
                3 => vshlq_n_u8::<1>(high),
                4 => high,
                5 => vshrq_n_u8::<1>(high),
                6 => vshrq_n_u8::<2>(high),
                7 => vshrq_n_u8::<3>(high),
                _ => vshrq_n_u8::<4>(high),
            };
            vorrq_u8(low, vandq_u8(shifted, vdupq_n_u8(MASK)))
        })
    }
}
