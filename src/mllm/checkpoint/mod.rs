//! The files of a model: weights, and the parts of configurations that several families share.

mod config;
mod files;
mod layers;
mod llama_config;
mod load_report;
mod row_order;
pub(crate) mod safetensors_folder;
mod vision_config;
mod weight_file;
mod weight_format_plan;
mod weights;

use std::path::Path;

use serde_json::Value;

pub(crate) use config::{ConfigObject, OneOrMany, positive};
pub use files::ModelFiles;
pub(crate) use llama_config::DecoderType;
pub use llama_config::LlamaConfig;
pub use load_report::in_bytes;
pub use load_report::{LoadReport, WeightFormatException, WeightFormatShare};
pub(crate) use row_order::{RowOrder, paired};
pub(crate) use vision_config::{TowerType, VisionConfig};
pub(crate) use weight_file::{TensorPlace, TensorSource, WeightFile};
pub(crate) use weight_format_plan::{FileKind, WeightFormatPlan, held_as, is_matrix};
pub use weights::Weights;
pub(crate) use weights::in_four_dimensions;

use super::MllmError;

/// Largest tokenizer.json, bytes. That of 262 thousand tokens has 34 MB.
const MAX_TOKENIZER_BYTES: u64 = 128 << 20;
/// Largest list of shards or of a tokenizer's special tokens, bytes. Published ones have up to 2 MB.
const MAX_LIST_BYTES: u64 = 16 << 20;
/// Largest configuration and chat template, bytes.
const MAX_CONFIG_BYTES: u64 = 1 << 20;
/// Maximum number of small files in a model's folder.
pub(crate) const MAX_SMALL_FILES: usize = 256;

/// Largest small file of this name, bytes. Others are refused before they are read.
pub(crate) fn small_file_limit(path: &Path) -> u64 {
    const CONFIGS: [&str; 4] = ["config.json", "generation_config.json", "preprocessor_config.json", "planagent.json"];
    let is = |name: &str| path.file_name().is_some_and(|own| own == name);
    if is("tokenizer.json") {
        MAX_TOKENIZER_BYTES
    } else if CONFIGS.into_iter().any(is) || path.extension().is_some_and(|ending| ending == "jinja") {
        MAX_CONFIG_BYTES
    } else {
        MAX_LIST_BYTES
    }
}

pub(crate) fn read_text(path: &Path) -> Result<String, MllmError> {
    let text = planagent_files::read_text(path, small_file_limit(path))
        .map_err(|source| MllmError::Read { path: path.to_path_buf(), source })?;
    if weight_file::is_lfs_pointer(text.as_bytes()) {
        return Err(MllmError::LfsPointer { path: path.to_path_buf() });
    }
    Ok(text)
}

pub(crate) fn read_json(path: &Path) -> Result<Value, MllmError> {
    serde_json::from_str(&read_text(path)?).map_err(|source| MllmError::Json { path: path.to_path_buf(), source })
}
