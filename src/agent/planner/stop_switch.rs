//! The switch that ends the simulations of a run.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A switch that ends a run: its simulations fail at their next step, commands are waited for no
/// longer, and no further simulation starts.
#[derive(Debug, Clone, Default)]
pub struct StopSwitch {
    own: Arc<AtomicBool>,
    /// The switch that this one is a part of.
    above: Option<Arc<AtomicBool>>,
}

impl StopSwitch {
    /// A switch that stops with this one, and alone. It is no part of a part.
    #[doc(hidden)]
    #[must_use]
    pub fn part(&self) -> Self {
        Self {
            own: Arc::default(),
            above: Some(Arc::clone(&self.own)),
        }
    }

    /// Stops the run.
    pub fn stop(&self) {
        self.own.store(true, Ordering::Relaxed);
    }

    /// Whether the run is to stop.
    pub fn is_stopped(&self) -> bool {
        let is_set = |flag: &Arc<AtomicBool>| flag.load(Ordering::Relaxed);
        is_set(&self.own) || self.above.as_ref().is_some_and(is_set)
    }
}
