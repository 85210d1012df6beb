//! The children that live, and their end before that of the program.

use rustix::process::{Pid, Signal, WaitOptions, kill_process_group, waitpgid, waitpid};
use std::process::Child;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;
use std::time::{Duration, Instant};

/// How long the end of the children may take.
const END_WAIT: Duration = Duration::from_millis(500);
/// Time between two looks at a child.
const POLL: Duration = Duration::from_millis(1);

static LIVING: Mutex<Vec<Group>> = Mutex::new(Vec::new());
static IS_ENDING: AtomicBool = AtomicBool::new(false);

/// A guard, which leads the group, and its process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Group {
    guard: Pid,
    child: Pid,
}

impl Group {
    pub(super) fn new(guard: &Child, child: &Child) -> Self {
        Self {
            guard: Pid::from_child(guard),
            child: Pid::from_child(child),
        }
    }

    /// Kills all processes of the group.
    pub(super) fn kill(self) {
        let _ = kill_process_group(self.guard, Signal::KILL);
    }
}

/// The children that live; while the program ends, the caller waits for that.
pub(super) fn lock() -> MutexGuard<'static, Vec<Group>> {
    loop {
        let living = LIVING.lock().unwrap_or_else(PoisonError::into_inner);
        if !IS_ENDING.load(Ordering::SeqCst) {
            return living;
        }
        drop(living);
        wait_if_ending();
    }
}

/// Ends all children before a signal ends the program, and takes their exit statuses: nobody else
/// may be there who does. From now on [`wait_if_ending`] does not return, so that no thread takes
/// the end of a child for its own.
pub fn end_all() {
    IS_ENDING.store(true, Ordering::SeqCst);
    let began = Instant::now();
    let left = || began.elapsed() < END_WAIT;
    let living = loop {
        match LIVING.try_lock() {
            Ok(living) => break living,
            Err(TryLockError::Poisoned(living)) => break living.into_inner(),
            // Another thread ends a child.
            Err(TryLockError::WouldBlock) if left() => thread::sleep(POLL),
            Err(TryLockError::WouldBlock) => return,
        }
    };
    adopt_orphans();
    living.iter().for_each(|group| group.kill());
    let goes_on = |ended: rustix::io::Result<Option<_>>| ended.is_ok_and(|ended| ended.is_none());
    for Group { guard, child } in living.iter().copied() {
        // The child first, by its number: it may have left the group.
        while left() && goes_on(waitpid(Some(child), WaitOptions::NOHANG)) {
            thread::sleep(POLL);
        }
        // Each success takes one process of the group; an error says that none is left.
        while left()
            && let Ok(ended) = waitpgid(guard, WaitOptions::NOHANG)
        {
            if ended.is_none() {
                thread::sleep(POLL);
            }
        }
    }
}

/// What the children started becomes ours to wait for when they end. Without this, the first
/// process of the system takes their exit statuses, and that may be slow to do so.
fn adopt_orphans() {
    #[cfg(target_os = "linux")]
    // Kernels that cannot do it leave the zombies to the first process.
    let _ = rustix::process::set_child_subreaper(Some(rustix::process::getpid()));
}

/// Waits for the end of the program, if [`end_all`] was called. Code that reads from a child calls
/// this before it takes the end of the child for a failure.
pub fn wait_if_ending() {
    while IS_ENDING.load(Ordering::SeqCst) {
        thread::park();
    }
}
