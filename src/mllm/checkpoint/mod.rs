//! The files of a model: weights, and the parts of configurations that several families share.

mod activation;
mod config;
mod files;
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

pub(crate) use activation::Activation;
pub(crate) use config::{ConfigObject, OneOrMany, positive};
pub use files::ModelFiles;
pub use llama_config::LlamaConfig;
pub(crate) use llama_config::{DecoderType, Rope, RopeScaling, RotarySections};
pub(crate) use load_report::in_bytes;
pub use load_report::{LoadReport, WeightFormatException, WeightFormatShare};
pub(crate) use row_order::{RowOrder, paired};
pub(crate) use vision_config::VisionConfig;
pub(crate) use weight_file::{TensorPlace, TensorSource, WeightFile};
pub(crate) use weight_format_plan::{FileKind, WeightFormatPlan, held_as, is_matrix};
pub use weights::Weights;
pub(crate) use weights::in_four_dimensions;

use super::MllmError;

pub(crate) fn read_text(path: &Path) -> Result<String, MllmError> {
    std::fs::read_to_string(path).map_err(|source| MllmError::Read { path: path.to_path_buf(), source })
}

pub(crate) fn read_json(path: &Path) -> Result<Value, MllmError> {
    serde_json::from_str(&read_text(path)?).map_err(|source| MllmError::Json { path: path.to_path_buf(), source })
}
