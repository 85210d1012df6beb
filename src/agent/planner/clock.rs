//! The agent's clock. It runs in the scene's time, so that an agent plans at the same times at any
//! step length.

use planagent_world::MICROS_PER_SECOND;

/// The time of the last planning call and of the present step; times of the scene, µs.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    started: Option<i64>,
    step: Option<i64>,
    step_us: i64,
    called: Option<i64>,
}

impl Clock {
    /// Begins a step.
    pub fn step(&mut self, now_us: i64) {
        self.started.get_or_insert(now_us);
        self.step_us = self
            .step
            .replace(now_us)
            .map_or(0, |previous| now_us - previous);
    }

    /// Whether a planning call is due at this step, this time after the last one, seconds: no later
    /// step is nearer. The first call is due at once.
    pub fn is_due(&self, interval_s: f64) -> bool {
        let (Some(called), Some(step)) = (self.called, self.step) else {
            return true;
        };
        step + self.step_us / 2 >= called + (interval_s * MICROS_PER_SECOND).round() as i64
    }

    /// A planning call is made at this step.
    pub fn set_called(&mut self) {
        self.called = self.step;
    }

    /// A planning call is due at the next step.
    pub(crate) fn set_due(&mut self) {
        self.called = None;
    }

    /// Seconds since the first step.
    pub fn elapsed_s(&self, now_us: i64) -> f64 {
        self.started
            .map_or(0.0, |started| (now_us - started) as f64 / MICROS_PER_SECOND)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps at which calls are due every 2 s.
    fn due(step_us: impl Fn(i64) -> i64, steps: i64) -> Vec<i64> {
        let mut clock = Clock::default();
        let is_due = |k: &i64| {
            clock.step(1_600_000_000_000_000 + step_us(*k));
            let due = clock.is_due(2.0);
            if due {
                clock.set_called();
            }
            due
        };
        (0..steps).filter(is_due).collect()
    }

    #[test]
    fn calls_are_due_every_two_seconds_at_any_step_length() {
        assert_eq!(due(|k| k * 100_000, 61), [0, 20, 40, 60]);
        assert_eq!(due(|k| k * 50_000, 121), [0, 40, 80, 120]);
        assert_eq!(due(|k| k * 200_000, 31), [0, 10, 20, 30]);
        assert_eq!(due(|k| k * 300_000, 15), [0, 7, 14]);
        assert_eq!(due(|k| k * 5_000_000, 3), [0, 1, 2]);
    }

    #[test]
    fn a_shorter_interval_is_asked_for_at_the_same_step() {
        let mut clock = Clock::default();
        clock.step(0);
        clock.set_called();
        clock.step(500_000);
        assert!(clock.is_due(0.5) && !clock.is_due(2.0));
        clock.set_due();
        assert!(clock.is_due(2.0), "a call was asked for");
    }

    #[test]
    fn recorded_times_that_jitter_or_run_slow_keep_their_iterations() {
        assert_eq!(
            due(|k| k * 100_000 + [0, 4_000, -3_000][k as usize % 3], 150),
            [0, 20, 40, 60, 80, 100, 120, 140]
        );
        assert_eq!(due(|k| k * 99_000, 150), [0, 20, 40, 60, 80, 100, 120, 140]);
    }
}
