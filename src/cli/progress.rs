//! How far a run has come: one bar on a terminal, a line now and then elsewhere.

use super::Printer;
use console::Term;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Time between two lines where stderr is no terminal. A run that is shorter prints none.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// What the bar shows, in 80 columns.
const TEMPLATE: &str = "{bar:12} {pos}/{len} drives  {per_sec}  {eta} left  {msg}";

/// Progress of the drives of a run; shared by all threads.
pub(super) struct SimulationProgress {
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

impl SimulationProgress {
    /// Of a run with `total` drives that are to be made.
    pub(super) fn new(printer: Printer, total: usize) -> Self {
        Self::with_bar(printer, printer.progress(total as u64, "drives"), total)
    }

    fn with_bar(printer: Printer, bar: ProgressBar, total: usize) -> Self {
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
            self.bar.set_message(format!("{failed} failed  {iterations} steps"));
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
        let rate = a_minute(ended as f64, passed);
        format!("{ended}/{} drives, {failed} failed, {iterations} steps, {rate:.1}/min{left}", self.total)
    }
}

/// Drives a minute since the begin.
fn a_minute(ended: f64, passed: Duration) -> f64 {
    ended / passed.as_secs_f64().max(f64::EPSILON) * 60.0
}

/// The same for the bar.
fn per_minute(state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write) {
    // A bar that cannot be written is no error of the run.
    let _ = write!(out, "{:.1}/min", a_minute(state.pos() as f64, state.elapsed()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::{ProgressDrawTarget, TermLike};
    use std::io;
    use std::sync::Arc;

    /// Columns of a terminal that would hold any bar.
    const WIDE: u16 = 500;

    /// How long the run has been going on.
    const PASSED: Duration = Duration::from_secs(600);

    /// A wide terminal that keeps all it was given.
    #[derive(Debug, Clone, Default)]
    struct Paper(Arc<Mutex<String>>);

    impl TermLike for Paper {
        fn width(&self) -> u16 {
            WIDE
        }

        fn move_cursor_up(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_down(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_right(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_left(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn write_line(&self, text: &str) -> io::Result<()> {
            self.write_str(text)
        }

        fn write_str(&self, text: &str) -> io::Result<()> {
            let mut paper = self.0.lock().unwrap();
            paper.push_str(text.trim_end());
            paper.push('\n');
            Ok(())
        }

        fn clear_line(&self) -> io::Result<()> {
            Ok(())
        }

        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn bar_and_lines_of_a_large_run_stay_within_80_columns() {
        let (total, iterations) = (12_800, 1_907_200);
        let paper = Paper::default();
        let target = ProgressDrawTarget::term_like_with_hz(Box::new(paper.clone()), 255);
        let bar = ProgressBar::with_draw_target(Some(total as u64), target).with_elapsed(PASSED);
        let progress = SimulationProgress::with_bar(Printer::new(false, true), bar, total);
        let begun = Instant::now().checked_sub(PASSED).unwrap();
        let progress = SimulationProgress { is_terminal: true, begun, ..progress };
        progress.bar.set_position(12_799);
        progress.ended.store(12_799, Ordering::Relaxed);
        progress.failed.store(99, Ordering::Relaxed);
        progress.show(iterations);
        progress.bar.force_draw();
        let drawn = paper.0.lock().unwrap().clone();
        assert!(drawn.contains("12799/12800 drives") && drawn.contains("99 failed  1907200 steps"), "{drawn}");
        let line = progress.line(99, iterations);
        for text in drawn.lines().chain([line.as_str()]) {
            assert!(console::measure_text_width(text) <= 80, "{text}");
        }
    }
}
