//! Byte products from registers: the bound of every product with quantized weights.

use super::line::{CacheLine, LANES};
use super::simd::{Instructions, Kernel, Simd};
use std::hint::black_box;

/// Multiplies and adds bytes that stay in registers, `rounds` times for each of several sums, on
/// this thread. Returns the operations: two for each product.
pub(crate) fn byte_operations(rounds: usize) -> usize {
    let mut sums = 0;
    Instructions::best().run(ByteOperations {
        rounds,
        sums: &mut sums,
    });
    2 * 4 * LANES * sums * rounds
}

struct ByteOperations<'a> {
    rounds: usize,
    /// Where the number of sums goes.
    sums: &'a mut usize,
}

impl Kernel for ByteOperations<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        // Enough sums that none waits for its last product, as far as registers hold them.
        *self.sums = if S::REGISTERS >= 32 {
            add::<S, 12>(simd, self.rounds)
        } else {
            add::<S, 4>(simd, self.rounds)
        };
    }
}

/// Adds to `N` sums in turn; returns `N`.
#[inline(always)]
fn add<S: Simd, const N: usize>(simd: S, rounds: usize) -> usize {
    let weights = simd.bytes(black_box(&CacheLine([1; 64])));
    let activations = black_box(0x0201_0201);
    let mut sums = [simd.ints(0); N];
    for _ in 0..rounds {
        for sum in &mut sums {
            *sum = simd.dot(*sum, weights, activations);
        }
    }
    for sum in sums {
        black_box(simd.sum(simd.to_floats(sum)));
    }
    N
}
