//! What the two kinds of adapters share: what one says about itself, the names of PEFT's files, and
//! how an adapter is refused.

use super::missing::Announced;
use crate::MllmError;
use std::path::Path;

/// The settings of a PEFT adapter.
pub(crate) const PEFT_CONFIG: &str = "adapter_config.json";
/// The tensors of a PEFT adapter.
pub(super) const PEFT_WEIGHTS: &str = "adapter_model.safetensors";

/// What an adapter says about itself beside its tensors.
#[derive(Debug, Default)]
pub(super) struct About {
    /// Its kind in words.
    pub(super) kind: String,
    /// The model that it was trained for, as it says.
    pub(super) base: Option<String>,
    /// Whether an adapted embedding is the output layer too where the base ties the two.
    pub(super) tied: bool,
    /// What it says that it changes, of an adapter of PEFT.
    pub(super) announced: Option<Announced>,
    pub(super) notes: Vec<String>,
}

pub(super) fn refused(path: &Path, problem: impl Into<String>) -> MllmError {
    MllmError::Adapter {
        path: path.to_path_buf(),
        problem: problem.into(),
    }
}
