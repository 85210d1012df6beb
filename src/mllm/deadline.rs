//! The instant at which a planning call must end.

use std::time::{Duration, Instant};

use super::MllmError;

/// When a planning call must end; by default never.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    /// No deadline.
    pub const NONE: Self = Self(None);

    /// A deadline this long after an instant; none if that lies beyond what the clock can tell.
    pub fn after(start: Instant, limit: Duration) -> Self {
        Self(start.checked_add(limit))
    }

    /// Whether there is one.
    pub fn is_set(self) -> bool {
        self.0.is_some()
    }

    /// What is left until then, zero once it has passed; `None` without a deadline.
    pub fn left(self) -> Option<Duration> {
        self.0.map(|at| at.saturating_duration_since(Instant::now()))
    }

    /// Goes on while there is time.
    ///
    /// # Errors
    /// [`MllmError::Deadline`] once it has passed.
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
        assert!(matches!(Deadline::after(now, Duration::ZERO).check(), Err(MllmError::Deadline)));
        let later = Deadline::after(now, Duration::from_secs(3600));
        assert!(later.check().is_ok() && later.left().unwrap() > Duration::from_secs(3500));
        assert!(Deadline::NONE.check().is_ok() && Deadline::NONE.left().is_none() && !Deadline::NONE.is_set());
        assert_eq!(Deadline::after(now, Duration::MAX), Deadline::NONE);
    }
}
