//! Threads that wait for the next product without going to sleep.
//!
//! A pass of a decoder has hundreds of products of some 20 µs, and short steps between them that one
//! thread does. An idle thread of rayon's pool sleeps after some microseconds, and to wake it takes
//! about as long as such a product. Why: docs/decisions/133-threads-stay-awake.md.

use crate::read_ahead::{self, Reader};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Pauses between two looks for work: less than a microsecond.
const PAUSES: usize = 16;
/// Times that a thread finds nothing before it lets other programs run: about a millisecond.
const LOOKS: usize = 1 << 12;

/// Threads that are awake and have nothing else to do.
static AWAKE: AtomicUsize = AtomicUsize::new(0);
/// Passes in progress. With two of them, a thread that waits for one could keep the other waiting.
static PASSES: AtomicUsize = AtomicUsize::new(0);

/// A pass. Where it is the only one, it keeps threads of rayon's pool awake until it is dropped, as
/// far as they have nothing else to do. It changes no result.
#[derive(Debug)]
pub struct Awake {
    done: Arc<AtomicBool>,
}

impl Awake {
    /// Wakes the idle threads of this thread's pool; outside of a pool, none.
    pub fn begin() -> Self {
        let done = Arc::new(AtomicBool::new(false));
        let is_alone = PASSES.fetch_add(1, Ordering::Relaxed) == 0;
        if let (true, Some(own)) = (is_alone, rayon::current_thread_index()) {
            read_ahead::begin();
            for _ in 1..rayon::current_num_threads() {
                let done = Arc::clone(&done);
                rayon::spawn(move || {
                    // While this thread waits for a part of its product it takes any work, this
                    // too, and must go on.
                    if let Some(here) = rayon::current_thread_index().filter(|here| *here != own) {
                        wait(&done, Reader::new(here, own));
                    }
                });
            }
        }
        Self { done }
    }

    /// Whether one pass is in progress.
    pub(crate) fn is_one_pass() -> bool {
        PASSES.load(Ordering::Relaxed) == 1
    }

    /// Whether a thread waits for work.
    pub(crate) fn is_anybody() -> bool {
        AWAKE.load(Ordering::Relaxed) > 0
    }
}

impl Drop for Awake {
    fn drop(&mut self) {
        PASSES.fetch_sub(1, Ordering::Relaxed);
        self.done.store(true, Ordering::Release);
    }
}

/// Does work of the pool until the pass is done, and reads ahead where there is none.
fn wait(done: &AtomicBool, mut reader: Reader) {
    AWAKE.fetch_add(1, Ordering::Relaxed);
    let mut found_nothing = 0;
    while !done.load(Ordering::Acquire) && PASSES.load(Ordering::Relaxed) == 1 {
        if rayon::yield_now() == Some(rayon::Yield::Executed) {
            found_nothing = 0;
            continue;
        }
        found_nothing += 1;
        if found_nothing % LOOKS == 0 {
            std::thread::yield_now();
        }
        if !reader.read() {
            (0..PAUSES).for_each(|_| std::hint::spin_loop());
        }
    }
    AWAKE.fetch_sub(1, Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Matrix;
    use candle_core::{Device, Tensor};
    use std::time::{Duration, Instant};

    /// Time after which something that should happen does not.
    const PATIENCE: Duration = Duration::from_secs(20);

    fn soon(mut work: impl FnMut() -> bool) -> bool {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            if work() {
                return true;
            }
            std::thread::yield_now();
        }
        false
    }

    /// One test, since passes of other tests would count.
    #[test]
    fn threads_are_awake_during_a_single_pass() {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(2)
            .build()
            .unwrap();
        pool.install(|| {
            let pass = Awake::begin();
            assert!(soon(Awake::is_anybody));
            // The half that waits ends only if the thread that is awake takes the other one.
            let taken = AtomicBool::new(false);
            let (waited, ()) = rayon::join(
                || soon(|| taken.load(Ordering::Acquire)),
                || taken.store(true, Ordering::Release),
            );
            assert!(waited);
            drop(pass);
            assert!(soon(|| !Awake::is_anybody()));
        });
        pool.install(|| {
            let first = Awake::begin();
            assert!(soon(Awake::is_anybody));
            let second = Awake::begin();
            assert!(
                soon(|| !Awake::is_anybody()),
                "nobody waits beside two passes"
            );
            drop((first, second));
        });
        // A row of this size is shared among threads only where one is awake.
        let numbers = |count| {
            (0..count)
                .map(|at| (at % 17) as f32 - 8.0)
                .collect::<Vec<_>>()
        };
        let weights = Tensor::from_vec(numbers(300 * 512), (300, 512), &Device::Cpu).unwrap();
        let matrix = Matrix::from_tensor(&weights).unwrap();
        let row = Tensor::from_vec(numbers(512), (1, 512), &Device::Cpu).unwrap();
        let product = || matrix.forward(&row).unwrap().to_vec2::<f32>().unwrap();
        let alone = product();
        pool.install(|| {
            let _pass = Awake::begin();
            assert!(soon(Awake::is_anybody));
            assert_eq!(product(), alone);
        });
        assert!(soon(|| !Awake::is_anybody()));
        let outside = Awake::begin();
        assert!(!Awake::is_anybody());
        drop(outside);
        assert_eq!(PASSES.load(Ordering::Relaxed), 0);
    }
}
