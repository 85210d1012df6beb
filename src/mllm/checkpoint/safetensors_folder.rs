//! The safetensors of a folder, whole or in shards, in any layout that transformers has written.

use std::io::Read;
use std::path::{Path, PathBuf};

use candle_core::quantized::GgmlDType;
use safetensors::Dtype;
use safetensors::tensor::Metadata;
use serde_json::Value;

use super::read_json;
use super::row_order::RowOrder;
use super::section::Section;
use super::weight_file::{TensorPlace, WeightFile};
use super::weight_format_plan::WeightFormatPlan;
use super::weights::Weights;
use crate::mllm::MllmError;
use crate::mllm::matrix::WeightFormat;

/// The file of a checkpoint that is not sharded.
const WEIGHTS: &str = "model.safetensors";
/// The index of a sharded checkpoint: which tensor is in which file.
const INDEX: &str = "model.safetensors.index.json";
/// Longest header, bytes (the format's own limit).
const MAX_HEADER: u64 = 100_000_000;
/// Bytes of the number that says how long the header is.
const LENGTH: u64 = 8;

/// Opens the safetensors of a folder.
///
/// # Errors
/// When a file is missing or broken, or a tensor has an unknown number format.
pub(super) fn open(folder: &Path, quantize: Option<WeightFormat>) -> Result<Weights, MllmError> {
    let mut weights = Weights::empty(folder, WeightFormatPlan { quantize, ..WeightFormatPlan::default() });
    for path in weight_files(folder)? {
        let file = WeightFile::open(&path)?;
        let tensors = read_header(&path, &mut file.reader()?, file.len())?;
        let index = weights.add_file(file);
        for (name, place) in tensors {
            if let Some(canonical) = canonical_name(&name) {
                weights.add(canonical, index, name, place, RowOrder::Plain)?;
            }
        }
    }
    Ok(weights)
}

/// Reads the header at the beginning of a file of `file_bytes` bytes: the tensors by their names in the file.
///
/// # Errors
/// When it is broken, its tensors do not fill the file exactly, or one is in a number format that is not read.
fn read_header(path: &Path, source: &mut dyn Read, file_bytes: u64) -> Result<Vec<(String, TensorPlace)>, MllmError> {
    let broken = |problem: String| MllmError::Safetensors { path: path.to_path_buf(), problem };
    let failed = |error: std::io::Error| broken(format!("the header cannot be read: {error}"));
    let mut length = [0; LENGTH as usize];
    source.read_exact(&mut length).map_err(failed)?;
    let length = u64::from_le_bytes(length);
    if length > MAX_HEADER || length + LENGTH > file_bytes {
        return Err(broken(format!("a header of {length} bytes is announced in a file of {file_bytes}")));
    }
    let mut header = vec![0; length as usize];
    source.read_exact(&mut header).map_err(failed)?;
    let metadata: Metadata = serde_json::from_slice(&header).map_err(|error| broken(error.to_string()))?;
    let data = metadata.data_len() as u64;
    if (LENGTH + length).checked_add(data) != Some(file_bytes) {
        return Err(broken(format!(
            "its tensors take {data} bytes behind a header of {length}, but the file has {file_bytes}: it is truncated or \
             goes on behind its end"
        )));
    }
    let place = |(name, info): (String, &safetensors::tensor::TensorInfo)| {
        let (begin, end) = info.data_offsets;
        let format = match info.dtype {
            Dtype::F32 => GgmlDType::F32,
            Dtype::F16 => GgmlDType::F16,
            Dtype::BF16 => GgmlDType::BF16,
            other => {
                let found = format!("{other:?}");
                return Err(MllmError::TensorType { path: path.to_path_buf(), name, found });
            }
        };
        let place = TensorPlace {
            format,
            shape: info.shape.clone(),
            begin: LENGTH + length + begin as u64,
            bytes: (end - begin) as u64,
        };
        Ok((name, place))
    };
    metadata
        .tensors()
        .into_iter()
        // Buffers that are no weights may be of any type.
        .filter(|(name, _)| !is_buffer(name))
        .map(place)
        .collect()
}

/// Whether a folder holds the weights of a checkpoint, or says which files do.
pub(super) fn has_safetensors(folder: &Path) -> bool {
    [WEIGHTS, INDEX].iter().any(|file| folder.join(file).is_file())
}

/// The weight files of a folder in the order of their names.
pub(super) fn weight_files(folder: &Path) -> Result<Vec<PathBuf>, MllmError> {
    let whole = folder.join(WEIGHTS);
    if whole.is_file() {
        return Ok(vec![whole]);
    }
    let index_path = folder.join(INDEX);
    if !index_path.is_file() {
        return Err(MllmError::MissingFile { folder: folder.to_path_buf(), file: format!("{WEIGHTS} and no {INDEX}") });
    }
    let index: Value = read_json(&index_path)?;
    let root = Section::root(&index_path, &index)?;
    let Some(Value::Object(map)) = root.get("weight_map") else {
        return Err(root.error("weight_map", "expected an object of tensor names and files".into()));
    };
    let mut files: Vec<PathBuf> = Vec::new();
    for (tensor, file) in map {
        let file = file
            .as_str()
            .filter(|file| !file.is_empty() && !file.contains(['/', '\\']) && *file != "..")
            .ok_or_else(|| {
                root.error(
                    &format!("weight_map.{tensor}"),
                    format!("expected the name of a file in this folder, found {file}"),
                )
            })?;
        let path = folder.join(file);
        if !path.is_file() {
            return Err(MllmError::MissingFile { folder: folder.to_path_buf(), file: file.to_string() });
        }
        files.push(path);
    }
    files.sort();
    files.dedup();
    Ok(files)
}

/// Whether a tensor is a table that older checkpoints hold beside the weights.
fn is_buffer(name: &str) -> bool {
    name.ends_with("position_ids") || name.ends_with("rotary_emb.inv_freq")
}

/// Maps the names of all layouts to one; none for buffers that are no weights.
fn canonical_name(name: &str) -> Option<String> {
    if is_buffer(name) {
        return None;
    }
    let name = name.strip_prefix("model.").unwrap_or(name);
    let renamed = [
        ("vision_tower.vision_model.", "vision_tower."),
        ("language_model.model.", "language_model."),
        ("language_model.lm_head.", "lm_head."),
    ]
    .into_iter()
    .find_map(|(from, to)| name.strip_prefix(from).map(|rest| format!("{to}{rest}")));
    Some(renamed.unwrap_or_else(|| name.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_layout_has_one_canonical_name() {
        for (name, canonical) in [
            ("vision_tower.vision_model.encoder.layers.0.mlp.fc1.bias", "vision_tower.encoder.layers.0.mlp.fc1.bias"),
            ("vision_tower.embeddings.class_embedding", "vision_tower.embeddings.class_embedding"),
            ("model.vision_tower.vision_model.pre_layrnorm.bias", "vision_tower.pre_layrnorm.bias"),
            ("model.vision_tower.pre_layrnorm.bias", "vision_tower.pre_layrnorm.bias"),
            ("language_model.model.norm.weight", "language_model.norm.weight"),
            ("model.language_model.norm.weight", "language_model.norm.weight"),
            ("language_model.lm_head.weight", "lm_head.weight"),
            ("lm_head.weight", "lm_head.weight"),
            ("model.multi_modal_projector.linear_1.bias", "multi_modal_projector.linear_1.bias"),
            ("model.image_newline", "image_newline"),
            ("model.vision.boi", "vision.boi"),
            ("model.layers.0.mlp.vision_mlp.up_proj.weight", "layers.0.mlp.vision_mlp.up_proj.weight"),
        ] {
            assert_eq!(canonical_name(name).as_deref(), Some(canonical));
        }
        assert_eq!(canonical_name("vision_tower.vision_model.embeddings.position_ids"), None);
    }

    fn places(bytes: &[u8]) -> Result<Vec<(String, TensorPlace)>, MllmError> {
        read_header(Path::new("w"), &mut &*bytes, bytes.len() as u64)
    }

    proptest! {
        #[test]
        fn hostile_files_are_errors_or_tensors(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = places(&bytes);
        }

        #[test]
        fn hostile_headers_are_errors_or_tensors(
            shape in proptest::collection::vec(any::<u32>(), 0..3),
            begin in 0u64..20, end in 0u64..20,
            dtype in prop_oneof![Just("F32"), Just("BF16"), Just("I64"), Just("Q")],
        ) {
            let header = format!(r#"{{"t":{{"dtype":"{dtype}","shape":{shape:?},"data_offsets":[{begin},{end}]}}}}"#);
            let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
            bytes.extend(header.bytes());
            bytes.extend([0; 12]);
            let _ = places(&bytes);
        }
    }
}
