//! The tensors of a checkpoint under one set of names, whatever files they lie in.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::quantized::GgmlDType;
use candle_core::{Device, Tensor};
use half::f16;
use serde_json::Value;

use super::load_report::LoadReport;
use super::read_json;
use super::safetensors_header::read_header;
use super::section::Section;
use super::storage_plan::{StoragePlan, held_as, is_matrix};
use super::weight_file::{TensorPlace, WeightFile, widen};
use crate::mllm::MllmError;
use crate::mllm::matrix::{Matrix, Storage};

/// The file of a checkpoint that is not sharded.
const WEIGHTS: &str = "model.safetensors";
/// The index of a sharded checkpoint: which tensor is in which file.
const INDEX: &str = "model.safetensors.index.json";

/// The tensors of a checkpoint by their canonical names. Each is read when it is taken, checked to be finite and held as
/// the [`StoragePlan`] says, so that there is never more than one tensor twice in memory.
///
/// Canonical are the names that transformers 5 writes, without the `model.` prefixes. Of a LLaVA: `vision_tower.*`,
/// `multi_modal_projector.*`, `image_newline`, `language_model.*` (embedding, layers, norm) and `lm_head.weight`; of a
/// `CogVLM`: `vision.*`, `embed_tokens.weight`, `layers.*`, `norm.weight` and `lm_head.weight`.
#[derive(Debug)]
pub(crate) struct Weights {
    place: PathBuf,
    files: Vec<WeightFile>,
    tensors: BTreeMap<String, StoredTensor>,
    plan: StoragePlan,
    report: LoadReport,
    blake3: String,
    /// When tensors are only looked for: which are missing or misshapen.
    problems: Option<Vec<MllmError>>,
    /// When it is only listed what is asked for: names and shapes.
    listed: Option<Vec<(String, Vec<usize>)>>,
    #[cfg(test)]
    invented: Option<rand_pcg::Pcg64Mcg>,
}

/// Tensors that may be missing before looking for more is given up.
const MOST_PROBLEMS: usize = 1000;
/// Numbers of a missing tensor from which on looking for more is given up: the configuration is broken.
const LARGEST_STAND_IN: usize = 1 << 30;

/// A tensor that was not taken yet.
#[derive(Debug)]
struct StoredTensor {
    /// Index into the files.
    file: usize,
    /// Its name there.
    name: String,
    place: TensorPlace,
    rows: RowOrder,
}

/// In which order a file has the rows of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RowOrder {
    /// As Hugging Face has them.
    Plain,
    /// The rows of each of so many heads in pairs, as llama.cpp's rotary embedding takes them: a row of the first half,
    /// then its partner of the second.
    Paired {
        /// Number of heads.
        heads: usize,
    },
}

impl Weights {
    /// Opens the safetensors of a folder.
    ///
    /// # Errors
    /// When a file is missing or broken, or a tensor has an unknown number format.
    pub(crate) fn open(folder: &Path, quantize: Option<Storage>) -> Result<Self, MllmError> {
        let mut weights = Self::empty(folder, StoragePlan { quantize, ..StoragePlan::default() });
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

    /// Weights without a tensor. `place` is what messages call them.
    pub(crate) fn empty(place: &Path, plan: StoragePlan) -> Self {
        Self {
            place: place.to_path_buf(),
            files: Vec::new(),
            tensors: BTreeMap::new(),
            plan: StoragePlan { tied: true, ..plan },
            report: LoadReport { quantize: plan.quantize, ..LoadReport::default() },
            blake3: String::new(),
            problems: None,
            listed: None,
            #[cfg(test)]
            invented: None,
        }
    }

    /// Adds a file, whose tensors are added by the index that this gives.
    pub(crate) fn add_file(&mut self, file: WeightFile) -> usize {
        self.files.push(file);
        self.files.len() - 1
    }

    /// Adds a tensor called `name` in a file that was added.
    ///
    /// # Errors
    /// When there is another of this canonical name.
    pub(crate) fn add(
        &mut self,
        canonical: String,
        file: usize,
        name: String,
        place: TensorPlace,
        rows: RowOrder,
    ) -> Result<(), MllmError> {
        if canonical == "lm_head.weight" {
            self.plan.tied = false;
        }
        let stored = StoredTensor { file, name, place, rows };
        match self.tensors.insert(canonical, stored) {
            None => Ok(()),
            Some(other) => Err(MllmError::TwiceStored { place: self.place.clone(), name: other.name }),
        }
    }

    /// Adds what a user should know of the files to the report.
    pub(crate) fn note(&mut self, note: String) {
        self.report.notes.push(note);
    }

    /// BLAKE3 of the weight files in the order in which they were opened.
    ///
    /// # Errors
    /// When one cannot be read.
    pub(crate) fn hash(&mut self) -> Result<(), MllmError> {
        let mut hasher = blake3::Hasher::new();
        for file in &self.files {
            file.hash(&mut hasher)?;
        }
        self.blake3 = hasher.finalize().to_hex().to_string();
        Ok(())
    }

    /// What [`Self::hash`] found.
    pub(crate) fn blake3(&self) -> &str {
        &self.blake3
    }

    /// How the tensors that were taken are held.
    pub(crate) fn report(&self) -> &LoadReport {
        &self.report
    }

    /// Numbers in all tensors that are left.
    pub(crate) fn elements(&self) -> usize {
        self.tensors.values().map(|stored| stored.place.shape.iter().product::<usize>()).sum()
    }

    /// Whether the checkpoint holds this tensor.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Names and shapes of all tensors that are left.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.tensors.iter().map(|(name, stored)| (name.as_str(), stored.place.shape.as_slice()))
    }

    /// From now on gives stand-ins for tensors without reading them, and notes which are missing or misshapen.
    pub(crate) fn only_look(&mut self) {
        self.problems = Some(Vec::new());
    }

    /// What [`Self::only_look`] found.
    pub(crate) fn problems(&self) -> &[MllmError] {
        self.problems.as_deref().unwrap_or_default()
    }

    /// From now on gives stand-ins for tensors, whether there are any or not, and lists which are asked for.
    pub(super) fn only_list(&mut self) {
        self.listed = Some(Vec::new());
    }

    /// What [`Self::only_list`] listed.
    pub(super) fn listed(&self) -> &[(String, Vec<usize>)] {
        self.listed.as_deref().unwrap_or_default()
    }

    /// Looks for a tensor; says whether that is all that is wanted.
    ///
    /// # Errors
    /// When too much is missing.
    fn looked(&mut self, name: &str, shape: &[usize]) -> Result<bool, MllmError> {
        if let Some(listed) = &mut self.listed {
            listed.push((name.to_string(), shape.to_vec()));
            return Ok(true);
        }
        if self.problems.is_none() {
            return Ok(false);
        }
        let elements = shape.iter().try_fold(1, |product: usize, side| product.checked_mul(*side));
        let small = elements.is_some_and(|elements| elements < LARGEST_STAND_IN);
        let found = self.remove(name, shape).map(|_| true);
        match (&mut self.problems, found) {
            (Some(problems), Err(problem)) if small && problems.len() < MOST_PROBLEMS => {
                problems.push(problem);
                Ok(true)
            }
            (_, found) => found,
        }
    }

    /// How a tensor that is left will be held.
    pub(crate) fn storage_of(&self, name: &str) -> Option<Storage> {
        let TensorPlace { format, shape, .. } = &self.tensors.get(name)?.place;
        match shape.as_slice() {
            [_, inputs] if is_matrix(name, shape) => Some(self.plan.matrix(name, *format, *inputs).storage),
            _ => Some(Storage::F32),
        }
    }

    /// What the report will say when all that is left has been taken, with another storage asked for.
    pub(crate) fn forecast(&self, quantize: Option<Storage>) -> LoadReport {
        let plan = StoragePlan { quantize, ..self.plan };
        let mut report = LoadReport { quantize, ..LoadReport::default() };
        for (name, stored) in &self.tensors {
            let TensorPlace { format, shape, .. } = &stored.place;
            match shape.as_slice() {
                [outputs, inputs] if is_matrix(name, shape) => {
                    let planned = plan.matrix(name, *format, *inputs);
                    let bytes = planned.storage.matrix_bytes(*outputs, *inputs).unwrap_or(usize::MAX);
                    report.add_matrix(name, *format, planned, bytes as u64);
                }
                _ => report.add(Storage::F32, f32_bytes(shape)),
            }
        }
        report
    }

    /// Takes a tensor out, in f32.
    ///
    /// # Errors
    /// When it is missing, has another shape, cannot be read or is not finite.
    pub(crate) fn take(&mut self, name: &str, shape: &[usize]) -> Result<Tensor, MllmError> {
        self.report.add(Storage::F32, f32_bytes(shape));
        #[cfg(test)]
        if let Some(random) = &mut self.invented {
            let count = shape.iter().product();
            let values: Vec<f32> = (0..count).map(|_| rand::RngExt::random_range(random, -0.1..0.1)).collect();
            return Ok(Tensor::from_vec(values, shape, &Device::Cpu)?);
        }
        if self.looked(name, shape)? {
            return Ok(Tensor::zeros(1, candle_core::DType::F32, &Device::Cpu)?.broadcast_as(shape)?);
        }
        let stored = self.remove(name, shape)?;
        Ok(Tensor::from_vec(self.values(&stored)?, shape, &Device::Cpu)?)
    }

    /// Takes a tensor of shape [outputs, inputs] out as a matrix, held as the plan says.
    ///
    /// # Errors
    /// As [`Self::take`].
    pub(crate) fn take_matrix(&mut self, name: &str, shape: [usize; 2]) -> Result<Matrix, MllmError> {
        debug_assert!(is_matrix(name, &shape), "{name} is forecast to stay in f32");
        #[cfg(test)]
        if self.invented.is_some() {
            return Ok(Matrix::from_tensor(&self.take(name, &shape)?)?);
        }
        let [outputs, inputs] = shape;
        if self.looked(name, &shape)? {
            return Ok(Matrix::quantize(&vec![0.0; inputs], 1, inputs, Storage::F32)?);
        }
        let stored = self.remove(name, &shape)?;
        let format = stored.place.format;
        let planned = self.plan.matrix(name, format, inputs);
        let matrix = if held_as(format) == Some(planned.storage) {
            let bytes = self.bytes(&stored)?;
            self.check_blocks(&stored, &bytes)?;
            Matrix::from_blocks(planned.storage, outputs, inputs, &bytes)?
        } else {
            Matrix::quantize(&self.values(&stored)?, outputs, inputs, planned.storage)?
        };
        self.report.add_matrix(name, format, planned, matrix.bytes() as u64);
        Ok(matrix)
    }

    fn remove(&mut self, name: &str, shape: &[usize]) -> Result<StoredTensor, MllmError> {
        let stored = self
            .tensors
            .remove(name)
            .ok_or_else(|| MllmError::MissingTensor { folder: self.place.clone(), name: name.to_string() })?;
        if stored.place.shape == shape {
            return Ok(stored);
        }
        Err(MllmError::TensorShape {
            path: self.path(&stored),
            name: stored.name,
            expected: shape.to_vec(),
            found: stored.place.shape,
        })
    }

    fn path(&self, stored: &StoredTensor) -> PathBuf {
        self.files.get(stored.file).map_or_else(|| self.place.clone(), |file| file.path().to_path_buf())
    }

    /// The bytes of a tensor, its rows in order.
    fn bytes(&self, stored: &StoredTensor) -> Result<Vec<u8>, MllmError> {
        let file = self
            .files
            .get(stored.file)
            .ok_or_else(|| MllmError::MissingTensor { folder: self.place.clone(), name: stored.name.clone() })?;
        let bytes = file.bytes(&stored.place)?;
        Ok(match stored.rows {
            RowOrder::Plain => bytes,
            RowOrder::Paired { heads } => unpaired(&bytes, stored.place.shape.first().copied().unwrap_or(1), heads),
        })
    }

    /// The numbers of a tensor, each checked.
    fn values(&self, stored: &StoredTensor) -> Result<Vec<f32>, MllmError> {
        let values = widen(stored.place.format, self.bytes(stored)?)?;
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(values),
            Some(element) => Err(self.not_finite(stored, element, values[element])),
        }
    }

    /// Checks what decides whether the numbers of blocks are finite: the numbers themselves, or the scales.
    fn check_blocks(&self, stored: &StoredTensor, bytes: &[u8]) -> Result<(), MllmError> {
        let format = stored.place.format;
        let block = bytes.chunks_exact(format.type_size()).enumerate();
        let worst = |block: &[u8]| match format {
            GgmlDType::F32 => block.first_chunk().map(|value| f32::from_le_bytes(*value)),
            GgmlDType::Q4K => half_at(block, 0).filter(|scale| !scale.is_finite()).or_else(|| half_at(block, 2)),
            GgmlDType::Q6K => half_at(block, block.len() - 2),
            _ => half_at(block, 0),
        };
        for (index, block) in block {
            if let Some(value) = worst(block).filter(|value| !value.is_finite()) {
                return Err(self.not_finite(stored, index * format.block_size(), value));
            }
        }
        Ok(())
    }

    fn not_finite(&self, stored: &StoredTensor, element: usize, value: f32) -> MllmError {
        MllmError::NonFiniteWeight { path: self.path(stored), name: stored.name.clone(), element, value }
    }
}

/// The half-precision number at a byte of a block.
fn half_at(block: &[u8], at: usize) -> Option<f32> {
    block.get(at..)?.first_chunk().map(|bytes| f16::from_le_bytes(*bytes).to_f32())
}

fn f32_bytes(shape: &[usize]) -> u64 {
    shape.iter().fold(4, |product: u64, side| product.saturating_mul(*side as u64))
}

/// Puts rows that lie in pairs ([`RowOrder::Paired`]) back in order.
fn unpaired(bytes: &[u8], rows: usize, heads: usize) -> Vec<u8> {
    reordered(bytes, rows, heads, |row, half| if row < half { 2 * row } else { 2 * (row - half) + 1 })
}

/// The reverse of [`unpaired`].
pub(crate) fn paired(bytes: &[u8], rows: usize, heads: usize) -> Vec<u8> {
    reordered(bytes, rows, heads, |row, half| row / 2 + row % 2 * half)
}

/// Rows of which each head's are taken from where `source` says, by the row's number in its head and half the head's width.
fn reordered(bytes: &[u8], rows: usize, heads: usize, source: impl Fn(usize, usize) -> usize) -> Vec<u8> {
    let (width, head) = (bytes.len() / rows.max(1), rows / heads.max(1));
    let mut out = Vec::with_capacity(bytes.len());
    for first in (0..rows).step_by(head.max(1)) {
        for row in 0..head {
            let begin = (first + source(row, head / 2)) * width;
            out.extend_from_slice(&bytes[begin..begin + width]);
        }
    }
    out
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
pub(super) fn is_buffer(name: &str) -> bool {
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
impl Weights {
    /// Weights that hold whatever is asked for, at random.
    pub(crate) fn invented(seed: u64) -> Self {
        let random = rand::SeedableRng::seed_from_u64(seed);
        Self { invented: Some(random), ..Self::empty(Path::new(""), StoragePlan::default()) }
    }

    /// Gives two tensors each the other's name.
    pub(crate) fn swap(&mut self, one: &str, other: &str) {
        let first = self.tensors.remove(one).unwrap();
        let second = self.tensors.insert(other.to_string(), first).unwrap();
        self.tensors.insert(one.to_string(), second);
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

    fn places(bytes: &[u8]) -> Result<Vec<(String, TensorPlace)>, MllmError> {
        read_header(Path::new("w"), &mut &*bytes, bytes.len() as u64)
    }

    #[test]
    fn half_precision_is_widened_exactly() {
        let bytes = [f16::from_f32(1.5), f16::from_f32(-0.25)].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(widen(GgmlDType::F16, bytes).unwrap(), [1.5, -0.25]);
        let bytes = [half::bf16::from_f32(3.0)].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(widen(GgmlDType::BF16, bytes).unwrap(), [3.0]);
        assert!(widen(GgmlDType::Q4K, vec![0; 143]).is_err());
    }

    proptest! {
        #[test]
        fn pairs_are_put_in_order_and_back(heads in 1_usize..4, half in 1_usize..5, width in 1_usize..4) {
            let rows = heads * 2 * half;
            let bytes: Vec<u8> = (0..rows * width).map(|byte| byte as u8).collect();
            let pairs = paired(&bytes, rows, heads);
            prop_assert_eq!(&pairs[..width], &bytes[..width]);
            prop_assert_eq!(&pairs[width..2 * width], &bytes[half * width..(half + 1) * width], "the partner follows");
            prop_assert_eq!(unpaired(&pairs, rows, heads), bytes);
        }

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
