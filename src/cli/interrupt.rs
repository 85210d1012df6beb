//! What Ctrl-C says: how the work goes on.

use super::Printer;
use anyhow::Context;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::{flag, low_level};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Time between two looks for a signal.
pub(super) const PAUSE: Duration = Duration::from_millis(100);

/// How the present work goes on.
static ADVICE: Mutex<Option<String>> = Mutex::new(None);

/// A file beyond the limit of the system (`ulimit -f`) becomes an error of the write, and does not
/// end the program.
#[cfg(unix)]
pub(super) fn outlive_file_limits() {
    // Any handler does. Without one, such a file ends the program, as it did before.
    let received = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let _ = flag::register(signal_hook::consts::SIGXFSZ, received);
}

/// Says at Ctrl-C, and when the process is asked to end, how the work goes on; then the signal ends
/// the process as usual. What is completed is on the disk by then.
pub(super) fn advise(advice: impl Into<String>, printer: Printer) -> anyhow::Result<()> {
    let before = ADVICE
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .replace(advice.into());
    if before.is_some() {
        return Ok(());
    }
    let received = Arc::new(AtomicUsize::new(0));
    for signal in [SIGINT, SIGTERM] {
        flag::register_usize(signal, Arc::clone(&received), signal as usize)
            .context("cannot wait for Ctrl-C")?;
    }
    thread::spawn(move || {
        let signal = loop {
            match received.load(Ordering::Relaxed) {
                0 => thread::sleep(PAUSE),
                signal => break signal as i32,
            }
        };
        if let Some(advice) = &*ADVICE.lock().unwrap_or_else(PoisonError::into_inner) {
            // A bar stands on the line.
            printer.note(format!("\ninterrupted; {advice}"));
        }
        planagent_child::end_all();
        // It fails for signals without a default alone.
        let _ = low_level::emulate_default_handler(signal);
    });
    Ok(())
}
