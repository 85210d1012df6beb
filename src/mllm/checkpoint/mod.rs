//! A model folder as Hugging Face writes it: weights, and the parts of configurations that several families share.

mod activation;
mod clip_config;
mod llama_config;
mod random;
mod section;
mod weights;

use std::path::Path;

use serde_json::Value;

pub(crate) use activation::Activation;
pub(crate) use clip_config::{CLIP_BASE, ClipVisionConfig, LLAVA_TOWER};
pub(crate) use llama_config::{LlamaConfig, Rope, RopeScaling};
pub(crate) use section::Section;
pub(crate) use weights::Weights;

use super::MllmError;

/// Reads a file as text.
pub(crate) fn read_text(path: &Path) -> Result<String, MllmError> {
    std::fs::read_to_string(path).map_err(|source| MllmError::Read { path: path.to_path_buf(), source })
}

/// Reads a JSON file.
pub(crate) fn read_json(path: &Path) -> Result<Value, MllmError> {
    serde_json::from_str(&read_text(path)?).map_err(|source| MllmError::Json { path: path.to_path_buf(), source })
}

/// Reads a JSON file that a folder must hold.
pub(crate) fn read_required_json(folder: &Path, file: &str) -> Result<Value, MllmError> {
    let path = folder.join(file);
    if path.is_file() {
        read_json(&path)
    } else {
        Err(MllmError::MissingFile { folder: folder.to_path_buf(), file: file.to_string() })
    }
}
