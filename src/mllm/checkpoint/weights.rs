//! The weight files of a checkpoint: safetensors, whole or in shards, in any layout that transformers has written.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

use super::read_json;
use super::section::Section;
use crate::mllm::MllmError;
use crate::mllm::matrix::{Matrix, Storage};

/// The file of a checkpoint that is not sharded.
const WEIGHTS: &str = "model.safetensors";
/// The index of a sharded checkpoint: which tensor is in which file.
const INDEX: &str = "model.safetensors.index.json";

/// The tensors of a checkpoint in f32, each checked to be finite, by their canonical names.
///
/// Canonical are the names that transformers 5 writes, without the `model.` prefixes. Of a LLaVA: `vision_tower.*`,
/// `multi_modal_projector.*`, `image_newline`, `language_model.*` (embedding, layers, norm) and `lm_head.weight`; of a
/// `CogVLM`: `vision.*`, `embed_tokens.weight`, `layers.*`, `norm.weight` and `lm_head.weight`.
#[derive(Debug)]
pub(crate) struct Weights {
    folder: PathBuf,
    tensors: BTreeMap<String, StoredTensor>,
    blake3: String,
    storage: Storage,
    #[cfg(test)]
    invented: Option<rand_pcg::Pcg64Mcg>,
}

#[derive(Debug)]
struct StoredTensor {
    file: PathBuf,
    name: String,
    tensor: Tensor,
}

impl Weights {
    /// Reads every tensor of the folder's checkpoint.
    ///
    /// # Errors
    /// When a file is missing or broken, or a tensor has an unknown number format or is not finite.
    pub(crate) fn open(folder: &Path) -> Result<Self, MllmError> {
        let mut weights = Self::empty(folder);
        let mut hasher = blake3::Hasher::new();
        for file in weight_files(folder)? {
            let bytes = std::fs::read(&file).map_err(|source| MllmError::Read { path: file.clone(), source })?;
            hasher.update(&bytes);
            weights.add_file(&file, &bytes)?;
        }
        weights.blake3 = hasher.finalize().to_hex().to_string();
        Ok(weights)
    }

    fn empty(folder: &Path) -> Self {
        Self {
            folder: folder.to_path_buf(),
            tensors: BTreeMap::new(),
            blake3: String::new(),
            storage: Storage::default(),
            #[cfg(test)]
            invented: None,
        }
    }

    /// BLAKE3 of the weight files in the order of their names.
    pub(crate) fn blake3(&self) -> &str {
        &self.blake3
    }

    fn add_file(&mut self, file: &Path, bytes: &[u8]) -> Result<(), MllmError> {
        let parsed = SafeTensors::deserialize(bytes)
            .map_err(|error| MllmError::Safetensors { path: file.to_path_buf(), problem: error.to_string() })?;
        for (name, view) in parsed.iter() {
            let Some(canonical) = canonical_name(name) else {
                continue;
            };
            let values = finite_f32(file, name, view.dtype(), view.data())?;
            let tensor = Tensor::from_vec(values, view.shape(), &Device::Cpu)?;
            self.tensors.insert(canonical, StoredTensor { file: file.to_path_buf(), name: name.to_string(), tensor });
        }
        Ok(())
    }

    /// Numbers in all tensors that are left.
    pub(crate) fn elements(&self) -> usize {
        self.tensors.values().map(|stored| stored.tensor.elem_count()).sum()
    }

    /// Whether the checkpoint holds this tensor.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Takes a tensor out, so that its memory is free when the model holds it in another form.
    ///
    /// # Errors
    /// When it is missing or has another shape.
    pub(crate) fn take(&mut self, name: &str, shape: &[usize]) -> Result<Tensor, MllmError> {
        #[cfg(test)]
        if let Some(random) = &mut self.invented {
            let count = shape.iter().product();
            let values: Vec<f32> = (0..count).map(|_| rand::RngExt::random_range(random, -0.1..0.1)).collect();
            return Ok(Tensor::from_vec(values, shape, &Device::Cpu)?);
        }
        let stored = self
            .tensors
            .remove(name)
            .ok_or_else(|| MllmError::MissingTensor { folder: self.folder.clone(), name: name.to_string() })?;
        if stored.tensor.dims() == shape {
            Ok(stored.tensor)
        } else {
            Err(MllmError::TensorShape {
                path: stored.file,
                name: stored.name,
                expected: shape.to_vec(),
                found: stored.tensor.dims().to_vec(),
            })
        }
    }
}

impl Weights {
    /// Takes a tensor of shape [outputs, inputs] as a matrix in the storage of these weights, or in the next finer one
    /// that can hold it.
    ///
    /// # Errors
    /// When it is missing or has another shape.
    pub(crate) fn take_matrix(&mut self, name: &str, shape: [usize; 2]) -> Result<Matrix, MllmError> {
        let tensor = self.take(name, &shape)?;
        let [outputs, inputs] = shape;
        match self.storage.or_finer(inputs) {
            Storage::F32 => Ok(Matrix::from_tensor(&tensor)?),
            storage => {
                let values: Vec<f32> = tensor.flatten_all()?.to_vec1()?;
                Ok(Matrix::quantize(&values, outputs, inputs, storage)?)
            }
        }
    }
}

#[cfg(test)]
impl Weights {
    /// Weights that hold whatever is asked for, at random.
    pub(crate) fn invented(seed: u64) -> Self {
        let random = rand::SeedableRng::seed_from_u64(seed);
        Self { invented: Some(random), ..Self::empty(Path::new("")) }
    }

    /// Gives two tensors each the other's name.
    pub(crate) fn swap(&mut self, one: &str, other: &str) {
        let first = self.tensors.remove(one).unwrap();
        let second = self.tensors.insert(other.to_string(), first).unwrap();
        self.tensors.insert(one.to_string(), second);
    }
}

/// The weight files of a folder in the order of their names.
fn weight_files(folder: &Path) -> Result<Vec<PathBuf>, MllmError> {
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

/// Maps the names of all layouts to one; none for buffers that are no weights.
fn canonical_name(name: &str) -> Option<String> {
    if name.ends_with("position_ids") || name.ends_with("rotary_emb.inv_freq") {
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

/// Decodes little-endian numbers of any read format and checks each.
fn finite_f32(file: &Path, name: &str, dtype: Dtype, bytes: &[u8]) -> Result<Vec<f32>, MllmError> {
    let values: Vec<f32> = match dtype {
        Dtype::F32 => bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(),
        Dtype::F16 => bytes.as_chunks::<2>().0.iter().map(|bytes| f16::from_le_bytes(*bytes).to_f32()).collect(),
        Dtype::BF16 => bytes.as_chunks::<2>().0.iter().map(|bytes| bf16::from_le_bytes(*bytes).to_f32()).collect(),
        other => {
            return Err(MllmError::TensorType {
                path: file.to_path_buf(),
                name: name.to_string(),
                found: format!("{other:?}"),
            });
        }
    };
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(element) => Err(MllmError::NonFiniteWeight {
            path: file.to_path_buf(),
            name: name.to_string(),
            element,
            value: values[element],
        }),
    }
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

    #[test]
    fn half_precision_is_widened_exactly() {
        let path = Path::new("w");
        let bytes: Vec<u8> =
            [f16::from_f32(1.5), f16::from_f32(-0.25)].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(finite_f32(path, "t", Dtype::F16, &bytes).unwrap(), [1.5, -0.25]);
        let bytes: Vec<u8> =
            [bf16::from_f32(3.0), bf16::INFINITY].iter().flat_map(|value| value.to_le_bytes()).collect();
        let error = finite_f32(path, "t", Dtype::BF16, &bytes).unwrap_err();
        assert!(matches!(error, MllmError::NonFiniteWeight { element: 1, .. }));
    }

    proptest! {
        #[test]
        fn hostile_files_are_errors_or_tensors(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut weights = Weights::empty(Path::new(""));
            let _ = weights.add_file(Path::new("w"), &bytes);
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
            let mut weights = Weights::empty(Path::new(""));
            let _ = weights.add_file(Path::new("w"), &bytes);
        }
    }
}
