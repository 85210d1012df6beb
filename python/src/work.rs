//! Work without the GIL, open to signals, with panics as exceptions.
//!
//! Three rules keep the package free of deadlocks, whatever a planner calls in whatever thread:
//!
//! - Python runs on threads of Python alone. A thread of a pool never waits for the GIL.
//! - What runs on the common pool only computes: locks are taken before ([`computed`]), because a
//!   thread of rayon that waits for its part takes up any other work, which may want the same lock.
//! - A run has a pool of its own ([`own_pool`]), whose threads may wait for planners in Python.

use crate::errors::{Failure, Outcome, Raise};
use crate::interrupts::Interrupts;
use planagent_runs::worker::panic_guard::catch_panic;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::cell::RefCell;
use std::num::NonZero;
use std::process;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// The environment variable that sets the number of threads.
const THREADS: &str = "PLANAGENT_THREADS";
const MAX_THREADS: usize = 512;
/// Time between two checks for signals.
pub(crate) const POLL: Duration = Duration::from_millis(20);
/// Time that interrupted work has to end before the interpreter leaves it behind.
const GRACE: Duration = Duration::from_millis(60);
/// Stack of each thread, bytes; only what is used takes memory.
const STACK: usize = 16 << 20;

/// The pool of a process. A fork copies the pool but none of its threads, so the child makes one of
/// its own.
struct OwnPool {
    pid: u32,
    pool: Arc<ThreadPool>,
}

static POOL: Mutex<Option<OwnPool>> = Mutex::new(None);
/// What [`set_threads`] asked for.
static ASKED: Mutex<Option<usize>> = Mutex::new(None);

/// A poisoned lock means that a thread panicked, which its caller has seen.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

thread_local! {
    /// The locks that a thread holds while it forks.
    static HELD: RefCell<Option<Held>> = const { RefCell::new(None) };
}

/// The locks of this crate that a thread of the parent may hold at any moment.
struct Held {
    _pool: MutexGuard<'static, Option<OwnPool>>,
    _asked: MutexGuard<'static, Option<usize>>,
    _models: crate::settings::HeldModels,
    _maps: crate::nuplan::HeldMaps,
    #[cfg(unix)]
    _watching: MutexGuard<'static, usize>,
}

/// Called before a fork: the child must find no lock held by a thread that it does not have.
#[pyfunction]
pub(crate) fn before_fork() {
    // Who holds one of them waits for nothing, the GIL included.
    let held = Held {
        _pool: lock(&POOL),
        _asked: lock(&ASKED),
        _models: crate::settings::held_models(),
        _maps: crate::nuplan::held_maps(),
        #[cfg(unix)]
        _watching: crate::interrupts::held(),
    };
    HELD.with_borrow_mut(|place| *place = Some(held));
}

/// Called after a fork, in the parent and in the child.
#[pyfunction]
pub(crate) fn after_fork() {
    HELD.with_borrow_mut(Option::take);
}

/// The number of threads: what was asked for, else `PLANAGENT_THREADS`, else what affinity and
/// cgroup allow.
fn wanted() -> Outcome<usize> {
    let asked: Option<usize> = *lock(&ASKED);
    if let Some(asked) = asked {
        return Ok(asked);
    }
    let Some(text) = std::env::var_os(THREADS).filter(|text| !text.is_empty()) else {
        let available = thread::available_parallelism().map_or(1, NonZero::get);
        return Ok(available.min(MAX_THREADS));
    };
    let number = text.to_str().and_then(|text| text.trim().parse().ok());
    number
        .filter(|number| (1..=MAX_THREADS).contains(number))
        .ok_or_else(|| {
            Failure::argument(format!(
                "{THREADS} is \"{}\"; the number of threads must lie in 1 to {MAX_THREADS}",
                text.display()
            ))
        })
}

fn built(name: &'static str) -> Outcome<ThreadPool> {
    let built = ThreadPoolBuilder::new()
        .num_threads(wanted()?)
        .thread_name(move |i| format!("{name}-{i}"))
        .stack_size(STACK)
        .build();
    built.map_err(|error| Failure::panic(format!("cannot start threads: {error}")))
}

/// The common pool, for work that only computes.
fn pool() -> Outcome<Arc<ThreadPool>> {
    let (mut own, pid) = (lock(&POOL), process::id());
    if let Some(known) = own.as_ref().filter(|known| known.pid == pid) {
        return Ok(Arc::clone(&known.pool));
    }
    // The threads of the parent's pool do not exist here: to wait for their end would take forever.
    std::mem::forget(own.take());
    let pool = Arc::new(built("planagent")?);
    *own = Some(OwnPool {
        pid,
        pool: Arc::clone(&pool),
    });
    Ok(pool)
}

/// A pool for one run. It ends with the run, or with what its threads wait for.
pub(crate) fn own_pool() -> Outcome<ThreadPool> {
    built("planagent-run")
}

/// Leaves the common pool to the work that it has; new work gets another one.
fn leave_pool() {
    let own = lock(&POOL).take();
    if own.as_ref().is_some_and(|own| own.pid != process::id()) {
        std::mem::forget(own);
    }
}

/// Number of threads that simulations and models use.
#[pyfunction]
pub(crate) fn threads(py: Python<'_>) -> PyResult<usize> {
    py.detach(wanted).or_raise(py)
}

/// Sets the number of threads; `None` restores the default. Work in progress keeps the old ones.
#[pyfunction]
#[pyo3(signature = (count=None))]
pub(crate) fn set_threads(py: Python<'_>, count: Option<usize>) -> PyResult<()> {
    if let Some(count) = count.filter(|count| !(1..=MAX_THREADS).contains(count)) {
        let text =
            format!("count is {count}; the number of threads must lie in 1 to {MAX_THREADS}");
        return Err(Failure::argument(text).raised(py));
    }
    py.detach(|| {
        *lock(&ASKED) = count;
        leave_pool();
    });
    Ok(())
}

/// Turns a panic into a failure.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Outcome<T>) -> Outcome<T> {
    let mut outcome = None;
    let caught = catch_panic(|| {
        outcome = Some(work());
        Ok(())
    });
    match (caught, outcome) {
        (Ok(()), Some(outcome)) => outcome,
        (caught, _) => Err(Failure::panic(caught.err().unwrap_or_default())),
    }
}

/// Computes on the common pool. The work takes no lock that another one holds while it computes:
/// take such locks before. Not for threads of a pool.
pub(crate) fn computed<T: Send>(work: impl FnOnce() -> Outcome<T> + Send) -> Outcome<T> {
    pool()?.install(|| guarded(work))
}

/// Runs short work on this thread without the GIL.
pub(crate) fn quick<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Outcome<T> + Send,
) -> PyResult<T> {
    py.detach(|| guarded(work)).or_raise(py)
}

/// Runs long work on a thread of its own without the GIL; its parts that compute are [`computed`].
/// Meanwhile signals are handled. If a handler raises, `stop` is called, and the exception is
/// raised without waiting long for the work.
pub(crate) fn long<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> Outcome<T> + Send + 'static,
    stop: &dyn Fn(),
) -> PyResult<T> {
    let watch = Interrupts::of_this_thread(py)?;
    let (sender, receiver) = sync_channel(1);
    let started = spawned(move || {
        // Without a receiver, the work was interrupted.
        let _ = sender.send(guarded(work));
    });
    started.or_raise(py)?;
    let receiver = Mutex::new(receiver);
    let ended = |time| py.detach(|| lock(&receiver).recv_timeout(time));
    loop {
        match ended(POLL) {
            Ok(outcome) => return outcome.or_raise(py),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Failure::panic("a thread ended without a result").raised(py));
            }
        }
        if let Err(error) = py.check_signals().and_then(|()| watch.check()) {
            stop();
            if ended(GRACE).is_err() {
                leave_pool();
            }
            return Err(error);
        }
    }
}

/// Starts a thread for work that waits.
pub(crate) fn spawned(work: impl FnOnce() + Send + 'static) -> Outcome<()> {
    let started = thread::Builder::new()
        .name("planagent-work".to_owned())
        .stack_size(STACK)
        .spawn(work);
    started
        .map(drop)
        .map_err(|error| Failure::panic(format!("cannot start a thread: {error}")))
}
