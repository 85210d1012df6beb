//! Byte products from registers: the bound of every product with quantized weights.

use super::line::{CacheLine, LANES};
use super::simd::{Instructions, Kernel, Simd};
use std::hint::black_box;

/// Steps of a run of 32 numbers: sums of bytes are widened after them.
const STEPS: usize = 8;
/// Vectors of weights.
const WEIGHTS: usize = 3;

/// Multiplies and adds bytes that stay in registers, `rounds` times for each of several sums, on
/// this thread; `rounds` is a multiple of [`STEPS`]. Returns the operations: two for each product.
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
            add::<S, 3>(simd, self.rounds)
        };
    }
}

/// Adds to `N` sums in turn; returns `N`.
#[inline(always)]
fn add<S: Simd, const N: usize>(simd: S, rounds: usize) -> usize {
    // Different weights and activations, so that the compiler computes no product once for several
    // sums or rounds.
    let mut weights = [simd.bytes(&CacheLine::ZERO); WEIGHTS];
    for weights in &mut weights {
        *weights = simd.bytes(black_box(&CacheLine([1; 64])));
    }
    let mut activations = [0x0201_0201; STEPS];
    let mut sums = [simd.ints(0); N];
    for _ in 0..rounds / STEPS {
        let activations = black_box(&mut activations);
        let mut products = [simd.begin_dots(simd.ints(0)); N];
        for (products, sum) in products.iter_mut().zip(sums) {
            *products = simd.begin_dots(sum);
        }
        for activations in activations {
            for (index, products) in products.iter_mut().enumerate() {
                *products = simd.dot(*products, weights[index % WEIGHTS], *activations);
            }
        }
        for (sum, products) in sums.iter_mut().zip(products) {
            *sum = simd.end_dots(*sum, products);
        }
    }
    for sum in sums {
        black_box(simd.sum(simd.to_floats(sum)));
    }
    N
}
