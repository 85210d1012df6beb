//! The files of an adapter.

use crate::MllmError;
use crate::checkpoint::{TensorPlace, TensorSource, WeightFile};
use std::path::Path;

/// The weights of an adapter, and what else decides its result. Its digest is part of the model's.
#[derive(Debug)]
pub(super) struct AdapterFiles {
    pub(super) weights: WeightFile,
    /// The settings beside the weights.
    pub(super) settings: Vec<u8>,
}

impl TensorSource for AdapterFiles {
    fn path(&self) -> &Path {
        self.weights.path()
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        self.weights.bytes(place)
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        hasher.update(b"adapter");
        hasher.update(&(self.settings.len() as u64).to_le_bytes());
        hasher.update(&self.settings);
        self.weights.hash(hasher)
    }
}
