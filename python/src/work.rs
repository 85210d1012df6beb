//! Work without the GIL: on one thread pool a process, open to signals, with panics as exceptions.

use crate::errors::{Failure, Outcome, Raise};
use planagent_runs::worker::panic_guard::catch_panic;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::num::NonZero;
use std::process;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// The environment variable that sets the number of threads.
const THREADS: &str = "PLANAGENT_THREADS";
const MAX_THREADS: usize = 512;
/// Time between two looks at signals and progress.
const POLL: Duration = Duration::from_millis(20);
/// Time that interrupted work has to end before the interpreter leaves it behind.
const GRACE: Duration = Duration::from_millis(60);

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

/// The number of threads: what was asked for, else `PLANAGENT_THREADS`, else what affinity and
/// cgroup allow.
fn wanted() -> usize {
    let of_environment = || std::env::var(THREADS).ok()?.trim().parse().ok();
    let available = || thread::available_parallelism().map_or(1, NonZero::get);
    let asked: Option<usize> = *lock(&ASKED);
    asked
        .or_else(of_environment)
        .filter(|&threads| threads > 0)
        .unwrap_or_else(available)
        .min(MAX_THREADS)
}

fn pool() -> Outcome<Arc<ThreadPool>> {
    let (mut own, pid) = (lock(&POOL), process::id());
    if let Some(known) = own.as_ref().filter(|known| known.pid == pid) {
        return Ok(Arc::clone(&known.pool));
    }
    // The threads of the parent's pool do not exist here: to wait for their end would take forever.
    std::mem::forget(own.take());
    let built = ThreadPoolBuilder::new()
        .num_threads(wanted())
        .thread_name(|i| format!("planagent-{i}"))
        .build();
    let pool = Arc::new(built.map_err(|error| Failure::new("InternalError", error.to_string()))?);
    *own = Some(OwnPool {
        pid,
        pool: Arc::clone(&pool),
    });
    Ok(pool)
}

/// Number of threads that simulations and models use.
#[pyfunction]
pub(crate) fn threads(py: Python<'_>) -> PyResult<usize> {
    py.detach(|| Ok(pool()?.current_num_threads())).or_raise(py)
}

/// Sets the number of threads; `None` restores the default.
#[pyfunction]
#[pyo3(signature = (count=None))]
pub(crate) fn set_threads(py: Python<'_>, count: Option<usize>) -> PyResult<()> {
    if count.is_some_and(|count| !(1..=MAX_THREADS).contains(&count)) {
        return Err(Failure::argument(format!(
            "the number of threads must lie in 1 to {MAX_THREADS}"
        ))
        .raised(py));
    }
    *lock(&ASKED) = count;
    // Work in progress keeps the old pool until it ends.
    let own = lock(&POOL).take();
    if own.as_ref().is_some_and(|own| own.pid != process::id()) {
        std::mem::forget(own);
    }
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

/// Runs short work on this thread without the GIL.
pub(crate) fn quick<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Outcome<T> + Send,
) -> PyResult<T> {
    py.detach(|| guarded(work)).or_raise(py)
}

/// Runs short work on the pool without the GIL.
pub(crate) fn pooled<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Outcome<T> + Send,
) -> PyResult<T> {
    py.detach(|| {
        let pool = pool()?;
        // One thread needs no handing over.
        if pool.current_num_threads() == 1 {
            guarded(work)
        } else {
            pool.install(|| guarded(work))
        }
    })
    .or_raise(py)
}

/// Runs long work on the pool without the GIL. Meanwhile signals are handled, and `look` is called
/// with the GIL; if either raises, `stop` is called, and the exception is raised without waiting
/// long for the work.
pub(crate) fn long<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> Outcome<T> + Send + 'static,
    stop: &(dyn Fn() + Sync),
    look: &(dyn Fn(Python<'_>) -> PyResult<()> + Sync),
) -> PyResult<T> {
    // A planner in Python, inside a simulation: were all threads of the pool to wait for the pool,
    // none would work.
    if rayon::current_thread_index().is_some() {
        let done = py.detach(|| guarded(work)).or_raise(py)?;
        return look(py).map(|()| done);
    }
    py.detach(|| {
        let (sender, receiver) = sync_channel(1);
        let started = thread::Builder::new()
            .name("planagent-work".to_owned())
            .spawn(move || {
                let outcome = pool().and_then(|pool| pool.install(|| guarded(work)));
                // Without a receiver, the work was interrupted.
                let _ = sender.send(outcome);
            });
        if let Err(error) = started {
            return Err(Python::attach(|py| {
                Failure::panic(error.to_string()).raised(py)
            }));
        }
        loop {
            match receiver.recv_timeout(POLL) {
                Ok(outcome) => {
                    return Python::attach(|py| {
                        look(py)?;
                        outcome.or_raise(py)
                    });
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Python::attach(|py| {
                        Failure::panic("a thread ended without a result").raised(py)
                    }));
                }
            }
            if let Err(error) = Python::attach(|py| py.check_signals().and_then(|()| look(py))) {
                stop();
                let _ = receiver.recv_timeout(GRACE);
                return Err(error);
            }
        }
    })
}
