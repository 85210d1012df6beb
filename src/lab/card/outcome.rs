//! What a card may lack, and shares with their intervals.

use planagent_runs::worker::statistics::wilson;
use serde::Serialize;

/// A part of a card, or why there is none. What is not known is never a zero.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub(super) enum Part<T> {
    Known(T),
    Missing {
        /// The reason, in a few words.
        not_available: String,
    },
}

impl<T> Part<T> {
    pub(super) fn missing(why: impl Into<String>) -> Self {
        Self::Missing {
            not_available: why.into(),
        }
    }

    pub(super) fn known(&self) -> Option<&T> {
        match self {
            Self::Known(part) => Some(part),
            Self::Missing { .. } => None,
        }
    }

    /// The sentence of a missing part.
    pub(super) fn why_not(&self) -> Option<String> {
        match self {
            Self::Known(_) => None,
            Self::Missing { not_available } => Some(format!("Not available: {not_available}.")),
        }
    }
}

/// A share of states with Wilson's 95 % interval, percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Share {
    pub(super) count: usize,
    pub(super) of: usize,
    /// None of none.
    pub(super) percent: Option<f64>,
    pub(super) interval: [f64; 2],
}

impl Share {
    pub(super) fn new(count: usize, of: usize) -> Self {
        Self {
            count,
            of,
            percent: (of > 0).then(|| 100.0 * count as f64 / of as f64),
            interval: wilson(count, of).map(|bound| 100.0 * bound),
        }
    }

    /// The share of items for which something holds.
    pub(super) fn counted<T>(
        items: impl IntoIterator<Item = T>,
        holds: impl Fn(&T) -> bool,
    ) -> Self {
        let (mut count, mut of) = (0, 0);
        for item in items {
            of += 1;
            count += usize::from(holds(&item));
        }
        Self::new(count, of)
    }
}
