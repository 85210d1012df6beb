//! The files of a model: weights, and the parts of configurations that several families share.

mod config;
mod convolution_config;
mod decoder_type;
mod delta_config;
mod files;
mod finite;
mod forecast;
mod gemma_config;
mod layer_shape;
mod layers;
mod llama_config;
mod load_report;
mod merged;
mod mistaken;
mod neutral;
mod own_keys;
mod packed;
mod rope_config;
mod row_order;
pub(crate) mod safetensors_folder;
mod stream_config;
#[cfg(test)]
mod strip_tests;
mod strips;
mod vision_config;
mod weight_file;
mod weight_format_plan;
mod weights;

pub(crate) use config::{ConfigObject, OneOrMany, check_width, positive};
pub(crate) use convolution_config::ConvolutionConfig;
pub(crate) use decoder_type::DecoderType;
pub(crate) use delta_config::DeltaConfig;
pub use files::ModelFiles;
#[cfg(test)]
pub(crate) use gemma_config::ImageMask;
pub(crate) use layer_shape::{KNOWN_TOKENS, LayerInputConfig, LayerKeys, LayerShape};
pub use llama_config::LlamaConfig;
pub(crate) use load_report::any_layer;
pub use load_report::{
    LoadReport, MergedAdapter, WeightFormatException, WeightFormatShare, in_bytes, parameter_count,
};
pub(crate) use merged::BaseTensor;
pub(crate) use mistaken::{what_instead, what_instead_of_weights};
pub(crate) use neutral::Neutral;
pub(crate) use own_keys::OwnKeys;
pub(crate) use packed::{Held, PackedBlocks, PackedForm};
pub(crate) use row_order::{RowOrder, paired};
pub(crate) use stream_config::part_below;
pub(crate) use vision_config::{TowerType, VisionConfig};
pub(crate) use weight_file::{TensorPlace, TensorSource, WeightFile, in_four_dimensions};
pub(crate) use weight_format_plan::{FileKind, WeightFormatPlan, held_as, is_kernel, is_matrix};
pub use weights::Weights;
pub(crate) use weights::may_add_one;

use super::MllmError;
use serde_json::Value;
use std::path::Path;

/// Largest tokenizer.json, bytes. That of 262 thousand tokens has 34 MB.
const MAX_TOKENIZER_BYTES: u64 = 128 << 20;
/// Largest list of shards or of a tokenizer's special tokens, bytes. Published ones have up to 2
/// MB.
const MAX_LIST_BYTES: u64 = 16 << 20;
/// Largest configuration and chat template, bytes.
const MAX_CONFIG_BYTES: u64 = 1 << 20;
/// Maximum number of small files in a model's folder.
pub(crate) const MAX_SMALL_FILES: usize = 256;

/// Largest small file of this name, bytes. Others are refused before they are read.
pub(crate) fn small_file_limit(path: &Path) -> u64 {
    const CONFIGS: [&str; 5] = [
        "adapter_config.json",
        "config.json",
        "generation_config.json",
        "preprocessor_config.json",
        "planagent.json",
    ];
    let is = |name: &str| path.file_name().is_some_and(|own| own == name);
    if is("tokenizer.json") {
        MAX_TOKENIZER_BYTES
    } else if CONFIGS.into_iter().any(is)
        || path.extension().is_some_and(|ending| ending == "jinja")
    {
        MAX_CONFIG_BYTES
    } else {
        MAX_LIST_BYTES
    }
}

/// Reads a small file. Windows editors put a byte order mark before a text, which is left out.
pub(crate) fn read_text(path: &Path) -> Result<String, MllmError> {
    let failed = |source| MllmError::Read {
        path: path.to_path_buf(),
        source,
    };
    let bytes = planagent_files::read(path, small_file_limit(path)).map_err(failed)?;
    if weight_file::is_lfs_pointer(&bytes) {
        return Err(MllmError::LfsPointer {
            path: path.to_path_buf(),
        });
    }
    let mut text = String::from_utf8(bytes).map_err(|error| {
        let utf16 =
            error.as_bytes().starts_with(b"\xff\xfe") || error.as_bytes().starts_with(b"\xfe\xff");
        let problem = if utf16 {
            "it is UTF-16, as PowerShell writes; save it as UTF-8".to_owned()
        } else {
            error.to_string()
        };
        failed(std::io::Error::new(
            std::io::ErrorKind::InvalidData,
            problem,
        ))
    })?;
    if text.starts_with(BYTE_ORDER_MARK) {
        text.drain(..BYTE_ORDER_MARK.len_utf8());
    }
    Ok(text)
}

/// What Windows editors begin a UTF-8 text with.
const BYTE_ORDER_MARK: char = '\u{feff}';

pub(crate) fn read_json(path: &Path) -> Result<Value, MllmError> {
    parse_json(path, &read_text(path)?)
}

/// Parses a small file as Python's json does. What lies there in its place is called what it is.
pub(crate) fn parse_json(path: &Path, text: &str) -> Result<Value, MllmError> {
    let instead = || {
        let is_empty = text.trim().is_empty();
        let empty = || "the file is empty; download the file again".to_owned();
        what_instead(text.as_bytes()).or_else(|| is_empty.then(empty))
    };
    serde_json::from_str(text)
        .or_else(|source| serde_json::from_str(&with_words(text)).map_err(|_| source))
        .map_err(|source| match instead() {
            Some(problem) => MllmError::Read {
                path: path.to_path_buf(),
                source: std::io::Error::new(std::io::ErrorKind::InvalidData, problem),
            },
            None => MllmError::Json {
                path: path.to_path_buf(),
                source,
            },
        })
}

/// A text in which what Python's json writes for no number is a text. A key that nobody reads may
/// have any value, and who reads a number names the key.
fn with_words(text: &str) -> String {
    let mut written = String::with_capacity(text.len());
    let mut inside = false;
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let word = ["NaN", "-Infinity", "Infinity"]
            .into_iter()
            .find(|word| !inside && rest.starts_with(word));
        let length = match (word, first) {
            (Some(word), _) => word.len(),
            (None, '\\') if inside => 1 + rest.chars().nth(1).map_or(0, char::len_utf8),
            (None, first) => first.len_utf8(),
        };
        inside ^= first == '"';
        let (piece, after) = rest.split_at(length);
        match word {
            Some(word) => written.extend(["\"", word, "\""]),
            None => written.push_str(piece),
        }
        rest = after;
    }
    written
}
