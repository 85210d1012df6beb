//! What this processor can do at most, measured: the bounds of every product with weights.

use crate::matrix::{Instructions, byte_operations};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::hint::black_box;
use std::time::Instant;

/// Runs of each measurement; the fastest counts, which other programs disturbed least.
const RUNS: usize = 10;
/// Rounds of products in a run: some 20 ms.
const ROUNDS: usize = 5_000_000;
/// Numbers of 8 bytes that a run reads: 256 MiB, more than caches hold.
const READ: usize = 32 << 20;
/// Numbers of a plain read that are added at once.
const ADDED: usize = 64;

/// The limits of all threads together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// The instruction set of the kernels.
    pub kernels: String,
    /// Operations a second of 8-bit products whose numbers stay in registers; a product and its
    /// sum are two operations.
    pub operations_per_s: f64,
    /// Bytes a second of a plain read of memory.
    pub read_bytes_per_s: f64,
}

impl Limits {
    /// Measures them on rayon's threads: the best of ten runs each, a third of a second in all.
    pub fn measure() -> Self {
        let numbers = vec![1u64; READ];
        let mut operations = 0;
        let products = fastest(|| {
            let of_threads = rayon::broadcast(|_| byte_operations(ROUNDS));
            operations = of_threads.into_iter().sum::<usize>();
        });
        let read = fastest(|| {
            black_box(plain_read(black_box(&numbers)));
        });
        Self {
            kernels: Instructions::best().name().to_owned(),
            operations_per_s: operations as f64 / products,
            read_bytes_per_s: size_of_val(numbers.as_slice()) as f64 / read,
        }
    }
}

/// Seconds of the fastest run.
fn fastest(mut run: impl FnMut()) -> f64 {
    let times = (0..RUNS).map(|_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    });
    times.fold(f64::INFINITY, f64::min)
}

/// Reads numbers with all threads; returns their sum.
pub fn plain_read(numbers: &[u64]) -> u64 {
    let pieces = 4 * rayon::current_num_threads();
    let parts = numbers.par_chunks(numbers.len().div_ceil(pieces).max(1));
    let sums = parts.map(|part| {
        let mut sums = [0u64; ADDED];
        for numbers in part.chunks(ADDED) {
            let pairs = sums.iter_mut().zip(numbers);
            pairs.for_each(|(sum, number)| *sum = sum.wrapping_add(*number));
        }
        sums.into_iter().fold(0, u64::wrapping_add)
    });
    sums.reduce(|| 0, u64::wrapping_add)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_measured_and_a_plain_read_reads_all_numbers() {
        let limits = Limits::measure();
        assert_eq!(limits.kernels, Instructions::best().name());
        assert!(limits.operations_per_s > 1e6, "{limits:?}");
        assert!(limits.read_bytes_per_s > 1e6, "{limits:?}");
        assert_eq!(plain_read(&[1; 64 * 9]), 64 * 9);
    }
}
