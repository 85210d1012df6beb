//! The recent past.

use super::{EgoState, TrackedObject};
use std::collections::VecDeque;
use std::sync::Arc;

/// Capacity of the buffer, samples: 2.1 s at 10 Hz, both ends included (devkit
/// `simulation_history_buffer.py`).
pub const HISTORY_SAMPLES: usize = 22;

/// The ego and its surroundings at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct HistorySample {
    /// State of the ego.
    pub ego: EgoState,
    /// Objects around it.
    pub objects: Arc<[TrackedObject]>,
}

/// The last [`HISTORY_SAMPLES`] samples, oldest first; the newest is the present.
#[derive(Debug, Clone, Default)]
pub struct History {
    samples: VecDeque<HistorySample>,
}

impl History {
    /// Appends the newest sample and drops the oldest when full.
    pub fn push(&mut self, sample: HistorySample) {
        if self.samples.len() == HISTORY_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
    }

    /// The samples, oldest first.
    pub fn samples(&self) -> impl DoubleEndedIterator<Item = &HistorySample> + ExactSizeIterator {
        self.samples.iter()
    }

    /// The newest sample, if there is one.
    pub fn latest(&self) -> Option<&HistorySample> {
        self.samples.back()
    }
}
