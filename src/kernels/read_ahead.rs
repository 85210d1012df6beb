//! Threads that wait for a product read the weights of the next one into their caches.
//!
//! Between two products of a decoder one thread works, and the memory rests. Passes multiply the
//! same matrices in the same order, so the next matrix is most likely the one that came next in the
//! pass before. A wrong guess costs a little of the memory's time and changes no result.
//! Why: docs/decisions/140-read-ahead.md.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Maximum bytes that a thread reads ahead: a quarter of a second-level cache of 1 MiB.
const MAX_BYTES: usize = 256 << 10;
/// Bytes between two looks for work: a fraction of a microsecond.
const BYTES_A_LOOK: usize = 1 << 10;

/// The place of the matrix that comes next. A thread that sees one half of a change reads what
/// nobody needs.
static NEXT: [AtomicUsize; 2] = [AtomicUsize::new(0), AtomicUsize::new(0)];
static ORDER: Mutex<Order> = Mutex::new(Order {
    places: Vec::new(),
    next: 0,
});

/// Starts to read the bytes at a range of addresses into a cache. An address that no longer exists is
/// ignored.
pub(crate) type Prefetch = fn(Range<usize>);
/// That of this processor, which the first product names.
static PREFETCH: OnceLock<Prefetch> = OnceLock::new();

/// Where the weights of a matrix lie: address and bytes.
type Place = [usize; 2];
const NOWHERE: Place = [0; 2];

/// A pass begins.
pub(crate) fn begin() {
    announce(Order::begin);
}

/// A matrix of these weights is about to be multiplied.
pub(crate) fn multiplied<T>(weights: &[T], prefetch: Prefetch) {
    PREFETCH.get_or_init(|| prefetch);
    let place = [weights.as_ptr().addr(), size_of_val(weights)];
    announce(|order| order.note(place));
}

/// Announces the place that a change of the order says comes next.
fn announce(change: impl FnOnce(&mut Order) -> Option<Place>) {
    let mut order = ORDER.lock().unwrap_or_else(PoisonError::into_inner);
    let next = change(&mut order).unwrap_or(NOWHERE);
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
    /// Bytes of `place` that are read.
    read: usize,
}

impl Reader {
    /// Thread `here` of a pool whose thread `own` makes the pass.
    pub(crate) fn new(here: usize, own: usize) -> Self {
        let threads = rayon::current_num_threads();
        Self {
            number: (here + threads - own) % threads,
            threads,
            place: NOWHERE,
            read: 0,
        }
    }

    /// Starts to read some bytes; returns false if none are left.
    pub(crate) fn read(&mut self) -> bool {
        let place = NEXT.each_ref().map(|number| number.load(Ordering::Relaxed));
        let (Some(addresses), Some(prefetch)) = (self.next_addresses(place), PREFETCH.get()) else {
            return false;
        };
        prefetch(addresses);
        true
    }

    /// Addresses of the next [`BYTES_A_LOOK`] bytes of a place. Threads begin where their shares of a
    /// product do (`matrix/product.rs`).
    fn next_addresses(&mut self, place: Place) -> Option<Range<usize>> {
        if place != self.place {
            (self.place, self.read) = (place, 0);
        }
        let [address, bytes] = place;
        if self.read >= MAX_BYTES.min(bytes / self.threads) {
            return None;
        }
        let first = address + bytes * self.number / self.threads + self.read;
        self.read += BYTES_A_LOOK;
        Some(first..first + BYTES_A_LOOK)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Place = [1 << 20, 100 << 10];
    const B: Place = [2 << 20, 200 << 10];
    const C: Place = [3 << 20, 300 << 10];

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
        let mut second = Reader {
            number: 1,
            threads: 2,
            place: NOWHERE,
            read: 0,
        };
        let mut all = |place| -> Vec<Range<usize>> {
            std::iter::from_fn(|| second.next_addresses(place)).collect()
        };
        let share = (A[0] + (50 << 10)..A[0] + (100 << 10)).step_by(BYTES_A_LOOK);
        let expected: Vec<_> = share.map(|first| first..first + BYTES_A_LOOK).collect();
        assert_eq!(all(A), expected);
        assert!(all(A).is_empty());
        let found = all(C);
        assert_eq!(found[0].start, C[0] + (150 << 10));
        assert_eq!(found.len(), 150);
        assert_eq!(all([0, 1 << 30]).len(), MAX_BYTES / BYTES_A_LOOK);
        assert!(all(NOWHERE).is_empty());
    }
}
