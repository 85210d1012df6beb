//! Speed of the matrix products in every weight format, at shapes of real decoders. One token:
//! bytes of weights a second, beside a plain read of as many bytes by as many threads, in turn. A
//! prompt: operations a second (two for each weight and token), beside those of 8-bit products in
//! registers by as many threads. f32 and f16 are multiplied in f32, so that share says nothing of
//! them.
//!
//! `cargo bench --bench mllm` prints a Markdown table; `-- q4_k 2048` measures the formats and
//! shapes whose names contain one of the words. `RAYON_NUM_THREADS` is the number of threads.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark is no interface and may stop at an error"
)]

use candle_core::{Device, Tensor};
use half::f16;
use mimalloc::MiMalloc;
use planagent_kernels::limits::{Limits, plain_read};
use planagent_mllm::{Matrix, WeightFormat};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// The program's. With others, each result of a prompt is memory that the system has to clear first.
#[global_allocator]
static GLOBAL: MiMalloc = MiMalloc;

/// Outputs and inputs of a matrix: two of a 1.1B and two of a 7B decoder, and Qwen's head.
const SHAPES: [[usize; 2]; 6] = [
    [2048, 2048],
    [11_264, 2048],
    [2048, 5632],
    [22_016, 4096],
    [4096, 11_008],
    [151_936, 1024],
];
/// Tokens of a long prompt and of a short one.
const PROMPTS: [usize; 2] = [512, 64];
/// Bytes of the matrices of a measurement, at least: no cache holds them, as none holds a decoder.
const BYTES: usize = 256 << 20;
/// Time of a measurement.
const TIME: Duration = Duration::from_millis(1500);

fn numbers(count: usize, random: &mut Pcg64Mcg) -> Vec<f32> {
    (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
}

/// A matrix of random blocks; the scales are small, so that products stay finite.
fn matrix(format: WeightFormat, [outputs, inputs]: [usize; 2], random: &mut Pcg64Mcg) -> Matrix {
    let (size, scales): (usize, &[usize]) = match format {
        WeightFormat::F32 => {
            let values = Tensor::from_vec(
                numbers(outputs * inputs, random),
                (outputs, inputs),
                &Device::Cpu,
            );
            return Matrix::from_tensor(&values.unwrap()).unwrap();
        }
        WeightFormat::F16 => (2, &[0]),
        WeightFormat::Q8_0 => (34, &[0]),
        WeightFormat::Q8Of256 => (258, &[0]),
        WeightFormat::Q6K => (210, &[208]),
        WeightFormat::Q5_1 => (24, &[0, 2]),
        WeightFormat::Q5K => (176, &[0, 2]),
        WeightFormat::Q5_0 => (22, &[0]),
        WeightFormat::Q4_1 => (20, &[0, 2]),
        WeightFormat::Q4K => (144, &[0, 2]),
        WeightFormat::Q4_0 | WeightFormat::Iq4Nl => (18, &[0]),
        WeightFormat::Iq4Xs => (136, &[0]),
        WeightFormat::Mxfp4 => (17, &[]),
        WeightFormat::Q3K => (110, &[108]),
    };
    let per_block = match format {
        WeightFormat::F32 | WeightFormat::F16 => 1,
        WeightFormat::Q8Of256
        | WeightFormat::Q6K
        | WeightFormat::Q5K
        | WeightFormat::Q4K
        | WeightFormat::Q3K
        | WeightFormat::Iq4Xs => 256,
        _ => 32,
    };
    let mut bytes = vec![0; outputs * inputs / per_block * size];
    random.fill_bytes(&mut bytes);
    for block in bytes.chunks_exact_mut(size) {
        for at in scales {
            block[*at..at + 2]
                .copy_from_slice(&f16::from_f32(random.random_range(1e-4..1e-3)).to_le_bytes());
        }
    }
    Matrix::from_blocks(format, outputs, inputs, &bytes).unwrap()
}

/// Seconds of the fastest run: the one that other programs disturbed least.
struct Fastest(f64);

impl Fastest {
    fn measure(&mut self, run: impl FnOnce()) {
        let start = Instant::now();
        run();
        self.0 = self.0.min(start.elapsed().as_secs_f64());
    }
}

fn measure(format: WeightFormat, shape: [usize; 2], peak: f64) {
    let random = &mut Pcg64Mcg::seed_from_u64(1);
    let [outputs, inputs] = shape;
    let first = matrix(format, shape, random);
    let copies = BYTES.div_ceil(first.bytes());
    let matrices: Vec<Matrix> = std::iter::once(first)
        .chain((1..copies).map(|_| matrix(format, shape, random)))
        .collect();
    let bytes: usize = matrices.iter().map(Matrix::bytes).sum();
    let words = vec![1u64; bytes / size_of::<u64>()];
    let x = |tokens: usize, random: &mut Pcg64Mcg| {
        Tensor::from_vec(
            numbers(tokens * inputs, random),
            (tokens, inputs),
            &Device::Cpu,
        )
        .unwrap()
    };
    let token = x(1, random);
    let (mut product, mut plain) = (Fastest(f64::MAX), Fastest(f64::MAX));
    let start = Instant::now();
    while start.elapsed() < TIME {
        product.measure(|| {
            for matrix in &matrices {
                drop(black_box(matrix.forward(&token).unwrap()));
            }
        });
        plain.measure(|| {
            black_box(plain_read(black_box(&words)));
        });
    }
    let [long, short] = PROMPTS.map(|tokens| {
        let (prompt, mut many) = (x(tokens, random), Fastest(f64::MAX));
        let start = Instant::now();
        while start.elapsed() < TIME {
            many.measure(|| drop(black_box(matrices[0].forward(&prompt).unwrap())));
        }
        (2 * outputs * inputs * tokens) as f64 / many.0
    });
    println!(
        "| {outputs} x {inputs} | {format} | {:.1} | {:.1} | {:.2} | {:.2} | {:.0} % | {:.0} % |",
        bytes as f64 / product.0 / 1e9,
        bytes as f64 / plain.0 / 1e9,
        plain.0 / product.0,
        long / 1e12,
        100.0 * long / peak,
        100.0 * short / peak,
    );
}

fn main() {
    // cargo passes `--bench`.
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    let peak = Limits::measure().operations_per_s;
    println!(
        "8-bit products in registers, {} threads: {:.2} TOP/s\n",
        rayon::current_num_threads(),
        peak / 1e12
    );
    let [long, short] = PROMPTS;
    println!(
        "| shape | format | one token, GB/s | plain read, GB/s | ratio | {long} tokens, TOP/s | of registers | {short} tokens, of registers |"
    );
    println!("|---|---|---:|---:|---:|---:|---:|---:|");
    // The products run in a thread of the pool, as those of the program do.
    rayon::scope(|_| {
        for shape in SHAPES {
            for format in WeightFormat::ALL.into_iter().chain([WeightFormat::Q8Of256]) {
                let name = format!("{} x {} {format}", shape[0], shape[1]);
                if wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str())) {
                    measure(format, shape, peak);
                }
            }
        }
    });
}
