//! The files of a model: weights, and the parts of configurations that several families share.

mod activation;
mod files;
mod llama_config;
mod load_report;
mod random;
mod row_order;
mod safetensors_folder;
mod section;
mod vision_config;
mod weight_file;
mod weight_format_plan;
mod weights;

use std::path::{Path, PathBuf};

use serde_json::Value;

pub(crate) use activation::Activation;
pub(crate) use files::ModelFiles;
pub(crate) use llama_config::{LlamaConfig, Rope, RopeScaling};
pub(crate) use load_report::in_bytes;
pub use load_report::{LoadReport, WeightFormatException, WeightFormatShare};
pub(crate) use row_order::{RowOrder, paired};
pub(crate) use section::Section;
pub(crate) use vision_config::{CLIP_BASE, LLAVA_TOWER, VisionConfig};
pub(crate) use weight_file::{TensorPlace, WeightFile};
pub(crate) use weight_format_plan::{FileKind, WeightFormatPlan, is_matrix};
pub(crate) use weights::Weights;

use super::matrix::WeightFormat;
use super::{MllmError, ModelShape, gguf};

/// Reads a file as text.
pub(crate) fn read_text(path: &Path) -> Result<String, MllmError> {
    std::fs::read_to_string(path).map_err(|source| MllmError::Read { path: path.to_path_buf(), source })
}

/// Reads a JSON file.
pub(crate) fn read_json(path: &Path) -> Result<Value, MllmError> {
    serde_json::from_str(&read_text(path)?).map_err(|source| MllmError::Json { path: path.to_path_buf(), source })
}

/// Where the files of a model are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelPlace {
    /// A folder as Hugging Face writes it, or one with GGUF files that belong together.
    Folder(PathBuf),
    /// GGUF files.
    Gguf {
        /// The decoder, or the whole model.
        model: PathBuf,
        /// The vision tower; none if it is in the same file, or for the one that lies beside it.
        mmproj: Option<PathBuf>,
    },
    /// Random weights in the shape of a known model; [`DEFAULT_RANDOM_FORMAT`] unless another storage is asked for.
    Random {
        /// The shape.
        shape: &'static ModelShape,
        /// Seed of the weights.
        seed: u64,
    },
}

/// Storage of random weights unless told otherwise: that of the weights that are published.
const DEFAULT_RANDOM_FORMAT: WeightFormat = WeightFormat::F16;

impl ModelPlace {
    /// The folder, or the file of the decoder; of random weights the name of their shape.
    pub fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Gguf { model: path, .. } => path,
            Self::Random { shape, .. } => Path::new(shape.name),
        }
    }

    /// Bytes of its weight files.
    ///
    /// # Errors
    /// When there are none.
    pub fn weight_bytes(&self) -> Result<u64, MllmError> {
        match self {
            Self::Folder(folder) if safetensors_folder::has_safetensors(folder) => {
                safetensors_folder::weight_files(folder)?.iter().map(|file| file_bytes(file)).sum()
            }
            Self::Folder(folder) => match gguf::find(folder)? {
                Some(model) => Self::Gguf { model, mmproj: None }.weight_bytes(),
                None => Err(ModelFiles::folder(folder)?.missing("model.safetensors, and no GGUF file")),
            },
            Self::Gguf { model, mmproj } => {
                let files = gguf::files(model, mmproj.as_deref())?;
                files.iter().map(|file| file_bytes(file)).sum()
            }
            Self::Random { .. } => Ok(0),
        }
    }
}

fn file_bytes(path: &Path) -> Result<u64, MllmError> {
    let metadata = std::fs::metadata(path).map_err(|source| MllmError::Read { path: path.to_path_buf(), source })?;
    Ok(metadata.len())
}

/// A model's small files and its weights.
#[derive(Debug)]
pub(crate) struct Checkpoint {
    /// Configurations, tokenizer, chat template.
    pub files: ModelFiles,
    /// The weights, not read yet.
    pub weights: Weights,
}

impl Checkpoint {
    /// Opens a checkpoint: its small files, and the headers of its weights, which will be held in `quantize`.
    ///
    /// # Errors
    /// When a file is missing or broken.
    pub(crate) fn open(place: &ModelPlace, quantize: Option<WeightFormat>) -> Result<Self, MllmError> {
        match place {
            ModelPlace::Gguf { model, mmproj } => gguf::open(model, mmproj.as_deref(), quantize),
            ModelPlace::Random { shape, seed } => {
                Self::random(shape.files()?, quantize.unwrap_or(DEFAULT_RANDOM_FORMAT), *seed)
            }
            ModelPlace::Folder(folder) => {
                let files = ModelFiles::folder(folder)?;
                if !safetensors_folder::has_safetensors(folder)
                    && let Some(model) = gguf::find(folder)?
                {
                    return gguf::open(&model, None, quantize);
                }
                // A configuration that is missing is missed before weights are.
                files.required_json("config.json")?;
                Ok(Self { weights: safetensors_folder::open(folder, quantize)?, files })
            }
        }
    }
}
