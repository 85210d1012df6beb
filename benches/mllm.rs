//! Speed of the matrix products: the two wide matrices of a layer of a 1.1B and of a 7B model in every weight format. A prompt
//! of 512 tokens gives operations a second (two for each weight and token), one token bytes of weights a second. `cargo bench
//! --bench mllm`.
#![allow(missing_docs, clippy::unwrap_used, reason = "a benchmark is no interface and may stop at an error")]

use std::hint::black_box;

use candle_core::{Device, Tensor};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use planagent::internals::mllm::{Matrix, WeightFormat};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Name, outputs and inputs of a matrix.
const SHAPES: [(&str, usize, usize); 4] = [
    ("1.1B gate and up", 11_264, 2048),
    ("1.1B down", 2048, 5632),
    ("7B gate and up", 22_016, 4096),
    ("7B down", 4096, 11_008),
];
/// Tokens of the prompt.
const PROMPT: usize = 512;

fn numbers(count: usize) -> Vec<f32> {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
}

fn products(criterion: &mut Criterion) {
    for weight_format in WeightFormat::ALL {
        for (name, outputs, inputs) in SHAPES {
            let matrix = Matrix::quantize(&numbers(outputs * inputs), outputs, inputs, weight_format).unwrap();
            let mut group = criterion.benchmark_group(format!("{weight_format} {name}"));
            group.sample_size(10);
            for tokens in [PROMPT, 1] {
                let x = Tensor::from_vec(numbers(tokens * inputs), (tokens, inputs), &Device::Cpu).unwrap();
                group.throughput(if tokens == 1 {
                    Throughput::Bytes(matrix.bytes() as u64)
                } else {
                    Throughput::Elements(2 * (outputs * inputs * tokens) as u64)
                });
                group.bench_function(format!("{tokens} tokens"), |bencher| {
                    bencher.iter(|| matrix.forward(black_box(&x)).unwrap());
                });
            }
            group.finish();
        }
    }
}

criterion_group!(benches, products);
criterion_main!(benches);
