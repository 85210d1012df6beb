//! Ctrl-C for work in threads other than the main one, where Python handles no signals.
//!
//! Python's handler only marks the signal, and its main thread alone raises `KeyboardInterrupt`. A
//! run in another thread, for example in an executor of asyncio, would go on to its end, and the
//! process with it. While such work waits, a handler before Python's counts the signals.

#![allow(
    unsafe_code,
    reason = "the standard library cannot put a handler of signals before another one"
)]

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// Looks for Ctrl-C while work of this thread waits; nothing in the main thread.
pub(crate) struct Interrupts {
    #[cfg(unix)]
    seen: Option<usize>,
}

impl Interrupts {
    pub(crate) fn of_this_thread(py: Python<'_>) -> PyResult<Self> {
        let threading = py.import("threading")?;
        let main = threading.call_method0("main_thread")?.getattr("ident")?;
        let is_main = main.eq(threading.call_method0("get_ident")?)?;
        #[cfg(unix)]
        {
            let seen = (!is_main).then(handler::start);
            Ok(Self { seen })
        }
        #[cfg(not(unix))]
        {
            let _ = is_main;
            Ok(Self {})
        }
    }

    /// # Errors
    /// `KeyboardInterrupt` after Ctrl-C.
    pub(crate) fn check(&self) -> PyResult<()> {
        #[cfg(unix)]
        if self.seen.is_some_and(|seen| handler::count() != seen) {
            return Err(PyKeyboardInterrupt::new_err(()));
        }
        Ok(())
    }
}

/// The lock of those that watch, held through a fork.
#[cfg(unix)]
pub(crate) use handler::held;

#[cfg(unix)]
impl Drop for Interrupts {
    fn drop(&mut self) {
        if self.seen.is_some() {
            handler::end();
        }
    }
}

#[cfg(unix)]
mod handler {
    use crate::work::lock;
    use libc::{SA_SIGINFO, SIG_DFL, SIG_IGN, SIGINT, c_int, c_void, sigaction, siginfo_t};
    use std::mem;
    use std::ptr;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
    use std::sync::{Mutex, MutexGuard};

    /// Signals so far.
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    /// The handler before ours, and whether it takes three arguments.
    static BEFORE: AtomicUsize = AtomicUsize::new(SIG_IGN);
    static TAKES_INFO: AtomicBool = AtomicBool::new(false);
    /// How many threads watch.
    static WATCHING: Mutex<usize> = Mutex::new(0);

    extern "C" fn on_signal(signal: c_int, info: *mut siginfo_t, context: *mut c_void) {
        COUNT.fetch_add(1, Ordering::Relaxed);
        let before = BEFORE.load(Ordering::Relaxed);
        if before == SIG_DFL || before == SIG_IGN {
            return;
        }
        // SAFETY: `put` read the address from a handler in use, with the flag that says its type.
        unsafe {
            if TAKES_INFO.load(Ordering::Relaxed) {
                let handler: extern "C" fn(c_int, *mut siginfo_t, *mut c_void) =
                    mem::transmute(before);
                handler(signal, info, context);
            } else {
                let handler: extern "C" fn(c_int) = mem::transmute(before);
                handler(signal);
            }
        }
    }

    fn address() -> usize {
        let handler: extern "C" fn(c_int, *mut siginfo_t, *mut c_void) = on_signal;
        handler as usize
    }

    fn present() -> Option<sigaction> {
        // SAFETY: all zeros is a value of this plain structure, which the call fills.
        unsafe {
            let mut now: sigaction = mem::zeroed();
            (sigaction(SIGINT, ptr::null(), &raw mut now) == 0).then_some(now)
        }
    }

    /// Puts our handler before the present one. Python puts its own back at each `signal.signal`.
    fn put() {
        let Some(now) = present() else { return };
        // A process that ignores the signal, or ends by it, has no handler to go before.
        if [SIG_DFL, SIG_IGN, address()].contains(&now.sa_sigaction) {
            return;
        }
        BEFORE.store(now.sa_sigaction, Ordering::Relaxed);
        TAKES_INFO.store(now.sa_flags & SA_SIGINFO != 0, Ordering::Relaxed);
        let ours = sigaction {
            sa_sigaction: address(),
            sa_flags: now.sa_flags | SA_SIGINFO,
            ..now
        };
        // SAFETY: the handler does nothing but count and call the one before.
        unsafe {
            sigaction(SIGINT, &raw const ours, ptr::null_mut());
        }
    }

    pub(crate) fn held() -> MutexGuard<'static, usize> {
        lock(&WATCHING)
    }

    /// Begins to watch; gives the number of signals so far.
    pub(super) fn start() -> usize {
        let mut watching = lock(&WATCHING);
        *watching += 1;
        put();
        COUNT.load(Ordering::Relaxed)
    }

    /// The number of signals so far. Our handler stays the first one.
    pub(super) fn count() -> usize {
        let _watching = lock(&WATCHING);
        put();
        COUNT.load(Ordering::Relaxed)
    }

    /// Ends to watch; the last one puts the handler before ours back.
    pub(super) fn end() {
        let mut watching = lock(&WATCHING);
        *watching -= 1;
        if *watching > 0 {
            return;
        }
        let Some(now) = present().filter(|now| now.sa_sigaction == address()) else {
            return;
        };
        let info = if TAKES_INFO.load(Ordering::Relaxed) {
            SA_SIGINFO
        } else {
            0
        };
        let before = sigaction {
            sa_sigaction: BEFORE.load(Ordering::Relaxed),
            sa_flags: (now.sa_flags & !SA_SIGINFO) | info,
            ..now
        };
        // SAFETY: it is the handler that was in use before ours.
        unsafe {
            sigaction(SIGINT, &raw const before, ptr::null_mut());
        }
    }
}
