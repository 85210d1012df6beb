//! Threads that wait for a product read the weights of the next one into their caches.
//!
//! Between two products of a decoder one thread works, and the memory rests. Passes multiply the
//! same matrices in the same order, so the next matrix is most likely the one that came next in the
//! pass before. A wrong guess costs a little of the memory's time and changes no result.
//! Why: docs/decisions/140-read-ahead.md.

use crate::matrix::{CacheLine, Instructions, Kernel, Simd};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Bytes of a cache line.
const LINE: usize = size_of::<CacheLine>();
/// Maximum lines that a thread reads ahead: a quarter of a second-level cache of 1 MiB.
const MAX_LINES: usize = (256 << 10) / LINE;
/// Lines between two looks for work: a fraction of a microsecond.
const LINES_A_LOOK: usize = 16;

/// The place of the matrix that comes next. A thread that sees one half of a change reads lines that
/// nobody needs.
static NEXT: [AtomicUsize; 2] = [AtomicUsize::new(0), AtomicUsize::new(0)];
static ORDER: Mutex<Order> = Mutex::new(Order {
    places: Vec::new(),
    next: 0,
});

/// Where the lines of a matrix lie: address and count. Nothing is read there but into a cache, which
/// ignores an address that no longer exists.
type Place = [usize; 2];

/// A pass begins.
pub(crate) fn begin() {
    announce(Order::begin);
}

/// A matrix is about to be multiplied.
pub(crate) fn multiplied(lines: &[CacheLine]) {
    let place = [lines.as_ptr().addr(), lines.len()];
    announce(|order| order.note(place));
}

/// Announces the place that a change of the order says comes next.
fn announce(change: impl FnOnce(&mut Order) -> Option<Place>) {
    let mut order = ORDER.lock().unwrap_or_else(PoisonError::into_inner);
    let next = change(&mut order).unwrap_or_default();
    for (place, next) in NEXT.iter().zip(next) {
        place.store(next, Ordering::Relaxed);
    }
}

/// The matrices of a pass, in the order of their products.
#[derive(Debug, Default)]
struct Order {
    places: Vec<Place>,
    /// Index of the product that comes next in this pass.
    next: usize,
}

impl Order {
    /// Returns the first matrix of the last pass.
    fn begin(&mut self) -> Option<Place> {
        self.next = 0;
        self.places.first().copied()
    }

    /// Returns the matrix that followed this one in the last pass, if it was like this one so far.
    fn note(&mut self, place: Place) -> Option<Place> {
        if self.places.get(self.next) != Some(&place) {
            self.places.truncate(self.next);
            self.places.push(place);
        }
        self.next += 1;
        self.places.get(self.next).copied()
    }
}

/// A thread that reads ahead.
#[derive(Debug)]
pub(crate) struct Reader {
    /// Its number among the threads of a pool, counted from the one that makes the pass.
    number: usize,
    threads: usize,
    place: Place,
    /// Lines of `place` that are read.
    read: usize,
}

impl Reader {
    /// Thread `here` of a pool whose thread `own` makes the pass.
    pub(crate) fn new(here: usize, own: usize) -> Self {
        let threads = rayon::current_num_threads();
        Self {
            number: (here + threads - own) % threads,
            threads,
            place: [0; 2],
            read: 0,
        }
    }

    /// Starts to read some lines; returns false if none are left.
    pub(crate) fn read(&mut self) -> bool {
        let place = NEXT.each_ref().map(|number| number.load(Ordering::Relaxed));
        let Some(first) = self.next_lines(place) else {
            return false;
        };
        Instructions::best().run(Prefetch(first));
        true
    }

    /// Address of the next [`LINES_A_LOOK`] lines of a place. Threads begin where their shares of a
    /// product do (`matrix/product.rs`).
    fn next_lines(&mut self, place: Place) -> Option<usize> {
        if place != self.place {
            (self.place, self.read) = (place, 0);
        }
        let [address, lines] = place;
        if self.read >= MAX_LINES.min(lines / self.threads) {
            return None;
        }
        let first = lines * self.number / self.threads + self.read;
        self.read += LINES_A_LOOK;
        Some(address + first * LINE)
    }
}

/// Reads [`LINES_A_LOOK`] lines from an address on.
struct Prefetch(usize);

impl Kernel for Prefetch {
    #[inline(always)]
    #[allow(
        clippy::inline_always,
        reason = "kernels must be inlined into the functions that enable the instructions"
    )]
    fn run<S: Simd>(self, simd: S) {
        for line in 0..LINES_A_LOOK {
            simd.prefetch(std::ptr::without_provenance(self.0 + line * LINE));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Place = [1 << 20, 100];
    const B: Place = [2 << 20, 200];
    const C: Place = [3 << 20, 300];

    #[test]
    fn a_pass_like_the_last_one_knows_what_comes_next() {
        let mut order = Order::default();
        assert_eq!(order.begin(), None);
        let first = [A, B, A, C].map(|place| order.note(place));
        assert_eq!(first, [None; 4]);
        assert_eq!(order.begin(), Some(A));
        let again = [A, B, A, C].map(|place| order.note(place));
        assert_eq!(again, [Some(B), Some(A), Some(C), None]);
        // Another way is learned from where it begins.
        assert_eq!(order.begin(), Some(A));
        assert_eq!(
            [A, C, B].map(|place| order.note(place)),
            [Some(B), None, None]
        );
        assert_eq!(order.begin(), Some(A));
        assert_eq!(
            [A, C, B].map(|place| order.note(place)),
            [Some(C), Some(B), None]
        );
    }

    #[test]
    fn a_thread_reads_the_beginning_of_its_share() {
        let reader = |number| Reader {
            number,
            threads: 2,
            place: [0; 2],
            read: 0,
        };
        let all = |reader: &mut Reader, place| {
            std::iter::from_fn(|| reader.next_lines(place)).collect::<Vec<_>>()
        };
        let mut second = reader(1);
        let expected: Vec<_> = (50..100).step_by(LINES_A_LOOK).collect();
        let found = all(&mut second, A);
        assert_eq!(
            found,
            expected
                .iter()
                .map(|line| A[0] + line * LINE)
                .collect::<Vec<_>>()
        );
        assert_eq!(second.next_lines(A), None);
        assert_eq!(second.next_lines(C), Some(C[0] + 150 * LINE));
        let many = all(&mut second, [0, 1 << 20]);
        assert_eq!(many.len(), MAX_LINES / LINES_A_LOOK);
        assert_eq!(reader(1).next_lines([0; 2]), None);
    }
}
