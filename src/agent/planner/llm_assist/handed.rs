//! Answers of what stands in a model's place.

use crate::reasoning::Assistance;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// The answers of the next planning call, an attempt each. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct HandedAnswers(Arc<Mutex<VecDeque<Assistance>>>);

impl HandedAnswers {
    /// Hands over the answers of the next call, in place of what the last one left.
    pub fn hand(&self, answers: impl IntoIterator<Item = Assistance>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = answers.into_iter().collect();
    }

    pub(super) fn next(&self) -> Option<Assistance> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop_front()
    }
}
