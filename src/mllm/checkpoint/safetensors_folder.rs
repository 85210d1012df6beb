//! The safetensors of a folder, in one file or in shards.

use super::config::ConfigObject;
use super::mistaken::what_instead_of_weights;
use super::read_json;
use super::row_order::RowOrder;
use super::weight_file::{TensorPlace, TensorSource, WeightFile};
use super::weight_format_plan::WeightFormatPlan;
use super::weights::Weights;
use crate::MllmError;
use candle_core::quantized::GgmlDType;
use planagent_files::KIND_BYTES;
use planagent_kernels::matrix::WeightFormat;
use safetensors::Dtype;
use safetensors::tensor::Metadata;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The file of a checkpoint that is not sharded.
const WEIGHTS: &str = "model.safetensors";
/// The index of a sharded checkpoint.
const INDEX: &str = "model.safetensors.index.json";
/// Most files in a hint.
const MAX_NAMED: usize = 4;
/// Weights as Python objects, which may run code.
const PICKLE: &str = "pytorch_model.bin";
const PICKLE_INDEX: &str = "pytorch_model.bin.index.json";
/// Longest header, bytes (the format's own limit).
const MAX_HEADER: u64 = 100_000_000;
/// Bytes of the header's length.
const LENGTH: u64 = 8;

/// A tensor as its header describes it, of any number type.
#[derive(Debug, Clone)]
pub(crate) struct RawTensor {
    pub name: String,
    pub dtype: Dtype,
    /// Shape, the slowest dimension first.
    pub shape: Vec<usize>,
    /// First byte in the file.
    pub begin: u64,
    /// Number of bytes, which is that of its shape and type.
    pub bytes: u64,
}

impl RawTensor {
    /// Whether it has a type that needs no description: f32, f16 or bf16.
    pub(crate) fn is_plain(&self) -> bool {
        self.plain_format().is_some()
    }

    fn plain_format(&self) -> Option<GgmlDType> {
        match self.dtype {
            Dtype::F32 => Some(GgmlDType::F32),
            Dtype::F16 => Some(GgmlDType::F16),
            Dtype::BF16 => Some(GgmlDType::BF16),
            _ => None,
        }
    }

    /// The place of plain numbers; `path` is that of the file.
    pub(crate) fn plain(&self, path: &Path) -> Result<TensorPlace, MllmError> {
        let format = self.plain_format().ok_or_else(|| MllmError::TensorType {
            path: path.to_path_buf(),
            name: self.name.clone(),
            found: format!("{:?}", self.dtype),
        })?;
        Ok(TensorPlace {
            format: format.into(),
            shape: self.shape.clone(),
            begin: self.begin,
            bytes: self.bytes,
        })
    }
}

/// The files of a folder with the tensors of each.
pub(crate) type RawFiles = Vec<(Arc<WeightFile>, Vec<RawTensor>)>;

/// Reads the headers of the safetensors of a folder.
pub(crate) fn read(folder: &Path) -> Result<RawFiles, MllmError> {
    let open = |path: &PathBuf| {
        let file = WeightFile::open(path)?;
        let tensors = read_header(path, &mut file.reader()?, file.len())?;
        Ok((Arc::new(file), tensors))
    };
    weight_files(folder)?.iter().map(open).collect()
}

/// Opens the plain safetensors of a folder. `canonical` gives the canonical name of a tensor, or
/// none to leave it out.
#[cfg(test)]
pub(crate) fn open(
    folder: &Path,
    quantize: Option<WeightFormat>,
    canonical: impl Fn(&str) -> Option<String>,
) -> Result<Weights, MllmError> {
    of_files(folder, read(folder)?, quantize, canonical)
}

/// Makes weights of files that have nothing but plain numbers.
pub(crate) fn of_files(
    folder: &Path,
    files: RawFiles,
    quantize: Option<WeightFormat>,
    canonical: impl Fn(&str) -> Option<String>,
) -> Result<Weights, MllmError> {
    let mut weights = Weights::empty(
        folder,
        WeightFormatPlan {
            quantize,
            ..WeightFormatPlan::default()
        },
    );
    for (file, tensors) in files {
        add(&mut weights, file, tensors, &canonical)?;
    }
    Ok(weights)
}

/// Opens safetensors in memory; `place` stands in messages.
pub(crate) fn of_bytes(
    place: &Path,
    bytes: &'static [u8],
    quantize: Option<WeightFormat>,
    canonical: impl Fn(&str) -> Option<String>,
) -> Result<Weights, MllmError> {
    let mut weights = Weights::empty(
        place,
        WeightFormatPlan {
            quantize,
            ..WeightFormatPlan::default()
        },
    );
    let path = place.join(WEIGHTS);
    let tensors = read_header(&path, &mut &*bytes, bytes.len() as u64)?;
    add(
        &mut weights,
        MemoryFile { path, bytes },
        tensors,
        &canonical,
    )?;
    Ok(weights)
}

fn add(
    weights: &mut Weights,
    file: impl TensorSource + 'static,
    tensors: Vec<RawTensor>,
    canonical: &impl Fn(&str) -> Option<String>,
) -> Result<(), MllmError> {
    let path = file.path().to_path_buf();
    let index = weights.add_file(file);
    for tensor in tensors {
        let place = tensor.plain(&path)?;
        if let Some(canonical) = canonical(&tensor.name) {
            weights.add(canonical, index, tensor.name, place, RowOrder::Plain)?;
        }
    }
    Ok(())
}

#[derive(Debug)]
struct MemoryFile {
    path: PathBuf,
    bytes: &'static [u8],
}

impl TensorSource for MemoryFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        let begin = place.begin as usize;
        let bytes = self.bytes.get(begin..begin + place.bytes as usize);
        Ok(bytes
            .expect("the header was checked against the length")
            .to_vec())
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        hasher.update(self.bytes);
        Ok(())
    }
}

/// Reads the header of a file of `file_bytes` bytes: the tensors by their names in the file.
pub(crate) fn read_header(
    path: &Path,
    source: &mut dyn Read,
    file_bytes: u64,
) -> Result<Vec<RawTensor>, MllmError> {
    let broken = |problem: String| MllmError::Safetensors {
        path: path.to_path_buf(),
        problem,
    };
    let failed = |error: std::io::Error| broken(format!("the header cannot be read: {error}"));
    let mut beginning = Vec::new();
    (&mut *source)
        .take(KIND_BYTES as u64)
        .read_to_end(&mut beginning)
        .map_err(failed)?;
    if beginning.is_empty() {
        return Err(broken("the file is empty; download it again".into()));
    }
    // The length of a header may have the first bytes of another kind of file.
    let has_header = beginning.get(LENGTH as usize) == Some(&b'{');
    if !has_header && let Some(problem) = what_instead_of_weights(&beginning) {
        return Err(broken(problem));
    }
    let mut source = beginning.as_slice().chain(source);
    let mut length = [0; LENGTH as usize];
    source.read_exact(&mut length).map_err(failed)?;
    let length = u64::from_le_bytes(length);
    if length > MAX_HEADER || length + LENGTH > file_bytes {
        return Err(broken(format!(
            "a header of {length} bytes is announced in a file of {file_bytes}"
        )));
    }
    let mut header = vec![0; length as usize];
    source.read_exact(&mut header).map_err(failed)?;
    let metadata: Metadata =
        serde_json::from_slice(&header).map_err(|error| broken(error.to_string()))?;
    let data = metadata.data_len() as u64;
    if (LENGTH + length).checked_add(data) != Some(file_bytes) {
        return Err(broken(format!(
            "its tensors take {data} bytes behind a header of {length}, but the file has {file_bytes}: it is truncated or \
             goes on behind its end"
        )));
    }
    let tensor = |(name, info): (String, &safetensors::tensor::TensorInfo)| {
        let (begin, end) = info.data_offsets;
        RawTensor {
            name,
            dtype: info.dtype,
            shape: info.shape.clone(),
            begin: LENGTH + length + begin as u64,
            bytes: (end - begin) as u64,
        }
    };
    Ok(metadata
        .tensors()
        .into_iter()
        // Buffers that are no weights may be of any type.
        .filter(|(name, _)| !is_buffer(name))
        .map(tensor)
        .collect())
}

pub(crate) fn has_safetensors(folder: &Path) -> bool {
    [WEIGHTS, INDEX]
        .iter()
        .any(|file| folder.join(file).is_file())
}

/// The weight files of a folder in the order of their names.
pub(crate) fn weight_files(folder: &Path) -> Result<Vec<PathBuf>, MllmError> {
    let whole = folder.join(WEIGHTS);
    if whole.is_file() {
        return Ok(vec![whole]);
    }
    let index_path = folder.join(INDEX);
    if !index_path.is_file() {
        let hint = if folder.join(PICKLE).is_file() || folder.join(PICKLE_INDEX).is_file() {
            format!(" ({PICKLE} is not read; take a repository or revision with safetensors)")
        } else {
            other_weights(folder).map_or_else(String::new, |hint| format!(" ({hint})"))
        };
        let file = format!("{WEIGHTS} and no {INDEX}{hint}");
        return Err(MllmError::MissingFile {
            folder: folder.to_path_buf(),
            file,
        });
    }
    let index: Value = read_json(&index_path)?;
    let root = ConfigObject::root(&index_path, &index)?;
    let weight_map: Option<BTreeMap<String, String>> = root.value("weight_map")?;
    let weight_map = weight_map.ok_or_else(|| root.error("weight_map", "is missing"))?;
    let mut files: Vec<PathBuf> = Vec::new();
    for (tensor, file) in weight_map {
        // The index comes from a stranger, and a path in it could name any file of this machine.
        if file.is_empty() || file.contains(['/', '\\']) || file == ".." {
            let problem = format!("expected the name of a file in this folder, found '{file}'");
            return Err(root.error(&format!("weight_map.{tensor}"), problem));
        }
        let path = folder.join(&file);
        if !path.is_file() {
            return Err(MllmError::MissingFile {
                folder: folder.to_path_buf(),
                file,
            });
        }
        files.push(path);
    }
    files.sort();
    files.dedup();
    Ok(files)
}

/// What to do with the safetensors files of a folder that has none of the two names.
fn other_weights(folder: &Path) -> Option<String> {
    let names = std::fs::read_dir(folder).ok()?.flatten();
    let mut names: Vec<String> = names
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".safetensors"))
        .filter(|name| !name.starts_with('.') && !name.starts_with("adapter"))
        .collect();
    names.sort();
    let first = names.first()?;
    let shown = names.get(..MAX_NAMED).unwrap_or(&names).join(", ");
    Some(match first.strip_prefix("model-") {
        Some(part) if part.contains("-of-") && !part.ends_with("-of-00001.safetensors") => {
            format!("{shown} are parts; download {INDEX} too, which says what is in them")
        }
        _ => format!(
            "{shown} has another name; if it has all weights, under the names of transformers, call it {WEIGHTS}"
        ),
    })
}

/// Whether a tensor is a buffer that older checkpoints store beside the weights.
fn is_buffer(name: &str) -> bool {
    name.ends_with("position_ids") || name.ends_with("rotary_emb.inv_freq")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places(bytes: &[u8]) -> Result<Vec<RawTensor>, MllmError> {
        read_header(Path::new("w"), &mut &*bytes, bytes.len() as u64)
    }

    #[test]
    fn a_web_page_in_place_of_weights_is_called_one() {
        let error = places(b"<!DOCTYPE html>\n<html>Not here</html>")
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("a web page") && error.contains("download the file again"),
            "{error}"
        );
    }

    #[test]
    fn weights_under_another_name_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = || weight_files(folder.path()).unwrap_err().to_string();
        assert!(
            error().ends_with("no model.safetensors.index.json"),
            "{}",
            error()
        );
        for (name, told) in [
            (
                "adapter_model.safetensors",
                "no model.safetensors.index.json",
            ),
            ("consolidated.safetensors", "call it model.safetensors"),
            (
                "model.fp16.safetensors",
                "model.fp16.safetensors has another name",
            ),
            (
                "model-00001-of-00001.safetensors",
                "call it model.safetensors",
            ),
            (
                "model-00001-of-00002.safetensors",
                "download model.safetensors.index.json too",
            ),
        ] {
            let file = folder.path().join(name);
            std::fs::write(&file, "").unwrap();
            assert!(error().contains(told), "{name}: {}", error());
            std::fs::remove_file(&file).unwrap();
        }
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
