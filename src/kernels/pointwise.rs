//! Activation functions and softmax, vectorized and parallel, in few passes over the numbers.
#![allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]

use super::activation::Activation;
use super::matrix::{Instructions, Kernel, LANES, Simd};
use super::values::{both_row_by_row, row_by_row};
use candle_core::{D, Result, Tensor, bail};
use std::marker::PhantomData;

impl Activation {
    /// Applies the function to each number.
    pub fn forward(self, x: &Tensor) -> Result<Tensor> {
        let width = x.dim(D::Minus1)?;
        row_by_row(x, width, width, |out, values| {
            out.copy_from_slice(values);
            Instructions::best().run(self.in_place(out));
        })
    }

    /// Applies the function to numbers where they lie.
    pub(crate) fn in_place(self, values: &mut [f32]) -> impl Kernel {
        EachKernel {
            activation: self,
            values,
        }
    }

    /// f(gate) · up of rows (gate, up), (tokens, 2 · width), to (tokens, width).
    ///
    /// # Errors
    /// When the rows have an odd width, or the function is neither [`Self::Silu`] nor
    /// [`Self::GeluTanh`].
    pub fn gated(self, gate_up: &Tensor) -> Result<Tensor> {
        let both = gate_up.dim(D::Minus1)?;
        let width = both / 2;
        if both % 2 == 1 {
            bail!("rows of {both} numbers do not split into gates and values of equal width");
        }
        match self {
            Self::Silu => gated::<SiluGate>(gate_up, width),
            Self::GeluTanh => gated::<GeluTanhGate>(gate_up, width),
            other => bail!("gates with {other:?} are not supported"),
        }
    }

    /// f(gate) · value of gates and values in tensors of their own.
    ///
    /// # Errors
    /// When they differ in shape, or as [`Self::gated`].
    pub fn gated_by(self, gates: &Tensor, values: &Tensor) -> Result<Tensor> {
        match self {
            Self::Silu => gated_by::<SiluGate>(gates, values),
            Self::GeluTanh => gated_by::<GeluTanhGate>(gates, values),
            other => bail!("gates with {other:?} are not supported"),
        }
    }
}

fn gated_by<G: Gate>(gates: &Tensor, values: &Tensor) -> Result<Tensor> {
    let width = gates.dim(D::Minus1)?;
    both_row_by_row(gates, values, width, |out, gates, values| {
        Instructions::best().run(GatedByKernel::<G> {
            gates,
            values,
            out,
            gate: PhantomData,
        });
    })
}

fn gated<G: Gate>(gate_up: &Tensor, width: usize) -> Result<Tensor> {
    row_by_row(gate_up, 2 * width, width, |out, values| {
        Instructions::best().run(GatedKernel::<G> {
            width,
            values,
            out,
            gate: PhantomData,
        });
    })
}

/// σ(gate) · value of rows (gate, value), (tokens, 2 · width), to (tokens, width).
///
/// # Errors
/// When the rows have an odd width.
pub fn sigmoid_gated(rows: &Tensor) -> Result<Tensor> {
    let both = rows.dim(D::Minus1)?;
    if both % 2 == 1 {
        bail!("rows of {both} numbers do not split into gates and values of equal width");
    }
    gated::<SigmoidGate>(rows, both / 2)
}

/// A share of a softmax below this becomes zero. Products with it would be subnormal, which made
/// the networks of GameFormer and DTPP two to three times as slow.
const NEGLIGIBLE: f32 = 1e-30;

/// Softmax over the last dimension.
pub fn softmax(x: &Tensor) -> Result<Tensor> {
    let width = x.dim(D::Minus1)?;
    row_by_row(x, width, width, |out, values| {
        Instructions::best().run(SoftmaxKernel { width, values, out });
    })
}

struct SoftmaxKernel<'a> {
    width: usize,
    values: &'a [f32],
    out: &'a mut [f32],
}

impl Kernel for SoftmaxKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        self.out.copy_from_slice(self.values);
        self.out
            .chunks_exact_mut(self.width)
            .for_each(softmax_in_place);
    }
}

/// Softmax of one row, for kernels.
#[inline(always)]
pub(crate) fn softmax_in_place(row: &mut [f32]) {
    let largest = reduced(row, f32::NEG_INFINITY, |a, b| if a > b { a } else { b });
    for value in row.iter_mut() {
        *value = exp_or_zero(*value - largest);
    }
    let sum = reduced(row, 0.0, |a, b| a + b);
    for value in row.iter_mut() {
        *value /= sum;
    }
}

/// eˣ, or 0 where that is negligible as a share.
#[inline(always)]
pub fn exp_or_zero(x: f32) -> f32 {
    let raised = exp(x);
    if raised < NEGLIGIBLE { 0.0 } else { raised }
}

/// Combines the numbers lane by lane, then the lanes, then the rest.
#[inline(always)]
fn reduced(row: &[f32], start: f32, combine: impl Fn(f32, f32) -> f32) -> f32 {
    let (whole, rest) = row.as_chunks::<LANES>();
    let mut lanes = [start; LANES];
    for values in whole {
        for (lane, value) in lanes.iter_mut().zip(values) {
            *lane = combine(*lane, *value);
        }
    }
    lanes
        .into_iter()
        .chain(rest.iter().copied())
        .fold(start, combine)
}

struct EachKernel<'a> {
    activation: Activation,
    values: &'a mut [f32],
}

impl Kernel for EachKernel<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Self { activation, values } = self;
        match activation {
            Activation::Gelu => map(values, gelu),
            Activation::GeluTanh => map(values, gelu_tanh),
            Activation::QuickGelu => map(values, |x| x * sigmoid(1.702 * x)),
            Activation::Relu => map(values, |x| if x < 0.0 { 0.0 } else { x }),
            Activation::Silu => map(values, |x| x * sigmoid(x)),
        }
    }
}

#[inline(always)]
fn map(values: &mut [f32], function: impl Fn(f32) -> f32) {
    for value in values {
        *value = function(*value);
    }
}

/// The function of gates. A type of its own, so that it is inlined where the instructions are
/// enabled.
trait Gate {
    fn apply(gate: f32) -> f32;
}

struct SiluGate;

impl Gate for SiluGate {
    #[inline(always)]
    fn apply(gate: f32) -> f32 {
        gate * sigmoid(gate)
    }
}

struct GeluTanhGate;

impl Gate for GeluTanhGate {
    #[inline(always)]
    fn apply(gate: f32) -> f32 {
        gelu_tanh(gate)
    }
}

struct SigmoidGate;

impl Gate for SigmoidGate {
    #[inline(always)]
    fn apply(gate: f32) -> f32 {
        sigmoid(gate)
    }
}

struct GatedKernel<'a, G> {
    width: usize,
    values: &'a [f32],
    out: &'a mut [f32],
    gate: PhantomData<G>,
}

impl<G: Gate> Kernel for GatedKernel<'_, G> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for (out, row) in self
            .out
            .chunks_exact_mut(self.width)
            .zip(self.values.chunks_exact(2 * self.width))
        {
            let (gates, values) = row.split_at(self.width);
            for ((out, gate), value) in out.iter_mut().zip(gates).zip(values) {
                *out = G::apply(*gate) * value;
            }
        }
    }
}

struct GatedByKernel<'a, G> {
    gates: &'a [f32],
    values: &'a [f32],
    out: &'a mut [f32],
    gate: PhantomData<G>,
}

impl<G: Gate> Kernel for GatedByKernel<'_, G> {
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for ((out, gate), value) in self.out.iter_mut().zip(self.gates).zip(self.values) {
            *out = G::apply(*gate) * value;
        }
    }
}

/// 0.5 x (1 + tanh(u)) = x σ(2u), u = √(2/π) (x + 0.044715 x³).
#[inline(always)]
fn gelu_tanh(x: f32) -> f32 {
    /// 2 √(2/π): the argument of σ is 2u.
    const TWO_SQRT_2_PI: f32 =
        2.0 * std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2;
    x * sigmoid(TWO_SQRT_2_PI * x * (1.0 + 0.044_715 * x * x))
}

/// 1 / (1 + e⁻ˣ).
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// tanh x with all digits also near 0: there by five terms of Lambert's continued fraction,
/// elsewhere as 2 σ(2x) − 1.
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    let square = x * x;
    let near = x * (10395.0 + square * (1260.0 + square * 21.0))
        / (10395.0 + square * (4725.0 + square * (210.0 + square)));
    let far = 2.0 * sigmoid(2.0 * x) - 1.0;
    if square < 1.0 { near } else { far }
}

/// eˣ to about two units in the last place, without branches: eˣ = 2ⁿ eʳ with |r| ≤ ln 2 / 2 and eʳ
/// by its Taylor series. x is clamped to ±87.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// ln 2 in two parts (Cody and Waite): products of the first part with small integers are
    /// exact.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    /// 1/k! for k from 7 down to 0.
    const SERIES: [f32; 8] = [
        1.0 / 5040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    /// 1.5 · 2²³: a sum with it is rounded to a whole number, which its lowest bits hold.
    /// `round_ties_even` and a conversion, which saturates, take three times as long.
    const ROUND: f32 = 12_582_912.0;
    /// IEEE 754's f32: the bias of its exponent, and the bits of its mantissa.
    const EXPONENT_BIAS: u32 = 127;
    const MANTISSA_BITS: u32 = 23;
    let x = x.clamp(-87.0, 87.0);
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = x - n * LN_2[0] - n * LN_2[1];
    let series = SERIES
        .into_iter()
        .fold(0.0, |sum, coefficient| sum * r + coefficient);
    // The lowest bits of `rounded` hold n, see `ROUND`; the shift drops all others.
    let power = rounded.to_bits().wrapping_add(EXPONENT_BIAS) << MANTISSA_BITS;
    series * f32::from_bits(power)
}

/// x Φ(x), Φ the normal distribution, by a Chebyshev fit of the complementary error function with a
/// relative error of 1.2 · 10⁻⁷ (Press et al., Numerical Recipes, `erfcc`): so the result keeps its
/// digits where it vanishes.
#[inline(always)]
fn gelu(x: f32) -> f32 {
    /// The coefficients of `erfcc`, the highest power of t first.
    const FIT: [f32; 10] = [
        0.170_872_77,
        -0.822_152_2,
        1.488_515_9,
        -1.135_204,
        0.278_868_08,
        -0.186_288_06,
        0.096_784_18,
        0.374_091_96,
        1.000_023_7,
        -1.265_512_2,
    ];
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * z);
    let tail = 0.5
        * t
        * exp(FIT
            .into_iter()
            .fold(0.0, |sum, coefficient| sum * t + coefficient)
            - z * z);
    x * if x < 0.0 { tail } else { 1.0 - tail }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn numbers() -> Vec<f32> {
        let fine = (-20_000..=20_000).map(|step| step as f32 * 0.001);
        fine.chain([-1e30, -200.0, -90.0, 90.0, 200.0, 1e30])
            .collect()
    }

    #[test]
    fn activations_are_what_candle_says() {
        let x = numbers();
        let tensor = Tensor::new(x.as_slice(), &Device::Cpu)
            .unwrap()
            .unsqueeze(0)
            .unwrap();
        let quick =
            (&tensor * candle_nn::ops::sigmoid(&(&tensor * 1.702).unwrap()).unwrap()).unwrap();
        for (activation, expected) in [
            (Activation::Gelu, tensor.gelu_erf().unwrap()),
            (Activation::GeluTanh, tensor.gelu().unwrap()),
            (Activation::QuickGelu, quick),
            (Activation::Relu, tensor.relu().unwrap()),
            (Activation::Silu, tensor.silu().unwrap()),
        ] {
            let found: Vec<f32> = activation
                .forward(&tensor)
                .unwrap()
                .flatten_all()
                .unwrap()
                .to_vec1()
                .unwrap();
            let expected: Vec<f32> = expected.flatten_all().unwrap().to_vec1().unwrap();
            for ((found, expected), x) in found.into_iter().zip(expected).zip(&x) {
                let allowed = 1e-6 * x.abs().min(expected.abs() + 1.0);
                assert!(
                    (found - expected).abs() <= allowed,
                    "{activation:?}({x}) = {found}, not {expected}"
                );
            }
        }
    }

    #[test]
    fn softmax_is_what_candle_says_and_hides_what_is_minus_infinity() {
        let row = (0..75).map(|index| {
            if index % 7 == 3 {
                f32::NEG_INFINITY
            } else {
                (index * 31 % 40) as f32 * 0.5
            }
        });
        let rows: Vec<f32> = row.collect::<Vec<_>>().repeat(3);
        let x = Tensor::from_vec(rows, (3, 75), &Device::Cpu).unwrap();
        let found = softmax(&x).unwrap().to_vec2::<f32>().unwrap();
        let expected = candle_nn::ops::softmax_last_dim(&x)
            .unwrap()
            .to_vec2::<f32>()
            .unwrap();
        for (found, expected) in found
            .into_iter()
            .flatten()
            .zip(expected.into_iter().flatten())
        {
            assert!(
                (found - expected).abs() <= 1e-6 * expected && (found == 0.0) == (expected == 0.0),
                "{found}, {expected}"
            );
        }
        let hidden = Tensor::full(f32::NEG_INFINITY, (1, 4), &Device::Cpu).unwrap();
        assert!(
            softmax(&hidden).unwrap().to_vec2::<f32>().unwrap()[0]
                .iter()
                .all(|value| value.is_nan())
        );
    }

    #[test]
    fn gates_multiply_their_values() {
        let x = numbers();
        let row: Vec<f32> = x
            .iter()
            .copied()
            .chain(std::iter::repeat_n(3.0, x.len()))
            .collect();
        let gate_up = Tensor::from_vec(row.repeat(5), (5, 2 * x.len()), &Device::Cpu).unwrap();
        let gelu = |x: f64| {
            let inner = (2.0 / std::f64::consts::PI).sqrt() * (x + 0.044_715 * x.powi(3));
            0.5 * x * (1.0 + inner.tanh())
        };
        let silu = |x: f64| x / (1.0 + (-x).exp());
        let gates: [(Activation, &dyn Fn(f64) -> f64); 2] =
            [(Activation::Silu, &silu), (Activation::GeluTanh, &gelu)];
        for (activation, gate) in gates {
            let found = activation.gated(&gate_up).unwrap();
            let half = |first| gate_up.narrow(1, first, x.len()).unwrap();
            let apart = activation.gated_by(&half(0), &half(x.len())).unwrap();
            let rows = |x: &Tensor| x.to_vec2::<f32>().unwrap();
            assert_eq!(rows(&apart), rows(&found));
            for row in found.to_vec2::<f32>().unwrap() {
                for (found, x) in row.into_iter().zip(&x) {
                    let expected = 3.0 * gate(f64::from(*x));
                    assert!(
                        (f64::from(found) - expected).abs() <= 2e-6 * expected.abs() + 3e-7,
                        "{activation:?} {x}: {found} {expected}"
                    );
                }
            }
        }
        let found = sigmoid_gated(&gate_up).unwrap();
        for row in found.to_vec2::<f32>().unwrap() {
            for (found, x) in row.into_iter().zip(&x) {
                let expected = 3.0 / (1.0 + (-f64::from(*x)).exp());
                assert!(
                    (f64::from(found) - expected).abs() <= 1e-6 * expected + 1e-30,
                    "{x}"
                );
            }
        }
        let odd = Tensor::zeros((2, 3), candle_core::DType::F32, &Device::Cpu).unwrap();
        assert!(sigmoid_gated(&odd).is_err());
        assert!(Activation::Silu.gated(&odd).is_err());
        assert!(Activation::Relu.gated(&gate_up).is_err());
        assert!(Activation::Relu.gated_by(&gate_up, &gate_up).is_err());
        assert!(Activation::Silu.gated_by(&gate_up, &odd).is_err());
    }

    #[test]
    fn tanh_keeps_its_digits() {
        for x in numbers().into_iter().chain([1e-30, -1e-9, 3e-5]) {
            let expected = f64::from(x).tanh();
            let off = (f64::from(tanh(x)) - expected).abs();
            assert!(
                off <= 4e-7 * expected.abs(),
                "tanh {x} = {}, not {expected}",
                tanh(x)
            );
        }
        assert!(tanh(f32::NAN).is_nan());
    }

    #[test]
    fn nan_stays_nan() {
        let x = Tensor::new(&[[f32::NAN, f32::NAN]], &Device::Cpu).unwrap();
        for activation in [
            Activation::Gelu,
            Activation::GeluTanh,
            Activation::QuickGelu,
            Activation::Relu,
            Activation::Silu,
        ] {
            let found: Vec<f32> = activation
                .forward(&x)
                .unwrap()
                .flatten_all()
                .unwrap()
                .to_vec1()
                .unwrap();
            assert!(found.iter().all(|value| value.is_nan()), "{activation:?}");
        }
    }
}
