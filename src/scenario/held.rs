//! A scenario that a simulation borrows or shares.

use super::Scenario;
use std::ops::Deref;
use std::sync::Arc;

/// A borrowed scenario, or one with several owners. A simulation of the latter outlives the
/// function that starts it.
#[derive(Debug, Clone)]
pub enum HeldScenario<'a> {
    /// Of the caller.
    Borrowed(&'a Scenario),
    /// Owned together with others.
    Shared(Arc<Scenario>),
}

impl Deref for HeldScenario<'_> {
    type Target = Scenario;

    fn deref(&self) -> &Scenario {
        match self {
            Self::Borrowed(scenario) => scenario,
            Self::Shared(scenario) => scenario,
        }
    }
}

impl<'a> From<&'a Scenario> for HeldScenario<'a> {
    fn from(scenario: &'a Scenario) -> Self {
        Self::Borrowed(scenario)
    }
}

impl<'a> From<&'a Arc<Scenario>> for HeldScenario<'a> {
    fn from(scenario: &'a Arc<Scenario>) -> Self {
        Self::Borrowed(scenario)
    }
}

impl From<Arc<Scenario>> for HeldScenario<'_> {
    fn from(scenario: Arc<Scenario>) -> Self {
        Self::Shared(scenario)
    }
}
