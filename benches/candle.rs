//! Our products and attention beside candle's, at the shapes of a decoder layer of nano, of a 1.1B
//! and of a 7B model, for a prompt of 512 tokens and for one token. Both sides take turns in one
//! process and get the same weights and inputs.
//!
//! `cargo bench --bench candle` prints the Markdown table of `docs/decisions/003-own-kernels.md`
//! (about 3 minutes on two cores). `cargo bench --bench candle -- nano` measures the models whose
//! names contain `nano`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark is no interface and may stop at an error"
)]

use candle_core::quantized::{GgmlDType, QMatMul, QStorage, QTensor};
use candle_core::{DType, Device, Module, Tensor};
use candle_nn::attention::{AttnMask, flash_attn};
use half::f16;
use planagent_kernels::attention::AttentionProbe;
use planagent_mllm::{Matrix, WeightFormat};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::borrow::Cow;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The decoder of a model.
struct Shape {
    name: &'static str,
    hidden: usize,
    intermediate: usize,
    /// Query heads, key heads, head width.
    heads: [usize; 3],
}

const SHAPES: [Shape; 3] = [
    Shape {
        name: "nano",
        hidden: 192,
        intermediate: 512,
        heads: [3, 3, 64],
    },
    Shape {
        name: "1.1B",
        hidden: 2048,
        intermediate: 5632,
        heads: [32, 4, 64],
    },
    Shape {
        name: "7B",
        hidden: 4096,
        intermediate: 11_008,
        heads: [32, 32, 128],
    },
];
/// Tokens of a prompt, and of a decoding step.
const TOKENS: [usize; 2] = [512, 1];
/// Positions that the attention of a decoding step reads.
const DECODE_POSITIONS: usize = 2048;
/// Pairs of runs: at least the first number, then more until the time is used up or the second
/// number is reached.
const PAIRS: [usize; 2] = [3, 21];
const TIME: Duration = Duration::from_millis(1500);
/// Largest accepted difference of the two results, relative to the largest value: both round
/// activations to 8 bits.
const MAX_DIFFERENCE: f32 = 0.03;

/// Times of our side and of candle's, milliseconds, pair by pair.
#[derive(Default)]
struct Pairs(Vec<[f64; 2]>);

impl Pairs {
    fn measure(mut ours: impl FnMut() -> Tensor, mut candle: impl FnMut() -> Tensor) -> Self {
        let largest = |tensor: &Tensor| -> f32 {
            tensor
                .abs()
                .unwrap()
                .flatten_all()
                .unwrap()
                .max(0)
                .unwrap()
                .to_scalar()
                .unwrap()
        };
        let expected = candle().to_dtype(DType::F32).unwrap();
        let found = ours();
        let difference = largest(&(&found - &expected).unwrap()) / largest(&expected);
        assert!(
            difference < MAX_DIFFERENCE,
            "the results differ by {difference}"
        );
        let milliseconds = |run: &mut dyn FnMut() -> Tensor| {
            let start = Instant::now();
            black_box(run());
            start.elapsed().as_secs_f64() * 1e3
        };
        let (start, mut pairs) = (Instant::now(), Vec::new());
        while pairs.len() < PAIRS[0] || pairs.len() < PAIRS[1] && start.elapsed() < TIME {
            // The order changes, so that a drift of the clock rate favors neither side.
            let first_ours = pairs.len() % 2 == 0;
            let early = if first_ours {
                milliseconds(&mut ours)
            } else {
                milliseconds(&mut candle)
            };
            let late = if first_ours {
                milliseconds(&mut candle)
            } else {
                milliseconds(&mut ours)
            };
            pairs.push(if first_ours {
                [early, late]
            } else {
                [late, early]
            });
        }
        Self(pairs)
    }

    /// Adds the times of another operation, pair by pair.
    fn add(&mut self, other: Self) {
        if self.0.is_empty() {
            *self = other;
        } else {
            self.0
                .iter_mut()
                .zip(other.0)
                .for_each(|(sum, [ours, candle])| *sum = [sum[0] + ours, sum[1] + candle]);
        }
    }

    fn print(&self, model: &str, tokens: usize, what: &str) {
        let sorted = |of: &dyn Fn(&[f64; 2]) -> f64| {
            let mut values: Vec<f64> = self.0.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let median = |of: &dyn Fn(&[f64; 2]) -> f64| sorted(of)[self.0.len() / 2];
        let ratios = sorted(&|pair| pair[1] / pair[0]);
        println!(
            "| {model} | {tokens} | {what} | {:.3} | {:.3} | {:.2} ({:.2} to {:.2}) |",
            median(&|pair| pair[0]),
            median(&|pair| pair[1]),
            ratios[ratios.len() / 2],
            ratios[0],
            ratios[ratios.len() - 1]
        );
    }
}

fn numbers(count: usize, random: &mut Pcg64Mcg) -> Vec<f32> {
    (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
}

/// Random blocks of a weight format; the scales are small, so that products stay finite.
fn blocks(format: WeightFormat, count: usize, random: &mut Pcg64Mcg) -> Vec<u8> {
    let (numbers, bytes, scales): (usize, usize, &[usize]) = match format {
        WeightFormat::Q8_0 => (32, 34, &[0]),
        _ => (256, 144, &[0, 2]),
    };
    let mut blocks = vec![0; count / numbers * bytes];
    random.fill_bytes(&mut blocks);
    for block in blocks.chunks_exact_mut(bytes) {
        for at in scales {
            block[*at..at + 2]
                .copy_from_slice(&f16::from_f32(random.random_range(1e-4..1e-3)).to_le_bytes());
        }
    }
    blocks
}

/// Measures one product in one weight format.
fn product(format: WeightFormat, [outputs, inputs]: [usize; 2], tokens: usize) -> Pairs {
    let random = &mut Pcg64Mcg::seed_from_u64(1);
    let x = Tensor::from_vec(
        numbers(tokens * inputs, random),
        (tokens, inputs),
        &Device::Cpu,
    )
    .unwrap();
    let same = x.clone();
    let (matrix, candle): (Matrix, Box<dyn Fn() -> Tensor>) = if format == WeightFormat::F32 {
        let weights = Tensor::from_vec(
            numbers(outputs * inputs, random),
            (outputs, inputs),
            &Device::Cpu,
        )
        .unwrap();
        // The layout and the call of `candle_nn::Linear`.
        (
            Matrix::from_tensor(&weights).unwrap(),
            Box::new(move || same.matmul(&weights.t().unwrap()).unwrap()),
        )
    } else {
        let dtype = if format == WeightFormat::Q8_0 {
            GgmlDType::Q8_0
        } else {
            GgmlDType::Q4K
        };
        let bytes = blocks(format, outputs * inputs, random);
        let storage = QStorage::from_data(Cow::Borrowed(&bytes), &Device::Cpu, dtype).unwrap();
        let weights =
            QMatMul::from_arc(Arc::new(QTensor::new(storage, (outputs, inputs)).unwrap())).unwrap();
        let matrix = Matrix::from_blocks(format, outputs, inputs, &bytes).unwrap();
        (matrix, Box::new(move || weights.forward(&same).unwrap()))
    };
    Pairs::measure(|| matrix.forward(&x).unwrap(), candle)
}

/// All products of a decoder layer in one weight format; `None` if the format cannot hold one of
/// the matrices.
fn products(shape: &Shape, format: WeightFormat, tokens: usize) -> Option<Pairs> {
    let [query_heads, key_heads, width] = shape.heads;
    let (hidden, intermediate) = (shape.hidden, shape.intermediate);
    let matrices = [
        [(query_heads + 2 * key_heads) * width, hidden],
        [hidden, query_heads * width],
        [2 * intermediate, hidden],
        [hidden, intermediate],
    ];
    if !matrices
        .iter()
        .all(|[outputs, inputs]| Matrix::fits(format, *outputs, *inputs))
    {
        return None;
    }
    let mut sum = Pairs::default();
    for matrix in matrices {
        sum.add(product(format, matrix, tokens));
    }
    Some(sum)
}

/// Queries, keys and values in candle's layout, (1, positions, heads, head width).
struct Separate {
    queries: Tensor,
    keys: Tensor,
    values: Tensor,
    scale: f32,
    offset: usize,
}

impl Separate {
    fn new(
        all: &Tensor,
        [query_heads, key_heads, width]: [usize; 3],
        tokens: usize,
        dtype: DType,
    ) -> Self {
        let positions = all.dim(0).unwrap();
        let part = |first: usize, heads: usize, rows: std::ops::Range<usize>| {
            let part = all
                .narrow(1, first * width, heads * width)
                .unwrap()
                .narrow(0, rows.start, rows.len())
                .unwrap();
            part.reshape((1, rows.len(), heads, width))
                .unwrap()
                .to_dtype(dtype)
                .unwrap()
                .contiguous()
                .unwrap()
        };
        Self {
            queries: part(0, query_heads, positions - tokens..positions),
            keys: part(query_heads, key_heads, 0..positions),
            values: part(query_heads + key_heads, key_heads, 0..positions),
            scale: 1.0 / (width as f32).sqrt(),
            offset: positions - tokens,
        }
    }

    fn flash(&self) -> Tensor {
        let Self {
            queries,
            keys,
            values,
            scale,
            offset,
        } = self;
        let mask = AttnMask::causal_with_offset(*offset);
        let out = match queries.dtype() {
            DType::F16 => flash_attn::<f16>(queries, keys, values, *scale, mask, None, None),
            _ => flash_attn::<f32>(queries, keys, values, *scale, mask, None, None),
        };
        rows(&out.unwrap().transpose(1, 2).unwrap())
    }

    /// softmax(Q Kᵀ) V by products of whole matrices, as candle-transformers' Llama computes it.
    fn plain(&self, mask: &Tensor) -> Tensor {
        let heads = |tensor: &Tensor| tensor.transpose(1, 2).unwrap().contiguous().unwrap();
        let group = self.queries.dim(2).unwrap() / self.keys.dim(2).unwrap();
        let repeated =
            |tensor: &Tensor| candle_transformers::utils::repeat_kv(heads(tensor), group).unwrap();
        let (keys, values) = (repeated(&self.keys), repeated(&self.values));
        let scores = heads(&self.queries).matmul(&keys.t().unwrap()).unwrap();
        let scores = (scores * f64::from(self.scale))
            .unwrap()
            .broadcast_add(mask)
            .unwrap();
        let weights = candle_nn::ops::softmax_last_dim(&scores).unwrap();
        rows(
            &weights
                .matmul(&values.contiguous().unwrap())
                .unwrap()
                .transpose(1, 2)
                .unwrap(),
        )
    }
}

/// (1, tokens, heads, head width) as (tokens, heads · head width).
fn rows(tensor: &Tensor) -> Tensor {
    tensor
        .squeeze(0)
        .unwrap()
        .contiguous()
        .unwrap()
        .flatten_from(1)
        .unwrap()
}

fn attention(shape: &Shape, tokens: usize) {
    let [query_heads, key_heads, width] = shape.heads;
    let positions = if tokens == 1 {
        DECODE_POSITIONS
    } else {
        tokens
    };
    let row = (query_heads + 2 * key_heads) * width;
    let values = numbers(positions * row, &mut Pcg64Mcg::seed_from_u64(2));
    let all = Tensor::from_vec(values, (positions, row), &Device::Cpu).unwrap();
    let ours = |half| AttentionProbe::new(&all, shape.heads, tokens, half).unwrap();
    let (single, half) = (ours(false), ours(true));
    let separate = Separate::new(&all, shape.heads, tokens, DType::F32);
    let separate_half = Separate::new(&all, shape.heads, tokens, DType::F16);
    let hidden = |token: usize, position: usize| position > positions - tokens + token;
    let mask: Vec<f32> = (0..tokens)
        .flat_map(|token| {
            (0..positions).map(move |at| {
                if hidden(token, at) {
                    f32::NEG_INFINITY
                } else {
                    0.0
                }
            })
        })
        .collect();
    let mask = Tensor::from_vec(mask, (tokens, positions), &Device::Cpu).unwrap();
    let over = format!("over {positions}");
    Pairs::measure(|| single.run().unwrap(), || separate.flash()).print(
        shape.name,
        tokens,
        &format!("attention {over}, f32, beside `flash_attn`"),
    );
    Pairs::measure(|| half.run().unwrap(), || separate_half.flash()).print(
        shape.name,
        tokens,
        &format!("attention {over}, f16, beside `flash_attn`"),
    );
    Pairs::measure(|| single.run().unwrap(), || separate.plain(&mask)).print(
        shape.name,
        tokens,
        &format!("attention {over}, f32, beside products"),
    );
}

fn main() {
    // cargo passes `--bench`.
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    println!("| model | tokens | operation | ours, ms | candle, ms | candle / ours |");
    println!("|---|---:|---|---:|---:|---:|");
    for shape in SHAPES {
        if !wanted.is_empty() && !wanted.iter().any(|name| shape.name.contains(name.as_str())) {
            continue;
        }
        for tokens in TOKENS {
            for format in [WeightFormat::F32, WeightFormat::Q8_0, WeightFormat::Q4K] {
                if let Some(pairs) = products(&shape, format, tokens) {
                    pairs.print(
                        shape.name,
                        tokens,
                        &format!("products of a layer, {format}"),
                    );
                }
            }
            attention(&shape, tokens);
        }
    }
}
