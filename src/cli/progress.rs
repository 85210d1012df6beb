//! How far a run has come: one bar on a terminal, a line now and then elsewhere.

use super::Printer;
use console::Term;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Time between two lines where stderr is no terminal. A run that is shorter prints none.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// What the bar shows.
const TEMPLATE: &str = "{bar:24} {pos}/{len} drives  {per_sec}  {eta} left  {wide_msg}";

/// Progress of the drives of a run; shared by all threads.
pub(super) struct DriveProgress {
    printer: Printer,
    bar: ProgressBar,
    is_terminal: bool,
    total: usize,
    begun: Instant,
    ended: AtomicUsize,
    failed: AtomicUsize,
    iterations: AtomicUsize,
    last_line: Mutex<Instant>,
}

impl DriveProgress {
    /// Of a run with `total` drives that are to be made.
    pub(super) fn new(printer: Printer, total: usize) -> Self {
        let bar = printer.progress(total as u64, "drives");
        if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
            bar.set_style(style.with_key("per_sec", per_minute));
        }
        Self {
            printer,
            bar,
            is_terminal: Term::stderr().is_term(),
            total,
            begun: Instant::now(),
            ended: AtomicUsize::new(0),
            failed: AtomicUsize::new(0),
            iterations: AtomicUsize::new(0),
            last_line: Mutex::new(Instant::now()),
        }
    }

    /// After every iteration of every drive: a model of 7B takes an hour for a drive.
    pub(super) fn iteration(&self) {
        let iterations = self.iterations.fetch_add(1, Ordering::Relaxed) + 1;
        self.show(iterations);
    }

    /// After every drive.
    pub(super) fn drive_ended(&self, failed: bool) {
        self.ended.fetch_add(1, Ordering::Relaxed);
        self.failed.fetch_add(usize::from(failed), Ordering::Relaxed);
        self.bar.inc(1);
        self.show(self.iterations.load(Ordering::Relaxed));
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn show(&self, iterations: usize) {
        let failed = self.failed.load(Ordering::Relaxed);
        if self.is_terminal {
            self.bar.set_message(format!("{failed} failed  {iterations} iterations"));
            return;
        }
        // Whoever finds the clock taken has nothing to say: another thread is saying it.
        let Ok(mut last) = self.last_line.try_lock() else { return };
        if last.elapsed() >= LINE_EVERY {
            *last = Instant::now();
            self.printer.note(self.line(failed, iterations));
        }
    }

    fn line(&self, failed: usize, iterations: usize) -> String {
        let ended = self.ended.load(Ordering::Relaxed);
        let passed = self.begun.elapsed();
        let left = match u32::try_from(ended) {
            Ok(done) if done > 0 => {
                let rest = passed / done * u32::try_from(self.total - ended.min(self.total)).unwrap_or(u32::MAX);
                format!(", about {} left", HumanDuration(rest))
            }
            _ => String::new(),
        };
        let rate = ended as f64 / passed.as_secs_f64().max(f64::EPSILON) * 60.0;
        format!(
            "{ended}/{} drives, {failed} failed, {iterations} iterations, {rate:.1} drives a minute{left}",
            self.total
        )
    }
}

/// The present rate in drives a minute.
fn per_minute(state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write) {
    // A bar that cannot be written is no error of the run.
    let _ = write!(out, "{:.1}/min", state.per_sec() * 60.0);
}
