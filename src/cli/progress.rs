//! Progress of a run: bars on a terminal, a line now and then elsewhere.

use super::{Printer, again, interrupt};
use console::Term;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use planagent_runs::runner::{Event, Listener};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// Time between two lines where stderr is no terminal. A shorter run prints none.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// The bar, in 80 columns.
const TEMPLATE: &str = "{bar:10} {pos}/{len} simulations {per_sec} {left} {msg}";
/// Steps of a simulation of 15 s, for the estimate before the first one ends.
const USUAL: usize = 150;
/// Steps after which the time left is estimated: those between two planning calls.
const MIN_STEPS: usize = 20;
/// Unit of a bar that shows its numbers as bytes.
const BYTES: &str = "bytes";

/// Prints the events of a run.
struct Console {
    printer: Printer,
    simulations: RwLock<Option<SimulationProgress>>,
    /// The other bars, by unit.
    bars: Mutex<BTreeMap<&'static str, ProgressBar>>,
}

/// A listener that prints the events of a run.
pub(super) fn listener(printer: Printer) -> Listener {
    let console = Console {
        printer,
        simulations: RwLock::default(),
        bars: Mutex::default(),
    };
    Arc::new(move |event| console.print(event))
}

impl Console {
    fn print(&self, event: Event) {
        match event {
            Event::Note(text) => self.printer.note(text),
            Event::Detail(text) => self.printer.detail(text),
            Event::LogsSearched { done, total } => self.bar("logs", done as u64, total as u64),
            Event::ScenesCounted { done, total } => self.bar("scenes", done as u64, total as u64),
            Event::Fetched(progress) => self.bar(BYTES, progress.bytes, progress.total),
            Event::Opened {
                folder,
                has_commands,
            } => {
                let command = again::resume_run(&folder, has_commands);
                let advice = format!("`{command}` goes on");
                if let Err(error) = interrupt::advise(advice, self.printer) {
                    self.printer.error(&error);
                }
            }
            Event::Started { total } => {
                self.replace(Some(SimulationProgress::new(self.printer, total)))
            }
            Event::Stepped => self.of_simulations(SimulationProgress::step),
            Event::CallFailed(call) => self.aside(&call.to_string()),
            Event::Ended { failed } => self.of_simulations(|progress| progress.ended(failed)),
            Event::Finished => self.replace(None),
            Event::Planned {
                runs,
                completed,
                left,
            } => self.printer.note(format!(
                "{} simulations in {runs} runs; {completed} are completed, {left} are left",
                completed + left
            )),
            Event::Estimated { left, time } => {
                let (time, threads) = (HumanDuration(time), rayon::current_num_threads());
                self.printer.note(format!(
                    "about {time} for {left} simulations on {threads} threads"
                ));
            }
            // An event that nobody knows yet is none of the terminal's.
            _ => {}
        }
    }

    /// Shows a bar until all is done.
    fn bar(&self, unit: &'static str, done: u64, total: u64) {
        let mut bars = self.bars.lock().unwrap_or_else(PoisonError::into_inner);
        if done >= total {
            if let Some(bar) = bars.remove(unit) {
                bar.finish_and_clear();
            }
            return;
        }
        let bar = bars.entry(unit).or_insert_with(|| match unit {
            BYTES => self.printer.byte_progress(total),
            _ => self.printer.progress(total, unit),
        });
        bar.set_length(total);
        bar.set_position(done);
    }

    /// A line above the bar of the simulations.
    fn aside(&self, text: &str) {
        let simulations = self
            .simulations
            .read()
            .unwrap_or_else(PoisonError::into_inner);
        match &*simulations {
            Some(progress) => progress.bar.suspend(|| self.printer.failure(text)),
            None => self.printer.failure(text),
        }
    }

    fn replace(&self, progress: Option<SimulationProgress>) {
        let mut simulations = self
            .simulations
            .write()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(before) = std::mem::replace(&mut *simulations, progress) {
            before.bar.finish_and_clear();
        }
    }

    fn of_simulations(&self, act: impl FnOnce(&SimulationProgress)) {
        if let Some(progress) = &*self
            .simulations
            .read()
            .unwrap_or_else(PoisonError::into_inner)
        {
            act(progress);
        }
    }
}

/// Progress of the simulations of a run; shared by all threads.
struct SimulationProgress {
    printer: Printer,
    bar: ProgressBar,
    is_terminal: bool,
    counts: Arc<Counts>,
    last_line: Mutex<Instant>,
}

/// What was done so far.
struct Counts {
    total: usize,
    started: Instant,
    ended: AtomicUsize,
    failed: AtomicUsize,
    steps: AtomicUsize,
}

impl Counts {
    /// Time left at the present pace, in words.
    fn left(&self) -> String {
        let (ended, steps) = (
            self.ended.load(Ordering::Relaxed),
            self.steps.load(Ordering::Relaxed),
        );
        if ended == 0 && steps < MIN_STEPS {
            return "estimating".to_owned();
        }
        let total = self.total as f64;
        // Simulations in progress count by their steps: with a model of 7B parameters, one takes an
        // hour.
        let done = (ended as f64).max((steps as f64 / USUAL as f64).min(total));
        let rest = self.started.elapsed().as_secs_f64() / done * (total - done);
        let rest = Duration::try_from_secs_f64(rest).unwrap_or_default();
        if rest < Duration::from_secs(1) {
            "0s left".to_owned()
        } else {
            format!("{:#} left", HumanDuration(rest))
        }
    }
}

impl SimulationProgress {
    /// Progress of `total` simulations.
    fn new(printer: Printer, total: usize) -> Self {
        let bar = printer.progress(total as u64, "simulations");
        let counts = Arc::new(Counts {
            total,
            started: Instant::now(),
            ended: AtomicUsize::new(0),
            failed: AtomicUsize::new(0),
            steps: AtomicUsize::new(0),
        });
        Self::with_counts(printer, bar, counts)
    }

    fn with_counts(printer: Printer, bar: ProgressBar, counts: Arc<Counts>) -> Self {
        if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
            let of_bar = Arc::clone(&counts);
            let left = move |_: &indicatif::ProgressState, out: &mut dyn std::fmt::Write| {
                // A bar that cannot be written is no error of the run.
                let _ = out.write_str(&of_bar.left());
            };
            bar.set_style(style.with_key("per_sec", per_minute).with_key("left", left));
        }
        let is_terminal = Term::stderr().is_term();
        Self {
            printer,
            bar,
            is_terminal,
            counts,
            last_line: Mutex::new(Instant::now()),
        }
    }

    /// Counts a step of a simulation.
    fn step(&self) {
        let steps = self.counts.steps.fetch_add(1, Ordering::Relaxed) + 1;
        self.show(steps);
    }

    fn ended(&self, failed: bool) {
        self.counts.ended.fetch_add(1, Ordering::Relaxed);
        self.counts
            .failed
            .fetch_add(usize::from(failed), Ordering::Relaxed);
        self.bar.inc(1);
        self.show(self.counts.steps.load(Ordering::Relaxed));
    }

    fn show(&self, steps: usize) {
        let failed = self.counts.failed.load(Ordering::Relaxed);
        if self.is_terminal {
            self.bar
                .set_message(format!("{failed} failed {steps} steps"));
            return;
        }
        // A thread that finds the clock locked prints nothing: another thread prints.
        let Ok(mut last) = self.last_line.try_lock() else {
            return;
        };
        if last.elapsed() >= LINE_EVERY {
            *last = Instant::now();
            self.printer.note(self.line(failed, steps));
        }
    }

    fn line(&self, failed: usize, steps: usize) -> String {
        let Counts {
            total,
            started,
            ended,
            ..
        } = &*self.counts;
        let ended = ended.load(Ordering::Relaxed);
        let (rate, left) = (
            a_minute(ended as f64, started.elapsed()),
            self.counts.left(),
        );
        format!(
            "{ended}/{total} simulations, {failed} failed, {steps} steps, {rate:.1}/min, {left}"
        )
    }
}

/// Simulations a minute since the start.
fn a_minute(ended: f64, passed: Duration) -> f64 {
    ended / passed.as_secs_f64().max(f64::EPSILON) * 60.0
}

/// The same for the bar.
fn per_minute(state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write) {
    // A bar that cannot be written is no error of the run.
    let _ = write!(
        out,
        "{:.1}/min",
        a_minute(state.pos() as f64, state.elapsed())
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::{ProgressDrawTarget, TermLike};
    use std::io;
    use std::sync::Arc;

    /// More columns than any bar has.
    const WIDE: u16 = 500;

    /// Time since the start of the run.
    const PASSED: Duration = Duration::from_mins(10);

    /// A wide terminal that stores its text.
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
        let (total, steps) = (12_800, 1_907_200);
        let paper = Paper::default();
        let target = ProgressDrawTarget::term_like_with_hz(Box::new(paper.clone()), 255);
        let bar = ProgressBar::with_draw_target(Some(total as u64), target).with_elapsed(PASSED);
        let started = Instant::now().checked_sub(PASSED).unwrap();
        let counts = Counts {
            total,
            started,
            ended: AtomicUsize::new(12_799),
            failed: AtomicUsize::new(99),
            steps: AtomicUsize::new(steps),
        };
        let progress =
            SimulationProgress::with_counts(Printer::new(false, true), bar, Arc::new(counts));
        let progress = SimulationProgress {
            is_terminal: true,
            ..progress
        };
        progress.bar.set_position(12_799);
        progress.show(steps);
        progress.bar.force_draw();
        let drawn = paper.0.lock().unwrap().clone();
        assert!(
            drawn.contains("12799/12800 simulations") && drawn.contains("99 failed 1907200 steps"),
            "{drawn}"
        );
        let line = progress.line(99, steps);
        for text in drawn.lines().chain([line.as_str()]) {
            assert!(console::measure_text_width(text) <= 80, "{text}");
        }
    }

    #[test]
    fn the_time_left_is_estimated_from_steps_before_a_simulation_ends() {
        let counts = |ended: usize, steps: usize| Counts {
            total: 10,
            started: Instant::now().checked_sub(PASSED).unwrap(),
            ended: AtomicUsize::new(ended),
            failed: AtomicUsize::new(0),
            steps: AtomicUsize::new(steps),
        };
        assert_eq!(counts(0, MIN_STEPS - 1).left(), "estimating");
        // A fifth of a simulation in 10 minutes: 49 more fifths take 490 minutes.
        assert_eq!(counts(0, 30).left(), "8h left");
        assert_eq!(counts(0, 2 * USUAL).left(), "40m left");
        // Shorter simulations end with fewer steps.
        assert_eq!(counts(5, 5 * 80).left(), "10m left");
        assert_eq!(counts(10, 10 * USUAL).left(), "0s left");
    }
}
