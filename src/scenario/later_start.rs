//! Scenarios that start later than their source says: `WORD@SECONDS`. What lies before is their
//! history.

use super::reader::{OpenScenario, ReaderError, ScenarioRef};
use super::{Contents, Scenario};
use planagent_world::STEP_S;
use std::path::PathBuf;
use std::sync::Arc;

/// Between the word and the seconds.
pub(super) const MARK: char = '@';

/// A start after the usual one, in iterations of 0.1 s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LaterStart(pub(super) usize);

impl LaterStart {
    /// The word before the mark and the start behind it; `None` for a word without.
    pub(super) fn parse(word: &str) -> Option<(&str, Self)> {
        let (base, seconds) = word.rsplit_once(MARK)?;
        let plain = !seconds.is_empty() && seconds.chars().all(|c| c.is_ascii_digit() || c == '.');
        let seconds: f64 = seconds.parse().ok().filter(|_| plain && !base.is_empty())?;
        Some((base, Self((seconds / STEP_S).round() as usize)))
    }

    /// A word with this start.
    pub(super) fn mark(self, word: &str) -> String {
        format!("{word}{MARK}{}", self.0 as f64 / 10.0)
    }

    fn too_late(self, iterations: usize) -> ReaderError {
        ReaderError::StartsTooLate {
            start_s: self.0 as f64 * STEP_S,
            end_s: iterations.saturating_sub(1) as f64 * STEP_S,
        }
    }
}

/// A word or name without its later start.
pub fn without_start(word: &str) -> &str {
    LaterStart::parse(word).map_or(word, |(base, _)| base)
}

/// A scenario that starts later.
struct StartedLater {
    source: Arc<dyn OpenScenario>,
    start: LaterStart,
}

impl OpenScenario for StartedLater {
    fn open(&self) -> Result<Scenario, ReaderError> {
        let mut scenario = self.source.open()?;
        let iterations = scenario.iterations();
        if self.start.0 + 1 >= iterations {
            return Err(self.start.too_late(iterations));
        }
        scenario.start += self.start.0;
        scenario.id = self.start.mark(&scenario.id);
        Ok(scenario)
    }

    fn check(&self) -> Result<(), ReaderError> {
        self.source.check()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.source.files()
    }

    fn contents(&self) -> Result<Option<Contents>, ReaderError> {
        let Some(contents) = self.source.contents()? else {
            return Ok(None);
        };
        let iterations = contents
            .iterations
            .checked_sub(self.start.0)
            .filter(|&left| left > 1);
        iterations
            .map(|iterations| {
                Some(Contents {
                    iterations,
                    ..contents
                })
            })
            .ok_or_else(|| self.start.too_late(contents.iterations))
    }
}

impl ScenarioRef {
    /// The same scenario, started `iterations` of 0.1 s later: its word and id end in `@SECONDS`.
    #[must_use]
    pub fn started_later(self, iterations: usize) -> Self {
        let start = LaterStart(iterations);
        self.with_source(
            |word| start.mark(word),
            |source| Arc::new(StartedLater { source, start }),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DataRoots, Readers};

    const WORD: &str = "generated/changing_lane/3";

    fn found(word: &str) -> ScenarioRef {
        Readers::new(&DataRoots::default())
            .find(word)
            .unwrap()
            .swap_remove(0)
    }

    #[test]
    fn a_word_may_end_in_a_start() {
        assert_eq!(
            LaterStart::parse("a/b.tfrecord@3"),
            Some(("a/b.tfrecord", LaterStart(30)))
        );
        assert_eq!(LaterStart::parse("a@b@2.5"), Some(("a@b", LaterStart(25))));
        for plain in [
            "a/b.tfrecord",
            "me@home",
            "@3",
            "a@",
            "a@-1",
            "a@1e3",
            "a@.",
        ] {
            assert_eq!(LaterStart::parse(plain), None, "{plain}");
        }
        assert_eq!(LaterStart(25).mark("a"), "a@2.5");
    }

    #[test]
    fn the_later_scenario_has_the_earlier_frames_as_history() {
        let (whole, later) = (found(WORD).open().unwrap(), found(&format!("{WORD}@4.5")));
        assert_eq!(
            (later.to_string(), later.id()),
            (format!("{WORD}@4.5"), Some("generated/changing_lane/3@4.5"))
        );
        assert_eq!(later, found(WORD).started_later(45));
        let later = later.open().unwrap();
        assert_eq!(later.id, format!("{}@4.5", whole.id));
        assert_eq!(
            (later.start, later.iterations()),
            (whole.start + 45, whole.iterations() - 45)
        );
        assert_eq!(later.frame(0), whole.frame(45));
    }

    #[test]
    fn a_start_behind_the_end_is_refused() {
        let error = found(&format!("{WORD}@99")).open().unwrap_err().to_string();
        assert!(
            error.contains("99.0 s") && error.contains("15.0 s"),
            "{error}"
        );
    }
}
