//! Which part of a recording is driven.
//!
//! The drive begins at the first step with 2 s of history (1 s when the recording is shorter than 12 s) and lasts to the end of
//! the recording, at most 15 s; the steps before it are kept as history.

use crate::world::MICROS_PER_SECOND;
use std::ops::{Range, RangeInclusive};

/// Recordings shorter than this spend less on history, s.
const LONG_RECORDING: f64 = 12.0;
/// History of a long recording, s.
const LONG_HISTORY: f64 = 2.0;
/// History of a short recording, s.
const SHORT_HISTORY: f64 = 1.0;
/// Longest drive, s: nuPlan's scenario duration.
const LONGEST_DRIVE: f64 = 15.0;
/// Half a step, s: recorded times jitter.
const HALF_STEP: f64 = 0.05;
/// Steps of the shortest recording that can be driven: a second of history and a second of driving.
const MIN_STEPS: usize = 21;
/// Steps may be this much apart, s.
const STEP_RANGE: RangeInclusive<f64> = 0.05..=0.15;

/// Why the steps of a recording cannot be driven.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TimeFault {
    /// Too few steps to be driven.
    #[error("{steps} steps are too few: {needed} are needed")]
    TooShort {
        /// Steps of the recording.
        steps: usize,
        /// Steps that a drive needs at least.
        needed: usize,
    },
    /// Steps are not a tenth of a second apart.
    #[error("step {step} lies {seconds} s after its predecessor; recordings have 10 Hz")]
    StepTime {
        /// Which step.
        step: usize,
        /// Its distance from the step before, s.
        seconds: f64,
    },
}

/// Whole microseconds from the first step.
///
/// # Errors
/// When the steps are too few or not a tenth of a second apart.
pub(in crate::scenario) fn step_times(seconds: &[f64]) -> Result<Vec<i64>, TimeFault> {
    if seconds.len() < MIN_STEPS {
        return Err(TimeFault::TooShort { steps: seconds.len(), needed: MIN_STEPS });
    }
    let odd = seconds.windows(2).position(|pair| !STEP_RANGE.contains(&(pair[1] - pair[0])));
    if let Some(step) = odd {
        return Err(TimeFault::StepTime { step: step + 1, seconds: seconds[step + 1] - seconds[step] });
    }
    Ok(seconds.iter().map(|t| ((t - seconds[0]) * MICROS_PER_SECOND).round() as i64).collect())
}

/// The steps that are driven; those before are history.
pub(in crate::scenario) fn window(times_us: &[i64]) -> Range<usize> {
    let seconds = |step: usize| times_us.get(step).map_or(0.0, |&t| t as f64 / MICROS_PER_SECOND);
    let duration = seconds(times_us.len().saturating_sub(1));
    let history = if duration < LONG_RECORDING { SHORT_HISTORY } else { LONG_HISTORY };
    let first = |after: f64| (0..times_us.len()).find(|&step| seconds(step) >= after).unwrap_or(times_us.len());
    let start = first(history - HALF_STEP);
    start..first(seconds(start) + LONGEST_DRIVE + HALF_STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(count: i64) -> Vec<i64> {
        (0..count).map(|i| i * 100_000).collect()
    }

    #[test]
    fn windows_are_cut_as_documented() {
        assert_eq!(window(&steps(91)), 10..91);
        assert_eq!(window(&steps(120)), 10..120);
        assert_eq!(window(&steps(121)), 20..121);
        assert_eq!(window(&steps(199)), 20..171);
        assert_eq!(window(&steps(21)), 10..21);
    }

    #[test]
    fn only_ten_hertz_is_taken() {
        let mut seconds: Vec<f64> = (0..30).map(|i| 5.0 + f64::from(i) * 0.1).collect();
        assert_eq!(step_times(&seconds).unwrap()[29], 2_900_000);
        seconds[7] = f64::NAN;
        assert!(matches!(step_times(&seconds), Err(TimeFault::StepTime { step: 7, .. })));
        seconds[7] = seconds[6];
        assert!(matches!(step_times(&seconds), Err(TimeFault::StepTime { step: 7, .. })));
        assert_eq!(step_times(&seconds[..20]), Err(TimeFault::TooShort { steps: 20, needed: 21 }));
    }
}
