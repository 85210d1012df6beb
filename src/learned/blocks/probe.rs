//! A record of intermediate results.

use candle_core::Tensor;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Keeps intermediate results by the names of PyTorch's modules, for tests; switched off, it keeps
/// nothing. Parts of a network that run at the same time may note results with different names.
#[derive(Debug, Default)]
pub struct Probe {
    results: Option<Mutex<BTreeMap<String, Tensor>>>,
}

impl Probe {
    /// Keeps nothing.
    pub fn off() -> Self {
        Self::default()
    }

    /// Keeps everything.
    pub fn on() -> Self {
        Self {
            results: Some(Mutex::default()),
        }
    }

    /// Notes a result. A name that is noted again gets `#1`, `#2` and so on.
    pub(crate) fn note(&self, name: &str, result: &Tensor) {
        let Some(results) = &self.results else { return };
        let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
        let mut key = name.to_owned();
        let mut times = 0;
        while results.contains_key(&key) {
            times += 1;
            key = format!("{name}#{times}");
        }
        results.insert(key, result.clone());
    }

    /// Notes a result that nothing else needs.
    pub(crate) fn note_with(
        &self,
        name: &str,
        result: impl FnOnce() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<()> {
        if self.results.is_some() {
            self.note(name, &result()?);
        }
        Ok(())
    }

    /// The result of this name.
    pub fn get(&self, name: &str) -> Option<Tensor> {
        self.results
            .as_ref()?
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(name)
            .cloned()
    }
}
