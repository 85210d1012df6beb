//! The work of products, counted, so that a bench can say which share of a limit it reaches.

use serde::{Deserialize, Serialize};
use std::ops::{AddAssign, Sub};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

static OPERATIONS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicU64 = AtomicU64::new(0);

/// The work of matrix products and attention. Norms, activations and additions are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Work {
    /// Multiplications and additions.
    pub operations: u64,
    /// Bytes of weights, keys and values, each as often as a product needs it.
    pub bytes: u64,
}

impl Work {
    /// The work of this process so far, in all threads.
    pub fn so_far() -> Self {
        Self {
            operations: OPERATIONS.load(Relaxed),
            bytes: BYTES.load(Relaxed),
        }
    }

    /// Counts a product of `rows` rows of `inputs` numbers with `outputs` columns of `bytes`.
    pub(crate) fn count(rows: usize, inputs: usize, outputs: usize, bytes: usize) {
        let operations = 2 * rows as u64 * inputs as u64 * outputs as u64;
        OPERATIONS.fetch_add(operations, Relaxed);
        BYTES.fetch_add(bytes as u64, Relaxed);
    }
}

impl Sub for Work {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        Self {
            operations: self.operations.saturating_sub(before.operations),
            bytes: self.bytes.saturating_sub(before.bytes),
        }
    }
}

impl AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.operations += other.operations;
        self.bytes += other.bytes;
    }
}
