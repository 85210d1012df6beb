//! Products compared with plain arithmetic, in every instruction set of this CPU.

use super::*;
use half::f16;
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Formats that can be chosen, and those that only files or memory have.
fn every_format() -> impl Iterator<Item = WeightFormat> {
    let others = [
        WeightFormat::Iq4Nl,
        WeightFormat::Iq4Xs,
        WeightFormat::Mxfp4,
        WeightFormat::Q8Of256,
    ];
    WeightFormat::ALL.into_iter().chain(others)
}

/// Random blocks with scales below `largest`.
fn random_blocks(
    weight_format: WeightFormat,
    outputs: usize,
    inputs: usize,
    largest: f32,
    random: &mut Pcg64Mcg,
) -> Vec<u8> {
    if weight_format == WeightFormat::F32 {
        return (0..outputs * inputs)
            .flat_map(|_| random.random_range(-largest..largest).to_le_bytes())
            .collect();
    }
    let mut bytes = vec![0; weight_format.matrix_bytes(outputs, inputs).unwrap()];
    random.fill_bytes(&mut bytes);
    for block in bytes.chunks_exact_mut(weight_format.block_bytes()) {
        for at in weight_format.halves() {
            let scale = f16::from_f32(random.random_range(-largest..largest));
            block[*at..at + 2].copy_from_slice(&scale.to_le_bytes());
        }
        if weight_format == WeightFormat::Mxfp4 {
            // Exponents from 2⁻²⁴ to 2.
            block[0] = random.random_range(104..130);
        }
    }
    bytes
}

fn random_rows(count: usize, inputs: usize, random: &mut Pcg64Mcg) -> Vec<f32> {
    // Like activations, a few numbers are much larger than the others.
    (0..count * inputs)
        .map(|_| {
            random.random_range(-1.0..1.0)
                * if random.random_range(0..50) == 0 {
                    40.0
                } else {
                    1.0
                }
        })
        .collect()
}

fn multiplied(tiles: &PackedTiles, x: &[f32], instructions: Instructions) -> Vec<f32> {
    let mut results = Results::with_room(x.len() / tiles.inputs(), tiles.outputs());
    let then = Then::default();
    let bounds = None;
    results.append(tiles, &[Pass { x, bounds, then }], instructions);
    results
        .finish()
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap()
}

/// A row of activations as the quantized kernels round it; `scaled` activations share a scale.
fn rounded(row: &[f32], scaled: usize) -> Vec<f32> {
    row.chunks(scaled)
        .flat_map(|span| {
            let largest = span
                .iter()
                .fold(0f32, |largest, value| largest.max(value.abs()));
            span.iter()
                .map(move |value| (value * (127.0 / largest)).round_ties_even() * (largest / 127.0))
        })
        .collect()
}

/// The product in plain f64 and the sum of the magnitudes of its terms.
fn plain(tiles: &PackedTiles, x: &[f32]) -> Vec<(f64, f64)> {
    let mut weights = vec![0.0; tiles.inputs()];
    let mut result = vec![(0.0, 0.0); x.len() / tiles.inputs() * tiles.outputs()];
    for output in 0..tiles.outputs() {
        tiles.read_row(output, &mut weights).unwrap();
        for (row, results) in x
            .chunks_exact(tiles.inputs())
            .zip(result.chunks_exact_mut(tiles.outputs()))
        {
            let row = match tiles.weight_format() {
                WeightFormat::F32 | WeightFormat::F16 => row.to_vec(),
                format => rounded(row, format.block()),
            };
            for (weight, value) in weights.iter().zip(row) {
                let term = f64::from(*weight) * f64::from(value);
                results[output].0 += term;
                results[output].1 += term.abs();
            }
        }
    }
    result
}

/// Compares the products of every instruction set with plain arithmetic.
fn assert_as_plain(tiles: &PackedTiles, x: &[f32]) {
    let (weight_format, outputs, inputs) = (tiles.weight_format(), tiles.outputs(), tiles.inputs());
    let rows = x.len() / inputs;
    let expected = plain(tiles, x);
    for instructions in Instructions::available() {
        let found = multiplied(tiles, x, instructions);
        for (index, (found, (value, magnitude))) in found.iter().zip(&expected).enumerate() {
            assert!(
                (f64::from(*found) - value).abs() <= magnitude * 1e-5,
                "{weight_format} {outputs}x{inputs} {rows} rows {instructions:?} at {index}: {found} {value}, first activation {}",
                x[0]
            );
        }
    }
}

/// The last span of a row is shorter than the others, and must not be lost.
#[test]
fn floats_have_any_number_of_inputs() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let widths = (1..4).chain(125..132).chain(253..259);
    for (inputs, weight_format) in widths
        .flat_map(|inputs| [WeightFormat::F32, WeightFormat::F16].map(|format| (inputs, format)))
    {
        let bytes = random_blocks(weight_format, 40, inputs, 1.0, &mut random);
        let tiles = PackedTiles::pack(weight_format, 40, inputs, &bytes);
        for rows in [1, 3, 26] {
            assert_as_plain(&tiles, &random_rows(rows, inputs, &mut random));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Odd numbers of rows, tails of tiles, spans and batches, scales from the smallest to the
    /// largest.
    #[test]
    fn every_kernel_multiplies_as_plain_arithmetic_does(
        outputs in 1usize..70, blocks in 1usize..4, rows in 1usize..40, exponent in -24i32..16, seed: u64,
    ) {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        for weight_format in every_format() {
            let inputs = blocks * if weight_format.block() == 1 { 75 } else { weight_format.block() };
            let bytes = random_blocks(weight_format, outputs, inputs, 2f32.powi(exponent), &mut random);
            let tiles = PackedTiles::pack(weight_format, outputs, inputs, &bytes);
            assert_as_plain(&tiles, &random_rows(rows, inputs, &mut random));
        }
    }

    #[test]
    fn blocks_come_back_bit_for_bit(outputs in 1usize..40, blocks in 1usize..4, seed: u64) {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        for weight_format in every_format() {
            let inputs = blocks * weight_format.block();
            let bytes = random_blocks(weight_format, outputs, inputs, 1.0, &mut random);
            let matrix = Matrix::from_blocks(weight_format, outputs, inputs, &bytes).unwrap();
            let mut written = Vec::new();
            matrix.write_blocks(&mut written).unwrap();
            prop_assert_eq!(written, bytes, "{}", weight_format);
        }
    }
}

/// Sums of 16 bits must not overflow where every number is the largest.
#[test]
fn sums_hold_the_largest_numbers() {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let (outputs, inputs) = (40, 512);
    let bytes = [0xff, 0x80, 0x7f, 0];
    for (weight_format, byte) in every_format().flat_map(|format| bytes.map(|byte| (format, byte)))
    {
        if matches!(weight_format, WeightFormat::F32 | WeightFormat::F16) {
            continue;
        }
        let mut bytes = random_blocks(weight_format, outputs, inputs, 1.0, &mut random);
        for block in bytes.chunks_exact_mut(weight_format.block_bytes()) {
            let halves = weight_format.halves();
            for (index, place) in block.iter_mut().enumerate() {
                if !halves.iter().any(|at| (*at..at + 2).contains(&index)) {
                    *place = byte;
                }
            }
            if weight_format == WeightFormat::Mxfp4 {
                block[0] = 120;
            }
        }
        let tiles = PackedTiles::pack(weight_format, outputs, inputs, &bytes);
        for x in [vec![1.0; 30 * inputs], vec![-1.0; 30 * inputs]] {
            assert_as_plain(&tiles, &x);
        }
    }
}

/// Also in the last span of a row, which may have fewer inputs than others.
#[test]
fn a_row_gives_the_same_bits_alone_and_among_others_at_any_thread_count() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (outputs, rows) = (300, 31);
    let shapes = every_format().flat_map(|format| [512, 576, 960].map(|inputs| (format, inputs)));
    for (weight_format, inputs) in
        shapes.filter(|(format, inputs)| Matrix::fits(*format, outputs, *inputs))
    {
        let bytes = random_blocks(weight_format, outputs, inputs, 1.0, &mut random);
        let tiles = PackedTiles::pack(weight_format, outputs, inputs, &bytes);
        let x = random_rows(rows, inputs, &mut random);
        for instructions in Instructions::available() {
            let together = multiplied(&tiles, &x, instructions);
            // One row, a batch that is not full, and several batches.
            for rows in [1, 4, 21] {
                let apart: Vec<f32> = x
                    .chunks(rows * inputs)
                    .flat_map(|rows| multiplied(&tiles, rows, instructions))
                    .collect();
                assert_eq!(
                    together, apart,
                    "{weight_format} {instructions:?} {rows} rows"
                );
            }
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .unwrap();
                let there = pool.install(|| multiplied(&tiles, &x, instructions));
                assert_eq!(
                    together, there,
                    "{weight_format} {instructions:?}, {threads} threads"
                );
            }
        }
    }
}

#[test]
fn two_terms_lose_a_hundredth_of_what_one_loses() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let (outputs, inputs, rows) = (40, 512, 9);
    let ids: Vec<u32> = (0..40).collect();
    let values = random_rows(rows, inputs, &mut random);
    let x = Tensor::from_vec(values, (rows, inputs), &Device::Cpu).unwrap();
    for weight_format in every_format() {
        let bytes = random_blocks(weight_format, outputs, inputs, 1.0, &mut random);
        let one = Matrix::from_blocks(weight_format, outputs, inputs, &bytes).unwrap();
        let exact = Matrix::from_tensor(&one.rows(&ids).unwrap()).unwrap();
        let exact = exact.forward(&x).unwrap();
        let lost = |found: &Tensor| {
            let squares = (found - &exact).unwrap().sqr().unwrap();
            squares
                .sum_all()
                .unwrap()
                .to_scalar::<f32>()
                .unwrap()
                .sqrt()
        };
        let in_one = one.forward(&x).unwrap();
        let two = one.in_two_terms();
        let in_two = two.forward(&x).unwrap();
        if weight_format.block() == 1 {
            let same = lost(&in_two).to_bits() == lost(&in_one).to_bits();
            assert!(same, "{weight_format}");
        } else {
            assert!(lost(&in_two) < lost(&in_one) / 100.0, "{weight_format}");
        }
        let alone = two.forward(&x.narrow(0, 4, 1).unwrap()).unwrap();
        let among = in_two.narrow(0, 4, 1).unwrap();
        assert_eq!(
            alone.to_vec2::<f32>().unwrap(),
            among.to_vec2::<f32>().unwrap()
        );
        let stack = Matrix::stack(vec![two.clone(), two])
            .unwrap()
            .forward(&x)
            .unwrap();
        let second = stack.narrow(1, outputs, outputs).unwrap();
        assert_eq!(
            second.to_vec2::<f32>().unwrap(),
            in_two.to_vec2::<f32>().unwrap()
        );
    }
}

#[test]
fn nan_and_infinity_appear_in_the_result() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    for weight_format in every_format() {
        let bytes = random_blocks(weight_format, 20, 512, 1.0, &mut random);
        let tiles = PackedTiles::pack(weight_format, 20, 512, &bytes);
        for strange in [f32::NAN, f32::INFINITY] {
            let mut x = random_rows(2, 512, &mut random);
            x[700] = strange;
            for instructions in Instructions::available() {
                let result = multiplied(&tiles, &x, instructions);
                assert!(
                    result[..20].iter().all(|value| value.is_finite()),
                    "{weight_format}"
                );
                assert!(
                    result[20..].iter().all(|value| !value.is_finite()),
                    "{weight_format}"
                );
            }
        }
    }
}

/// Rows that end within a block are those with zeros behind them, bit for bit, with few rows of
/// activations and many, in one term and in two.
#[test]
fn zeros_fill_the_last_block_of_a_row() {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let outputs = 35;
    for (inputs, weight_format) in [
        (528_usize, WeightFormat::Q8_0),
        (787, WeightFormat::Q5_0),
        (515, WeightFormat::Q4_1),
        (787, WeightFormat::Q8Of256),
    ] {
        let whole = inputs.next_multiple_of(weight_format.block());
        let filled = |rows: &[f32]| -> Vec<f32> {
            let rows = rows.chunks(inputs);
            rows.flat_map(|row| [row, &vec![0.0; whole - inputs]].concat())
                .collect()
        };
        let values = random_rows(outputs, inputs, &mut random);
        let matrix = Matrix::quantize(&values, outputs, inputs, weight_format).unwrap();
        let expected = Matrix::quantize(&filled(&values), outputs, whole, weight_format).unwrap();
        let ids = [0, 17, 34];
        assert_eq!(
            matrix.rows(&ids).unwrap().to_vec2::<f32>().unwrap(),
            expected
                .rows(&ids)
                .unwrap()
                .narrow(1, 0, inputs)
                .unwrap()
                .to_vec2::<f32>()
                .unwrap()
        );
        for rows in [1, 7, 40] {
            let x = random_rows(rows, inputs, &mut random);
            for two_terms in [false, true] {
                let product = |matrix: &Matrix, x: Vec<f32>| {
                    let x = Tensor::from_vec(x, (rows, matrix.inputs()), &Device::Cpu).unwrap();
                    let matrix = if two_terms {
                        matrix.clone().in_two_terms()
                    } else {
                        matrix.clone()
                    };
                    matrix.forward(&x).unwrap().to_vec2::<f32>().unwrap()
                };
                assert_eq!(
                    product(&matrix, x.clone()),
                    product(&expected, filled(&x)),
                    "{weight_format} {inputs} {rows} {two_terms}"
                );
            }
        }
    }
}

#[test]
fn a_stack_multiplies_and_reads_like_its_matrices() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let inputs = 256;
    let parts = [
        (WeightFormat::Q4K, 32),
        (WeightFormat::Q4K, 20),
        (WeightFormat::Q6K, 17),
        (WeightFormat::F32, 16),
        (WeightFormat::F32, 3),
    ];
    let matrices: Vec<Matrix> = parts
        .iter()
        .map(|(weight_format, outputs)| {
            let values = random_rows(*outputs, inputs, &mut random);
            Matrix::quantize(&values, *outputs, inputs, *weight_format).unwrap()
        })
        .collect();
    let x = Tensor::from_vec(
        random_rows(7, inputs, &mut random),
        (7, inputs),
        &Device::Cpu,
    )
    .unwrap();
    let apart: Vec<Tensor> = matrices
        .iter()
        .map(|matrix| matrix.forward(&x).unwrap())
        .collect();
    let rows: Vec<Tensor> = matrices
        .iter()
        .map(|matrix| matrix.rows(&[0, 2]).unwrap())
        .collect();
    let bytes: usize = matrices.iter().map(Matrix::bytes).sum();
    let stack = Matrix::stack(matrices).unwrap();
    assert_eq!(
        (stack.outputs(), stack.inputs(), stack.bytes()),
        (88, inputs, bytes)
    );
    assert_eq!(
        stack.segments.len(),
        3,
        "matrices that are stored alike are one"
    );
    let expected = Tensor::cat(&apart, 1).unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(
        stack.forward(&x).unwrap().to_vec2::<f32>().unwrap(),
        expected
    );
    let (bias, residual) = (
        stack.rows(&[3]).unwrap().narrow(1, 0, 88).unwrap(),
        (&x.narrow(1, 9, 88).unwrap() * 2.0).unwrap(),
    );
    let onto = stack
        .forward_then(
            &x,
            &Beside {
                bias: Some(&bias.squeeze(0).unwrap()),
                residual: Some(&residual),
                ..Beside::default()
            },
        )
        .unwrap();
    let sum = (stack.forward(&x).unwrap().broadcast_add(&bias).unwrap() + &residual).unwrap();
    let difference = (onto - sum)
        .unwrap()
        .abs()
        .unwrap()
        .max_all()
        .unwrap()
        .to_scalar::<f32>()
        .unwrap();
    assert!(difference < 1e-3, "{difference}");
    for beside in [
        Beside {
            residual: Some(&x),
            ..Beside::default()
        },
        Beside {
            scale: Some(&x),
            ..Beside::default()
        },
    ] {
        assert!(stack.forward_then(&x, &beside).is_err());
    }
    let starts = [0, 32, 52, 69, 85];
    for (start, rows) in starts.into_iter().zip(rows) {
        let found = stack.rows(&[start, start + 2]).unwrap();
        assert_eq!(
            found.to_vec2::<f32>().unwrap(),
            rows.to_vec2::<f32>().unwrap()
        );
    }
    assert!(stack.rows(&[88]).is_err());
    assert!(
        stack
            .forward(&Tensor::zeros((2, 255), candle_core::DType::F32, &Device::Cpu).unwrap())
            .is_err()
    );
}

/// ggml's own rounding never writes -128, but the folders of quantizers have it.
#[test]
fn the_smallest_signed_byte_is_multiplied_as_others() {
    let inputs = 64;
    let mut block = [0x80; 34];
    block[..2].copy_from_slice(&f16::from_f32(0.5).to_le_bytes());
    let tiles = PackedTiles::pack(WeightFormat::Q8_0, 1, inputs, &block.repeat(2));
    for value in [1.0, -1.0] {
        for instructions in Instructions::available() {
            let product = multiplied(&tiles, &vec![value; inputs], instructions)[0];
            let expected = -64.0 * 64.0 * value;
            assert!(
                (product - expected).abs() < 1e-2,
                "{instructions:?}: {product}"
            );
        }
    }
}

#[test]
fn a_matrix_in_strips_is_that_of_all_rows() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let blocks = |matrix: &Matrix| {
        let mut bytes = Vec::new();
        matrix.write_blocks(&mut bytes).unwrap();
        bytes
    };
    for weight_format in WeightFormat::ALL {
        let (outputs, inputs) = (75, 512);
        let values = random_rows(outputs, inputs, &mut random);
        let whole = Matrix::quantize(&values, outputs, inputs, weight_format).unwrap();
        let strips = |step: usize| {
            Matrix::in_strips(weight_format, [outputs, inputs], step, |rows| {
                let values = &values[rows.start * inputs..rows.end * inputs];
                Matrix::quantize(values, rows.len(), inputs, weight_format)
            })
        };
        for step in [16, 32, 80, 1 << 40] {
            let found = strips(step).unwrap();
            assert_eq!(found.segments.len(), 1);
            assert!(blocks(&found) == blocks(&whole), "{weight_format} {step}");
        }
        for step in [0, 20] {
            assert!(strips(step).is_err(), "{weight_format} {step}");
        }
    }
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    assert!(Matrix::fits(WeightFormat::Q4K, 3, 512) && !Matrix::fits(WeightFormat::Q4K, 3, 96));
    assert!(Matrix::quantize(&[0.0; 96], 1, 96, WeightFormat::Q6K).is_err());
    assert!(Matrix::quantize(&[0.0; 96], 2, 96, WeightFormat::Q8_0).is_err());
    assert!(Matrix::from_blocks(WeightFormat::Q4K, 1, 256, &[0; 143]).is_err());
    assert!(Matrix::from_blocks(WeightFormat::F16, 0, 256, &[]).is_err());
    assert!(Matrix::stack(Vec::new()).is_err());
}

#[test]
fn each_format_has_the_error_of_its_bits() {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let (outputs, inputs) = (40, 512);
    let values: Vec<f32> = (0..outputs * inputs)
        .map(|_| random.random_range(-0.1..0.1))
        .collect();
    let x = Tensor::from_vec(
        random_rows(9, inputs, &mut random),
        (9, inputs),
        &Device::Cpu,
    )
    .unwrap();
    let exact = Matrix::quantize(&values, outputs, inputs, WeightFormat::F32)
        .unwrap()
        .forward(&x)
        .unwrap();
    let size = exact
        .sqr()
        .unwrap()
        .sum_all()
        .unwrap()
        .to_scalar::<f32>()
        .unwrap();
    // A step of n bits over ±1 leaves an error of 2 / 2ⁿ / √12 against numbers of 1 / √3;
    // activations add theirs.
    for (weight_format, least, most) in [
        (WeightFormat::F16, 1e-5, 1e-3),
        (WeightFormat::Q8_0, 1e-3, 2e-2),
        (WeightFormat::Q6K, 5e-3, 4e-2),
        (WeightFormat::Q5_1, 1e-2, 6e-2),
        (WeightFormat::Q5K, 1e-2, 6e-2),
        (WeightFormat::Q5_0, 1e-2, 6e-2),
        (WeightFormat::Q4_1, 2e-2, 1e-1),
        (WeightFormat::Q4K, 2e-2, 1e-1),
        (WeightFormat::Q4_0, 2e-2, 1e-1),
        (WeightFormat::Q3K, 5e-2, 2e-1),
    ] {
        let product = Matrix::quantize(&values, outputs, inputs, weight_format)
            .unwrap()
            .forward(&x)
            .unwrap();
        let error = (product - &exact)
            .unwrap()
            .sqr()
            .unwrap()
            .sum_all()
            .unwrap()
            .to_scalar::<f32>()
            .unwrap();
        let relative = (error / size).sqrt();
        assert!(
            (least..most).contains(&relative),
            "{weight_format}: {relative}"
        );
    }
}
