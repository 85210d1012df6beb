//! The only module that prints: data to stdout, notes and progress to stderr, colors only on
//! terminals. stdout and stderr may be full or closed: the work goes on.

use super::Exit;
use super::csv::csv_text;
use super::suggest;
use clap::error::ContextValue;
use console::{Style, Term, measure_text_width};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use planagent_files::shortened;
use planagent_runs::report::{LineWidth, json_value, visible, visible_line};
use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Prints for one invocation.
#[derive(Debug, Clone, Copy)]
pub struct Printer {
    json: bool,
    quiet: bool,
    details: bool,
}

impl Printer {
    /// A printer. With `json`, stdout carries JSON alone; with `quiet`, stderr carries errors
    /// alone.
    pub fn new(json: bool, quiet: bool) -> Self {
        Self {
            json,
            quiet,
            details: false,
        }
    }

    /// With details on stderr.
    pub(crate) fn with_details(self, details: bool) -> Self {
        Self { details, ..self }
    }

    /// A line on stderr for users who ask for details.
    pub fn detail(&self, text: impl AsRef<str>) {
        if self.details {
            self.note(text);
        }
    }

    /// Whether stdout carries JSON.
    pub(crate) fn is_json(self) -> bool {
        self.json
    }

    /// A line on stdout, unless stdout carries JSON.
    pub fn line(&self, text: impl AsRef<str>) {
        if !self.json {
            write_line(&visible(text.as_ref()));
        }
    }

    /// Tables on stdout, unless stdout carries JSON. They have emphasis, and no text from outside
    /// in it: [`planagent_runs::report::table::Table`] shows what a terminal would obey.
    pub fn table(&self, text: impl AsRef<str>) {
        if !self.json {
            write_line(&shown(text.as_ref()));
        }
    }

    /// A piece of text on stdout at once, without the end of a line, unless stdout carries JSON.
    pub fn piece(&self, text: &str) {
        if !self.json {
            let (text, mut out) = (visible(text), std::io::stdout().lock());
            note_failure(&out.write_all(text.as_bytes()).and_then(|()| out.flush()));
        }
    }

    /// A name with details beside it, or below it where the line would be too long. The name is
    /// never broken, so that it can be copied.
    pub fn named(&self, name: &str, details: &str) {
        self.line(named_within(
            &visible_line(name),
            &visible_line(details),
            self.columns(),
        ));
    }

    /// A value on stdout, as one line of JSON.
    pub fn json(&self, value: &impl serde::Serialize) -> anyhow::Result<()> {
        write_line(&visible(&json_value(value)?.to_string()));
        Ok(())
    }

    /// Rows on stdout, as CSV.
    pub fn csv(&self, rows: &[impl serde::Serialize]) -> anyhow::Result<()> {
        let text = csv_text(rows)?;
        if !text.is_empty() {
            write_line(&visible(text.trim_end()));
        }
        Ok(())
    }

    /// A text of the program on stdout.
    pub fn text(&self, text: &str) {
        write_line(&visible(text));
    }

    /// A line on stderr.
    pub fn note(&self, text: impl AsRef<str>) {
        if !self.quiet {
            write_note(&visible(&shortened(text.as_ref())));
        }
    }

    /// An error with its causes.
    pub fn error(&self, error: &anyhow::Error) {
        let red = Style::new().for_stderr().red().bold();
        let mut text = String::new();
        for cause in error.chain().map(ToString::to_string) {
            // Many errors contain their cause; it is printed once.
            if text.is_empty() {
                text = cause;
            } else if !text.contains(&cause) {
                text = format!("{text}: {cause}");
            }
        }
        write_note(&format!(
            "{} {}",
            red.apply_to("error:"),
            visible(&shortened(&text))
        ));
        if let Some(tip) = suggest::tip(error) {
            write_note(&format!(
                "  {} {}",
                Style::new().for_stderr().green().apply_to("tip:"),
                visible(&tip)
            ));
        }
    }

    /// What clap says of the arguments: help and version on stdout, errors on stderr. The code that
    /// the program ends with.
    pub(crate) fn arguments(mut error: clap::Error, words: &[OsString]) -> Exit {
        if !error.use_stderr() {
            let written = error.print().and_then(|()| std::io::stdout().flush());
            note_failure(&written);
            return if STDOUT_FAILED.load(Ordering::Relaxed) {
                write_note(INCOMPLETE);
                Exit::Error
            } else {
                Exit::Success
            };
        }
        let is_safe = |text: &str| matches!(visible(text), Cow::Borrowed(_));
        if words.iter().all(|word| is_safe(&word.to_string_lossy())) {
            // A stderr that cannot be written changes nothing.
            let _ = error.print();
            return Exit::Error;
        }
        // An argument may be the name of a file of others, by a pattern of the shell. clap repeats
        // it as it is, and its own colors cannot be told from those of the name.
        let shown = |text: &String| visible(text).into_owned();
        let changed: Vec<_> = error
            .context()
            .filter_map(|(kind, value)| match value {
                ContextValue::String(text) => Some((kind, ContextValue::String(shown(text)))),
                ContextValue::Strings(texts) => {
                    let texts = texts.iter().map(shown).collect();
                    Some((kind, ContextValue::Strings(texts)))
                }
                _ => None,
            })
            .collect();
        for (kind, value) in changed {
            error.insert(kind, value);
        }
        write_note(visible(&error.render().to_string()).trim_end());
        Exit::Error
    }

    /// A failure of a part of the work, on stderr even if quiet.
    pub fn failure(&self, text: impl AsRef<str>) {
        write_note(&visible(&shortened(text.as_ref())));
    }

    /// Fails if some data could not be written to stdout, for example to a full disk; a closed pipe
    /// is no failure.
    pub fn finish(&self) -> anyhow::Result<()> {
        let flushed = std::io::stdout().lock().flush();
        if STDOUT_FAILED.load(Ordering::Relaxed)
            || flushed.is_err_and(|e| e.kind() != ErrorKind::BrokenPipe)
        {
            anyhow::bail!(INCOMPLETE);
        }
        Ok(())
    }

    /// A progress bar on stderr; hidden when quiet or without a terminal.
    pub fn progress(&self, length: u64, unit: &str) -> ProgressBar {
        let target = if self.quiet {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr()
        };
        let bar = ProgressBar::with_draw_target(Some(length), target);
        let template = format!("{{pos}}/{{len}} {unit} {{elapsed}} {{msg}} {{wide_bar}}");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style);
        }
        bar
    }

    /// A progress bar of bytes on stderr; hidden when quiet or without a terminal.
    pub(crate) fn byte_progress(self, length: u64) -> ProgressBar {
        let bar = self.progress(length, "bytes");
        if let Ok(style) = ProgressStyle::with_template(
            "{bytes}/{total_bytes} {bytes_per_sec} {eta} left {msg} {wide_bar}",
        ) {
            bar.set_style(style);
        }
        bar
    }

    /// Columns of the terminal on stdout; 80 when it is none.
    pub fn width(&self) -> u16 {
        self.columns().unwrap_or(80)
    }

    /// Columns of the terminal on stderr; 80 when it is none.
    pub(crate) fn note_width() -> u16 {
        Term::stderr()
            .size_checked()
            .map_or(80, |(_, columns)| columns)
    }

    /// The width of tables on stdout.
    pub(crate) fn line_width(self) -> LineWidth {
        self.columns().map_or(LineWidth::PIPE, LineWidth::terminal)
    }

    /// Columns of the terminal on stdout; none for a file or a pipe, whose lines stay whole.
    pub fn columns(&self) -> Option<u16> {
        Term::stdout().size_checked().map(|(_, columns)| columns)
    }
}

/// The emphasis that tables have: bold, dim, and its end.
const EMPHASIS: [&str; 3] = ["\u{1b}[1m", "\u{1b}[2m", "\u{1b}[0m"];

/// A text with visible control characters, apart from line feeds and the emphasis of tables.
fn shown(text: &str) -> Cow<'_, str> {
    if !text.contains('\u{1b}') {
        return visible(text);
    }
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find('\u{1b}') {
        let (before, from) = rest.split_at(at);
        out.push_str(&visible(before));
        let kept = EMPHASIS
            .into_iter()
            .find(|emphasis| from.starts_with(emphasis));
        out.push_str(kept.unwrap_or("\\u001b"));
        rest = from
            .get(kept.map_or(1, str::len)..)
            .expect("`from` begins with the emphasis or the escape");
    }
    out.push_str(&visible(rest));
    Cow::Owned(out)
}

/// A name with details beside it, or below it where the line would be wider than the terminal.
fn named_within(name: &str, details: &str, columns: Option<u16>) -> String {
    let width = measure_text_width(name) + 2 + measure_text_width(details);
    if details.is_empty() || columns.is_none_or(|columns| width <= usize::from(columns)) {
        format!("{name}  {details}").trim_end().to_owned()
    } else {
        format!("{name}\n  {details}")
    }
}

/// The error of a stdout that could not be written.
const INCOMPLETE: &str = "cannot write to stdout; the output is incomplete";

/// Whether a line could not be written.
static STDOUT_FAILED: AtomicBool = AtomicBool::new(false);

/// Writes a line to stdout; a closed pipe ends the output, not the program.
fn write_line(text: &str) {
    note_failure(&writeln!(std::io::stdout().lock(), "{text}"));
}

/// Writes a line to stderr. A stderr that is full or closed ends nothing: there is no other place to
/// say so.
fn write_note(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

fn note_failure(written: &std::io::Result<()>) {
    if written
        .as_ref()
        .is_err_and(|e| e.kind() != ErrorKind::BrokenPipe)
    {
        STDOUT_FAILED.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::{named_within, shown};

    #[test]
    fn only_emphasis_reaches_a_terminal() {
        assert_eq!(
            shown("\u{1b}[1mname\u{1b}[0m\n"),
            "\u{1b}[1mname\u{1b}[0m\n"
        );
        assert_eq!(
            shown("\u{1b}[2J\u{1b}]0;title\u{7}\u{9b}x"),
            "\\u001b[2J\\u001b]0;title\\u0007\\u009bx"
        );
    }

    #[test]
    fn details_move_below_a_name_only_on_a_narrow_terminal() {
        assert_eq!(
            named_within("a-name", "details", Some(15)),
            "a-name  details"
        );
        assert_eq!(
            named_within("a-name", "details", Some(14)),
            "a-name\n  details"
        );
        assert_eq!(named_within("a-name", "details", None), "a-name  details");
        assert_eq!(named_within("a-name", "", Some(3)), "a-name");
    }
}
