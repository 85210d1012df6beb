//! A record of intermediate results.

use candle_core::Tensor;
use std::collections::BTreeMap;

/// Keeps intermediate results by the names of PyTorch's modules, for tests; switched off, it keeps nothing.
#[derive(Debug, Default)]
pub struct Probe {
    kept: Option<BTreeMap<String, Tensor>>,
}

impl Probe {
    /// Keeps nothing.
    pub fn off() -> Self {
        Self::default()
    }

    /// Keeps everything.
    pub fn on() -> Self {
        Self { kept: Some(BTreeMap::new()) }
    }

    /// Notes a result. A name that is noted again gets `#1`, `#2` and so on.
    pub(in crate::planner::learned) fn note(&mut self, name: &str, result: &Tensor) {
        let Some(kept) = &mut self.kept else { return };
        let mut key = name.to_owned();
        let mut times = 0;
        while kept.contains_key(&key) {
            times += 1;
            key = format!("{name}#{times}");
        }
        kept.insert(key, result.clone());
    }

    /// The result of this name.
    pub fn get(&self, name: &str) -> Option<&Tensor> {
        self.kept.as_ref()?.get(name)
    }
}
