//! Attention compared with plain sums in f64.

use super::key_values::BLOCK_POSITIONS;
use super::rounded::mix_rounded;
use super::{
    AttentionMask, HeadShape, KeyValues, Precision, Projected, Rope, RotaryEmbedding, attend,
    attend_rounded, mix,
};
use crate::matrix::Instructions;
use candle_core::{DType, Device, Tensor};
use half::f16;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

/// Random projections of tokens, between ±`scale`.
fn projections(tokens: usize, shape: HeadShape, scale: f32, seed: u64) -> Tensor {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let values: Vec<f32> = (0..tokens * shape.row())
        .map(|_| random.random_range(-scale..scale))
        .collect();
    Tensor::from_vec(values, (tokens, shape.row()), &Device::Cpu).unwrap()
}

fn with<T>(tensor: &Tensor, shape: HeadShape, use_rows: impl FnOnce(&Projected<'_>) -> T) -> T {
    Projected::read(tensor, shape, None, |rows| Ok(use_rows(rows))).unwrap()
}

/// Keys and values of tokens.
fn held(tensor: &Tensor, shape: HeadShape, precision: Precision) -> KeyValues {
    let mut held = KeyValues::new(shape, precision);
    with(tensor, shape, |rows| held.write(rows, 0)).unwrap();
    held
}

/// The definition: masked softmax(q kᵀ / √width) v of the last `tokens` rows.
fn plain(
    all: &Tensor,
    shape: HeadShape,
    tokens: usize,
    precision: Precision,
    mask: AttentionMask<'_>,
) -> Vec<f32> {
    let rounded = |value: &f32| match precision {
        Precision::Single => f64::from(*value),
        Precision::Half => f16::from_f32(*value).to_f64(),
    };
    let dot = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| f64::from(*a) * rounded(b))
            .sum::<f64>()
    };
    with(all, shape, |rows| {
        let mut out = Vec::new();
        for token in 0..tokens {
            for head in 0..shape.query_heads {
                let key_head = head / shape.group();
                let queries = rows.queries(rows.tokens() - tokens + token, key_head);
                let query = &queries[head % shape.group() * shape.width..][..shape.width];
                let seen = mask.seen_by(token);
                let scores: Vec<f64> = seen
                    .clone()
                    .map(|position| {
                        dot(query, rows.key(position, key_head)) / (shape.width as f64).sqrt()
                    })
                    .collect();
                let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let weights: Vec<f64> = scores.iter().map(|score| (score - most).exp()).collect();
                let total: f64 = weights.iter().sum();
                for channel in 0..shape.width {
                    let values = seen
                        .clone()
                        .map(|position| rounded(&rows.value(position, key_head)[channel]));
                    let sum: f64 = weights
                        .iter()
                        .zip(values)
                        .map(|(weight, value)| weight * value)
                        .sum();
                    out.push((sum / total) as f32);
                }
            }
        }
        out
    })
}

fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(found, expected)| (found - expected).abs())
        .fold(0.0, f32::max)
}

/// Largest deviation from the definition in any instruction set, for the last `tokens` of
/// `positions` rows.
fn deviations(
    shape: HeadShape,
    tokens: usize,
    positions: usize,
    scale: f32,
    causal: bool,
    window: Option<usize>,
) -> f32 {
    let mask = if causal {
        AttentionMask::Causal {
            start: positions - tokens,
            window,
        }
    } else {
        AttentionMask::All { positions }
    };
    deviations_by(shape, tokens, positions, scale, mask)
}

/// As [`deviations`], by any mask.
fn deviations_by(
    shape: HeadShape,
    tokens: usize,
    positions: usize,
    scale: f32,
    mask: AttentionMask<'_>,
) -> f32 {
    let all = projections(positions, shape, scale, positions as u64);
    let last = all.narrow(0, positions - tokens, tokens).unwrap();
    let mut most = 0f32;
    for precision in [Precision::Single, Precision::Half] {
        let held = held(&all, shape, precision);
        let expected = plain(&all, shape, tokens, precision, mask);
        for instructions in Instructions::available() {
            let found = with(&last, shape, |rows| mix(rows, &held, mask, instructions));
            most = most.max(difference(&found, &expected) / scale);
        }
    }
    most
}

#[test]
fn tokens_of_a_block_see_one_another_and_no_other_token_sees_further() {
    let mask = |window| AttentionMask::CausalWithBlocks {
        start: 10,
        window,
        blocks: &[[12, 15], [16, 18]],
    };
    let seen = |window| [1, 2, 4, 5, 6, 8].map(|token| mask(window).seen_by(token));
    assert_eq!(seen(None), [0..12, 0..15, 0..15, 0..16, 0..18, 0..19]);
    assert_eq!(
        seen(Some(3)),
        [9..12, 10..15, 12..15, 13..16, 14..18, 16..19]
    );
    let shape = HeadShape {
        query_heads: 4,
        key_heads: 2,
        width: 24,
    };
    for (tokens, before, blocks, window) in [
        (90, 30, &[[3, 70]][..], None),
        (90, 30, &[[3, 70]], Some(20)),
        (90, 30, &[[3, 40], [40, 61], [64, 90]], None),
        (90, 30, &[[3, 40], [40, 61], [64, 90]], Some(20)),
        (12, 100, &[[0, 12]], Some(5)),
        (250, 0, &[[100, 250]], Some(64)),
        (3, 40, &[[1, 2]], None),
        (3, 40, &[], None),
    ] {
        let moved: Vec<[usize; 2]> = blocks
            .iter()
            .map(|block| block.map(|row| before + row))
            .collect();
        let mask = AttentionMask::CausalWithBlocks {
            start: before,
            window,
            blocks: &moved,
        };
        let found = deviations_by(shape, tokens, before + tokens, 1.0, mask);
        assert!(found < 5e-6, "{tokens} tokens, {blocks:?}: {found}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn attention_is_what_its_definition_says(
        group in 1usize..9, key_heads in 1usize..3, width in 1usize..50, tokens in 1usize..30, before in 0usize..180,
        causal: bool, window in proptest::option::of(1usize..200), large: bool,
    ) {
        let shape = HeadShape { query_heads: group * key_heads, key_heads, width };
        // Scores of hundreds overflow unless the maximum score is subtracted.
        let scale = if large { 20.0 } else { 1.0 };
        let found = deviations(shape, tokens, before + tokens, scale, causal, window);
        prop_assert!(found < if large { 2e-4 } else { 5e-6 }, "{found}");
    }
}

#[test]
fn long_and_wide_attentions_are_what_their_definition_says() {
    let shape = |query_heads, key_heads, width| HeadShape {
        query_heads,
        key_heads,
        width,
    };
    for (shape, tokens, positions, causal, window) in [
        (shape(4, 2, 64), 1, 1100, true, None),
        (shape(1, 1, 112), 150, 150, false, None),
        (shape(1, 1, 128), 230, 230, true, Some(70)),
        (shape(8, 1, 80), 30, 300, true, None),
    ] {
        let found = deviations(shape, tokens, positions, 1.0, causal, window);
        assert!(found < 5e-6, "{shape:?}: {found}");
    }
}

#[test]
fn any_thread_count_gives_the_same_bits() {
    let shape = HeadShape {
        query_heads: 8,
        key_heads: 2,
        width: 64,
    };
    let all = projections(2200, shape, 1.0, 1);
    let held = held(&all, shape, Precision::Half);
    for tokens in [1, 5, 120] {
        let last = all.narrow(0, 2200 - tokens, tokens).unwrap();
        let mask = AttentionMask::Causal {
            start: 2200 - tokens,
            window: None,
        };
        let found = [1, 2, 3, 7].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| with(&last, shape, |rows| attend(rows, &held, mask).unwrap()))
        });
        let bits = found.map(|tensor| {
            let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
            values.into_iter().map(f32::to_bits).collect::<Vec<_>>()
        });
        assert!(
            bits.iter().all(|other| *other == bits[0]),
            "{tokens} tokens"
        );
    }
}

#[test]
fn a_copy_shares_memory_until_it_is_written_to() {
    let shape = HeadShape {
        query_heads: 2,
        key_heads: 1,
        width: 16,
    };
    let (first, second) = (
        projections(100, shape, 1.0, 2),
        projections(30, shape, 1.0, 3),
    );
    let original = held(&first, shape, Precision::Single);
    let mut copy = original.clone();
    with(&second, shape, |rows| copy.write(rows, 90)).unwrap();
    let question = projections(1, shape, 1.0, 4);
    let ask = |held: &KeyValues, positions| -> Vec<f32> {
        with(&question, shape, |rows| {
            attend(rows, held, AttentionMask::All { positions }).unwrap()
        })
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap()
    };
    assert_eq!(
        ask(&original, 100),
        ask(&held(&first, shape, Precision::Single), 100)
    );
    let both = Tensor::cat(&[&first.narrow(0, 0, 90).unwrap(), &second], 0).unwrap();
    assert_eq!(
        ask(&copy, 120),
        ask(&held(&both, shape, Precision::Single), 120)
    );
    let shared = |index: usize| match (&original.blocks, &copy.blocks) {
        (super::Blocks::Single(a), super::Blocks::Single(b)) => {
            std::sync::Arc::ptr_eq(&a[index], &b[index])
        }
        _ => panic!("of single precision"),
    };
    assert_eq!((shared(0), shared(90 / BLOCK_POSITIONS)), (true, false));
}

#[test]
fn nan_appears_in_the_result() {
    let shape = HeadShape {
        query_heads: 2,
        key_heads: 1,
        width: 16,
    };
    for part in [0, 2, 3] {
        let mut values: Vec<f32> = projections(70, shape, 1.0, 5)
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        values[66 * shape.row() + part * shape.width] = f32::NAN;
        let all = Tensor::from_vec(values, (70, shape.row()), &Device::Cpu).unwrap();
        let held = held(&all, shape, Precision::Single);
        let mask = AttentionMask::Causal {
            start: 0,
            window: None,
        };
        for instructions in Instructions::available() {
            let found = with(&all, shape, |rows| mix(rows, &held, mask, instructions));
            let own = &found[66 * 32..67 * 32];
            assert!(
                own.iter().any(|value| value.is_nan()),
                "{instructions:?}, {part}"
            );
        }
    }
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let shape = HeadShape {
        query_heads: 2,
        key_heads: 1,
        width: 16,
    };
    let other = HeadShape {
        width: 32,
        query_heads: 1,
        ..shape
    };
    let rows = projections(3, shape, 1.0, 6);
    let of = |tensor: &Tensor, shape| Projected::read(tensor, shape, None, |_| Ok(()));
    assert!(of(&rows, HeadShape { width: 17, ..shape }).is_err());
    assert!(of(&rows.t().unwrap().contiguous().unwrap().t().unwrap(), shape).is_err());
    assert!(of(&rows.to_dtype(DType::F64).unwrap(), shape).is_err());
    let held = held(&rows, shape, Precision::Single);
    with(&rows, shape, |rows| {
        assert!(
            attend(
                rows,
                &held,
                AttentionMask::All {
                    positions: BLOCK_POSITIONS
                }
            )
            .is_ok()
        );
        assert!(
            attend(
                rows,
                &held,
                AttentionMask::All {
                    positions: BLOCK_POSITIONS + 1
                }
            )
            .is_err()
        );
        assert!(
            attend(
                rows,
                &KeyValues::new(other, Precision::Half),
                AttentionMask::All { positions: 0 }
            )
            .is_err()
        );
        assert!(
            KeyValues::new(other, Precision::Half)
                .write(rows, 0)
                .is_err()
        );
    });
    let context = 2048;
    let table = RotaryEmbedding::new(&Rope::default(), 16, context);
    assert!(table.rows(&[[0, context as u32, 0]], 0).is_err());
    let angles = table.rows(&[[0; 3], [1; 3]], 0).unwrap();
    assert!(Projected::read(&rows, shape, Some(&angles), |_| Ok(())).is_err());
}

#[test]
fn rounded_attention_is_near_the_definition_and_its_sums_are_exact() {
    // Widths of towers, an odd one, and more positions than a block; groups of query heads too.
    for (width, heads, groups, tokens) in [
        (64, 2, 1, 130),
        (72, 1, 1, 64),
        (80, 2, 1, 7),
        (15, 3, 1, 65),
        (128, 1, 2, 1),
    ] {
        let shape = HeadShape {
            query_heads: heads * groups,
            key_heads: heads,
            width,
        };
        let all = projections(tokens, shape, 2.0, tokens as u64);
        let mask = AttentionMask::All { positions: tokens };
        let expected = plain(&all, shape, tokens, Precision::Single, mask);
        for instructions in Instructions::available() {
            let found = with(&all, shape, |rows| mix_rounded(rows, instructions));
            let apart = difference(&found, &expected);
            assert!(
                apart < 1.5e-3,
                "{shape:?}, {tokens} tokens, {instructions:?}: {apart}"
            );
        }
    }
}

#[test]
fn rounded_attention_passes_on_what_is_not_finite_and_takes_zeros() {
    let shape = HeadShape {
        query_heads: 1,
        key_heads: 1,
        width: 16,
    };
    let zeros = Tensor::zeros((3, shape.row()), DType::F32, &Device::Cpu).unwrap();
    let out = with(&zeros, shape, attend_rounded).unwrap();
    assert_eq!(out.to_vec2::<f32>().unwrap(), vec![vec![0.0; 16]; 3]);
    let large = (&zeros + 1e30).unwrap();
    let in_f32 = with(&large, shape, |rows| {
        mix(
            rows,
            &held(&large, shape, Precision::Single),
            AttentionMask::All { positions: 3 },
            Instructions::best(),
        )
    });
    let out = with(&large, shape, attend_rounded).unwrap();
    let out = out.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    let bits = |values: &[f32]| {
        values
            .iter()
            .map(|value| value.to_bits())
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(&out), bits(&in_f32));
    let broken = (zeros + f64::NAN).unwrap();
    let out = with(&broken, shape, attend_rounded).unwrap();
    assert!(
        out.flatten_all()
            .unwrap()
            .to_vec1::<f32>()
            .unwrap()
            .iter()
            .all(|v| v.is_nan())
    );
}
