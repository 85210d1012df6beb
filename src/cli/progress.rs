//! Progress of a run: bars on a terminal, a line now and then elsewhere.

use super::{Printer, again, interrupt};
use console::Term;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use planagent_runs::report::table::terminal::COLUMNS;
use planagent_runs::runner::{Event, Listener};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

/// Time between two lines where stderr is no terminal. A shorter run prints none.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// The bar: the words first, and the bar takes the columns that they leave.
const TEMPLATE: &str = "{words} {wide_bar}";
/// Columns of the bar that words do not take.
const MIN_BAR: usize = 10;
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
                named_again,
            } => {
                let command = again::resume_run(&folder, has_commands, &named_again);
                let advice = format!("`{command}` goes on");
                if let Err(error) = interrupt::advise(advice, self.printer) {
                    self.printer.error(&error);
                }
            }
            Event::Started { total } => {
                self.replace(Some(SimulationProgress::new(self.printer, total)));
            }
            Event::Stepped => self.of_simulations(SimulationProgress::step),
            Event::CallFailed(call) => self.aside(&call.to_string()),
            Event::SimulationFailed { failure } => self.aside(&format!("failed: {failure}")),
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

impl Counts {
    /// The words of the bar, the most important first, as many as leave room for it.
    fn words(&self, ended: u64, passed: Duration, columns: usize) -> String {
        let failed = self.failed.load(Ordering::Relaxed);
        let steps = self.steps.load(Ordering::Relaxed);
        let parts = [
            format!("{failed} failed"),
            format!("{:.1}/min", a_minute(ended as f64, passed)),
            format!("{steps} steps"),
        ];
        let mut words = format!("{ended}/{} simulations {}", self.total, self.left());
        for part in parts {
            if words.len() + 1 + part.len() + MIN_BAR < columns {
                words = format!("{words} {part}");
            }
        }
        words
    }
}

/// Columns of the terminal on stderr, where bars are.
fn columns() -> usize {
    let size = Term::stderr().size_checked();
    size.map_or(COLUMNS, |(_, columns)| usize::from(columns))
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
            let words = move |state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write| {
                // A bar that cannot be written is no error of the run.
                let _ = out.write_str(&of_bar.words(state.pos(), state.elapsed(), columns()));
            };
            bar.set_style(style.with_key("words", words));
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
            self.bar.tick();
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

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::{ProgressDrawTarget, TermLike};
    use std::io;
    use std::sync::Arc;

    /// Time since the start of the run.
    const PASSED: Duration = Duration::from_mins(10);

    /// A terminal of some columns that stores its text.
    #[derive(Debug, Clone, Default)]
    struct Paper {
        columns: u16,
        text: Arc<Mutex<String>>,
    }

    impl TermLike for Paper {
        fn width(&self) -> u16 {
            self.columns
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
            let mut paper = self.text.lock().unwrap();
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

    /// A run of many simulations that is almost complete.
    fn large() -> Counts {
        Counts {
            total: 12_800,
            started: Instant::now().checked_sub(PASSED).unwrap(),
            ended: AtomicUsize::new(12_799),
            failed: AtomicUsize::new(99),
            steps: AtomicUsize::new(1_907_200),
        }
    }

    #[test]
    fn a_bar_takes_the_width_of_its_terminal() {
        for columns in [60, 80, 100, 160] {
            let words = large().words(12_799, PASSED, columns);
            assert!(
                words.starts_with("12799/12800 simulations 0s left"),
                "{words}"
            );
            assert!(words.contains("99 failed"), "{words}");
            assert_eq!(words.contains("1907200 steps"), columns >= 80, "{words}");
            assert!(words.len() + MIN_BAR < columns, "{columns}: {words}");
        }
        // Without a terminal on stderr the words are those of 80 columns.
        for columns in [80, 100, 160] {
            let paper = Paper {
                columns,
                ..Paper::default()
            };
            let target = ProgressDrawTarget::term_like_with_hz(Box::new(paper.clone()), 255);
            let bar = ProgressBar::with_draw_target(Some(12_800), target).with_elapsed(PASSED);
            let printer = Printer::new(false, true);
            let progress = SimulationProgress::with_counts(printer, bar, Arc::new(large()));
            progress.bar.set_position(12_799);
            progress.bar.force_draw();
            let drawn = paper.text.lock().unwrap().clone();
            let line = drawn.lines().rfind(|line| !line.is_empty()).unwrap();
            assert!(line.starts_with("12799/12800 simulations"), "{drawn}");
            let width = console::measure_text_width(line);
            assert_eq!(width, usize::from(columns), "{drawn}");
        }
        let progress = SimulationProgress::with_counts(
            Printer::new(false, true),
            ProgressBar::hidden(),
            Arc::new(large()),
        );
        let line = progress.line(99, 1_907_200);
        assert!(console::measure_text_width(&line) <= 80, "{line}");
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
