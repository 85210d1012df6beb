//! The deadline of a planning call.

use super::MllmError;
use std::time::{Duration, Instant};

/// When a planning call must end. The default is no deadline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    pub const NONE: Self = Self(None);

    /// `limit` after `start`; no deadline if the clock cannot represent that time.
    pub fn after(start: Instant, limit: Duration) -> Self {
        Self(start.checked_add(limit))
    }

    /// The remaining time, zero after the deadline; `None` without a deadline.
    pub fn left(self) -> Option<Duration> {
        self.0
            .map(|at| at.saturating_duration_since(Instant::now()))
    }

    /// # Errors
    /// [`MllmError::Deadline`] after the deadline.
    pub fn check(self) -> Result<(), MllmError> {
        match self.left() {
            Some(Duration::ZERO) => Err(MllmError::Deadline),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadline_passes_and_none_never_does() {
        let now = Instant::now();
        assert!(matches!(
            Deadline::after(now, Duration::ZERO).check(),
            Err(MllmError::Deadline)
        ));
        let later = Deadline::after(now, Duration::from_hours(1));
        assert!(later.check().is_ok() && later.left().unwrap() > Duration::from_secs(3500));
        assert!(Deadline::NONE.check().is_ok() && Deadline::NONE.left().is_none());
        assert_eq!(Deadline::after(now, Duration::MAX), Deadline::NONE);
    }
}
