//! A run whose folder goes away stops: nobody would find its results.

use crate::report::RunFolder;
use crate::worker::StopSwitch;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// Time between two looks at the folder.
const PAUSE: Duration = Duration::from_secs(1);

/// Works, and sets the switch once the path of the folder leads to it no more.
pub(super) fn while_in_place<T>(
    folder: &RunFolder,
    stop: &StopSwitch,
    work: impl FnOnce() -> T,
) -> T {
    let (ended, end) = mpsc::channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            while end.recv_timeout(PAUSE) == Err(RecvTimeoutError::Timeout) {
                if !folder.is_in_place() {
                    stop.stop();
                    return;
                }
            }
        });
        let outcome = work();
        drop(ended);
        outcome
    })
}
