//! The tensors of a checkpoint under one set of names, from any kind of file.

use super::finite::first_not_finite;
use super::load_report::LoadReport;
use super::merged::MergedFormat;
use super::packed::{Held, PackedBlocks, PackedForm, largest_difference};
use super::row_order::{RowOrder, unpaired};
use super::weight_file::{ComputedTensor, TensorPlace, TensorSource, in_four_dimensions};
use super::weight_format_plan::{PlannedFormat, WeightFormatPlan, is_matrix};
use crate::MllmError;
use candle_core::quantized::GgmlDType;
use candle_core::{Device, Tensor};
use planagent_kernels::matrix::{Matrix, WeightFormat};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The tensors of a checkpoint by their canonical names. Each is read when it is taken, checked to
/// be finite, and converted as the [`WeightFormatPlan`] says. So at most one tensor is in memory
/// twice.
///
/// A family chooses its canonical names: those of its safetensors without layout prefixes. The
/// output layer is `lm_head.weight`; names that begin with `vision` or `multi_modal_projector.`
/// belong to the vision tower and projector.
#[derive(Debug)]
pub struct Weights {
    place: PathBuf,
    pub(super) files: Vec<Arc<dyn TensorSource>>,
    pub(super) tensors: BTreeMap<String, StoredTensor>,
    pub(super) plan: WeightFormatPlan,
    /// Whether the weights of norms are stored with 1 added, as llama.cpp stores those of Gemma.
    norms_have_one: bool,
    /// Whether the value heads of a key lie apart, as llama.cpp stores those of Qwen 3.5.
    heads_are_tiled: bool,
    pub(super) report: LoadReport,
    blake3: String,
    access: TensorAccess,
}

/// What asking for a tensor does.
#[derive(Debug)]
enum TensorAccess {
    Read,
    /// Checks that it exists and has the right shape; holds the errors so far.
    Look(Vec<MllmError>),
    /// Lists its name and shape, whether it exists or not.
    List(Vec<(String, Vec<usize>)>),
    /// Makes it of random numbers.
    #[cfg(test)]
    Random(rand_pcg::Pcg64Mcg),
}

/// Maximum number of tensors of a model: beyond it a configuration is taken for broken.
const MAX_LISTED: usize = 1 << 17;
/// Errors after which a check gives up.
const MAX_PROBLEMS: usize = 1000;
/// A check gives up at a missing matrix with this many numbers or more, because the configuration
/// is broken.
const MAX_MATRIX: usize = 1 << 33;
/// The same for any other tensor. What is computed of its placeholder takes memory. That of a real
/// one has 5 million numbers.
const MAX_TENSOR: usize = 1 << 26;

/// A tensor that is not taken yet.
#[derive(Debug, Clone)]
pub(super) struct StoredTensor {
    /// Index into the files.
    pub(super) file: usize,
    /// Its name in the file.
    pub(super) name: String,
    pub(super) place: TensorPlace,
    pub(super) rows: RowOrder,
    /// The format of the stored tensor that this one was made of.
    pub(super) merged: Option<MergedFormat>,
}

impl Weights {
    /// Weights without a tensor; messages call them `place`.
    pub(crate) fn empty(place: &Path, plan: WeightFormatPlan) -> Self {
        Self {
            place: place.to_path_buf(),
            files: Vec::new(),
            tensors: BTreeMap::new(),
            plan: WeightFormatPlan { tied: true, ..plan },
            norms_have_one: false,
            heads_are_tiled: false,
            report: LoadReport {
                quantize: plan.quantize,
                ..LoadReport::default()
            },
            blake3: String::new(),
            access: TensorAccess::Read,
        }
    }

    /// Adds a file and gives its index for [`Self::add`].
    pub(crate) fn add_file(&mut self, file: impl TensorSource + 'static) -> usize {
        self.files.push(Arc::new(file));
        self.files.len() - 1
    }

    /// Adds the tensor `name` of a file.
    pub(crate) fn add(
        &mut self,
        canonical: String,
        file: usize,
        name: String,
        mut place: TensorPlace,
        rows: RowOrder,
    ) -> Result<(), MllmError> {
        self.unless_tied(&canonical);
        // A convolution of single pixels is a matrix.
        if let [_, _, 1, 1] = place.shape.as_slice() {
            place.shape.truncate(2);
        }
        let stored = StoredTensor {
            file,
            name,
            place,
            rows,
            merged: None,
        };
        match self.tensors.insert(canonical, stored) {
            None => Ok(()),
            Some(other) => Err(MllmError::TwiceStored {
                place: self.place.clone(),
                name: other.name,
            }),
        }
    }

    /// Notes that a tensor is added which tied embeddings do not have.
    pub(super) fn unless_tied(&mut self, canonical: &str) {
        if canonical == "lm_head.weight" {
            self.plan.tied = false;
        }
    }

    /// Adds a tensor of computed numbers.
    pub(crate) fn add_numbers(
        &mut self,
        canonical: &str,
        numbers: &[f32],
    ) -> Result<(), MllmError> {
        let bytes: Vec<u8> = numbers
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        let (format, shape) = (GgmlDType::F32.into(), vec![numbers.len()]);
        let place = TensorPlace {
            format,
            shape,
            begin: 0,
            bytes: bytes.len() as u64,
        };
        let file = self.add_file(ComputedTensor {
            place: self.place.clone(),
            bytes,
        });
        self.add(
            canonical.to_string(),
            file,
            canonical.to_string(),
            place,
            RowOrder::Plain,
        )
    }

    /// Whether the weights are those of safetensors, in formats that hold their numbers.
    pub(crate) fn is_lossless(&self) -> bool {
        self.plan.is_lossless()
    }

    /// Says that the weights of norms are stored with 1 added.
    pub(crate) fn set_norms_have_one(&mut self) {
        self.norms_have_one = true;
    }

    pub(crate) fn norms_have_one(&self) -> bool {
        self.norms_have_one
    }

    /// Takes matrices in formats that a file can hold.
    pub(crate) fn set_whole_blocks(&mut self) {
        self.plan.whole_blocks = true;
    }

    /// Says that the value heads of a key lie apart in layers with a delta rule.
    pub(crate) fn set_heads_are_tiled(&mut self) {
        self.heads_are_tiled = true;
    }

    pub(crate) fn heads_are_tiled(&self) -> bool {
        self.heads_are_tiled
    }

    pub(crate) fn note(&mut self, note: String) {
        self.report.notes.push(note);
    }

    /// Computes the BLAKE3 of the weight files in the order of opening.
    pub(crate) fn hash(&mut self) -> Result<(), MllmError> {
        let mut hasher = blake3::Hasher::new();
        for file in &self.files {
            file.hash(&mut hasher)?;
        }
        self.blake3 = hasher.finalize().to_hex().to_string();
        Ok(())
    }

    /// The result of [`Self::hash`].
    pub(crate) fn blake3(&self) -> &str {
        &self.blake3
    }

    /// The formats of the tensors taken so far.
    pub(crate) fn report(&self) -> &LoadReport {
        &self.report
    }

    /// Number of weights that are not taken yet.
    pub(crate) fn elements(&self) -> usize {
        self.tensors
            .values()
            .map(|stored| stored.place.shape.iter().product::<usize>())
            .sum()
    }

    pub(crate) fn contains(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    /// Whether the files of a model lack a tensor. A list of what a model takes has no files.
    pub(crate) fn lacks(&self, name: &str) -> bool {
        !matches!(self.access, TensorAccess::List(_)) && !self.contains(name)
    }

    /// Names and shapes of all tensors that are not taken yet.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.tensors
            .iter()
            .map(|(name, stored)| (name.as_str(), stored.place.shape.as_slice()))
    }

    /// From now on, gives placeholders for tensors without reading them, and collects errors.
    pub(crate) fn only_look(&mut self) {
        self.access = TensorAccess::Look(Vec::new());
    }

    /// Takes the errors that were collected since [`Self::only_look`].
    pub(crate) fn take_problems(&mut self) -> Vec<MllmError> {
        match &mut self.access {
            TensorAccess::Look(problems) => std::mem::take(problems),
            _ => Vec::new(),
        }
    }

    /// From now on, gives placeholders for all tensors and lists them.
    pub(crate) fn only_list(&mut self) {
        self.access = TensorAccess::List(Vec::new());
    }

    /// The tensors that were listed since [`Self::only_list`].
    pub(crate) fn listed(&self) -> &[(String, Vec<usize>)] {
        match &self.access {
            TensorAccess::List(asked) => asked,
            _ => &[],
        }
    }

    /// Checks or lists a tensor of at most `most` numbers where that is the task; gives whether a
    /// placeholder suffices.
    fn looked(&mut self, name: &str, shape: &[usize], most: usize) -> Result<bool, MllmError> {
        let elements = shape
            .iter()
            .try_fold(1, |product: usize, side| product.checked_mul(*side));
        let small = elements.is_some_and(|elements| elements < most);
        // Limits, because a configuration of a stranger decides how many tensors are asked for, and
        // how large.
        if let TensorAccess::List(asked) = &mut self.access {
            if asked.len() >= MAX_LISTED {
                let problem = format!("the configuration asks for more than {MAX_LISTED} tensors");
                return Err(candle_core::Error::Msg(problem).into());
            }
            if !small {
                let problem = format!(
                    "the configuration asks for tensor {name} of shape {shape:?}, which is too large"
                );
                return Err(candle_core::Error::Msg(problem).into());
            }
            asked.push((name.to_string(), shape.to_vec()));
            return Ok(true);
        }
        if !matches!(self.access, TensorAccess::Look(_)) {
            return Ok(false);
        }
        let found = self.remove(name, shape).map(|_| true);
        match (&mut self.access, found) {
            (TensorAccess::Look(problems), Err(problem))
                if small && problems.len() < MAX_PROBLEMS =>
            {
                problems.push(problem);
                Ok(true)
            }
            (_, found) => found,
        }
    }

    /// The format in memory of a matrix with `inputs` columns.
    pub(super) fn planned(
        &self,
        plan: WeightFormatPlan,
        name: &str,
        stored: &StoredTensor,
        inputs: usize,
    ) -> PlannedFormat {
        match (&stored.merged, self.packed(stored)) {
            (Some(base), _) => plan.merged(name, base.format, inputs),
            (None, Some(form)) => plan.packed_matrix(name, form, inputs),
            (None, None) => plan.matrix(name, stored.place.format, inputs),
        }
    }

    /// How a quantizer packed a tensor, if it did.
    pub(super) fn packed(&self, stored: &StoredTensor) -> Option<&PackedForm> {
        self.files.get(stored.file)?.packed(&stored.place)
    }

    /// What a report calls the format of a tensor in its file.
    pub(super) fn format_name(&self, stored: &StoredTensor) -> String {
        if let Some(base) = &stored.merged {
            return base.name.clone();
        }
        self.packed(stored)
            .map_or_else(|| stored.place.format.name(), |form| form.label.clone())
    }

    /// Takes a tensor out, in f32.
    pub(crate) fn take(&mut self, name: &str, shape: &[usize]) -> Result<Tensor, MllmError> {
        self.report.add(WeightFormat::F32, f32_bytes(shape));
        #[cfg(test)]
        if let TensorAccess::Random(random) = &mut self.access {
            let count = shape.iter().product();
            let values: Vec<f32> = (0..count)
                .map(|_| rand::RngExt::random_range(random, -0.1..0.1))
                .collect();
            return Ok(Tensor::from_vec(values, shape, &Device::Cpu)?);
        }
        if self.looked(name, shape, MAX_TENSOR)? {
            return Ok(
                Tensor::zeros((), candle_core::DType::F32, &Device::Cpu)?.broadcast_as(shape)?
            );
        }
        let stored = self.remove(name, shape)?;
        Ok(Tensor::from_vec(
            self.values(&stored)?,
            shape,
            &Device::Cpu,
        )?)
    }

    /// Takes a tensor out, in f32, that a file may store with further sides of 1, or in four
    /// dimensions.
    pub(crate) fn take_of_any_rank(
        &mut self,
        name: &str,
        shape: &[usize],
    ) -> Result<Tensor, MllmError> {
        let sides = |shape: &[usize]| {
            shape
                .iter()
                .copied()
                .filter(|side| *side != 1)
                .collect::<Vec<_>>()
        };
        let stored = self
            .tensors
            .get(name)
            .map(|stored| stored.place.shape.clone());
        match stored
            .filter(|stored| sides(stored) == sides(shape) || *stored == in_four_dimensions(shape))
        {
            Some(stored) => Ok(self.take(name, &stored)?.reshape(shape)?),
            None => self.take(name, shape),
        }
    }

    /// Takes a single number out, which files have without a side, or with a side of 1.
    pub(crate) fn take_bound(&mut self, name: &str) -> Result<f32, MllmError> {
        #[cfg(test)]
        if matches!(self.access, TensorAccess::Random(_)) {
            return Ok(if name.ends_with("min") { -4.0 } else { 4.0 });
        }
        let bound = self.take_of_any_rank(name, &[1])?;
        Ok(bound.reshape(())?.to_scalar()?)
    }

    /// Takes a tensor of shape [outputs, inputs] out as a matrix, in the format of the plan.
    pub(crate) fn take_matrix(
        &mut self,
        name: &str,
        shape: [usize; 2],
    ) -> Result<Matrix, MllmError> {
        debug_assert!(is_matrix(name, &shape), "{name} is forecast to stay in f32");
        #[cfg(test)]
        if matches!(self.access, TensorAccess::Random(_)) {
            return Ok(Matrix::from_tensor(&self.take(name, &shape)?)?);
        }
        let [_, inputs] = shape;
        // A placeholder of one row: checking a model must not need its memory.
        if self.looked(name, &shape, MAX_MATRIX)? {
            return Ok(Matrix::quantize(
                &vec![0.0; inputs],
                1,
                inputs,
                WeightFormat::F32,
            )?);
        }
        let stored = self.remove(name, &shape)?;
        let planned = self.planned(self.plan, name, &stored, inputs);
        let (matrix, largest_error) = match self.packed(&stored).cloned() {
            Some(form) => self.packed_matrix(&stored, &form, planned.weight_format)?,
            None => (self.matrix(&stored, shape, planned.weight_format)?, None),
        };
        let file = self.format_name(&stored);
        let bytes = matrix.bytes() as u64;
        self.report
            .add_matrix(name, file, planned, bytes, largest_error);
        Ok(matrix)
    }

    /// Reads a matrix that a quantizer packed, with the largest error where its numbers are
    /// rounded.
    fn packed_matrix(
        &self,
        stored: &StoredTensor,
        form: &PackedForm,
        wanted: WeightFormat,
    ) -> Result<(Matrix, Option<f32>), MllmError> {
        let &[outputs, inputs] = stored.place.shape.as_slice() else {
            return Err(candle_core::Error::Msg(format!("{} is no matrix", stored.name)).into());
        };
        if form.held != Held::Rounded && wanted == form.weight_format {
            let PackedBlocks {
                bytes,
                largest_error,
            } = self.file(stored)?.blocks(&stored.place)?;
            self.check_blocks(stored, wanted, &bytes)?;
            let matrix = Matrix::from_blocks(wanted, outputs, inputs, &bytes)?;
            let rounded = form.held == Held::ScalesRounded;
            return Ok((matrix, rounded.then_some(largest_error)));
        }
        let values = self.values(stored)?;
        let matrix = Matrix::quantize(&values, outputs, inputs, wanted)?;
        let rounded = (wanted != WeightFormat::F32)
            .then(|| largest_difference(&matrix, &values))
            .transpose()?;
        Ok((matrix, rounded))
    }

    fn remove(&mut self, name: &str, shape: &[usize]) -> Result<StoredTensor, MllmError> {
        let stored = self
            .tensors
            .remove(name)
            .ok_or_else(|| MllmError::MissingTensor {
                folder: self.place.clone(),
                name: name.to_string(),
            })?;
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
        self.files
            .get(stored.file)
            .map_or_else(|| self.place.clone(), |file| file.path().to_path_buf())
    }

    fn file(&self, stored: &StoredTensor) -> Result<&dyn TensorSource, MllmError> {
        match self.files.get(stored.file) {
            Some(file) => Ok(&**file),
            None => Err(MllmError::MissingTensor {
                folder: self.place.clone(),
                name: stored.name.clone(),
            }),
        }
    }

    /// The bytes of a tensor, its rows in order.
    pub(super) fn bytes(&self, stored: &StoredTensor) -> Result<Vec<u8>, MllmError> {
        let bytes = self.file(stored)?.bytes(&stored.place)?;
        Ok(match stored.rows {
            RowOrder::Plain => bytes,
            RowOrder::Paired { heads } => unpaired(
                &bytes,
                stored.place.shape.first().copied().unwrap_or(1),
                heads,
            ),
        })
    }

    /// The numbers of a tensor, each checked.
    pub(super) fn values(&self, stored: &StoredTensor) -> Result<Vec<f32>, MllmError> {
        let values = stored.place.format.widen(self.bytes(stored)?)?;
        // What bounds nothing is infinite.
        let is_bound = BOUNDS.iter().any(|end| stored.name.ends_with(end));
        let is_wrong = |value: &f32| !value.is_finite() && (!is_bound || value.is_nan());
        match values.iter().position(is_wrong) {
            None => Ok(values),
            Some(element) => Err(self.not_finite(stored, element, values[element])),
        }
    }

    /// Checks that the numbers of blocks are finite.
    pub(super) fn check_blocks(
        &self,
        stored: &StoredTensor,
        format: WeightFormat,
        bytes: &[u8],
    ) -> Result<(), MllmError> {
        match first_not_finite(format, bytes) {
            None => Ok(()),
            Some((element, value)) => Err(self.not_finite(stored, element, value)),
        }
    }

    fn not_finite(&self, stored: &StoredTensor, element: usize, value: f32) -> MllmError {
        MllmError::NonFiniteWeight {
            path: self.path(stored),
            name: stored.name.clone(),
            element,
            value,
        }
    }
}

/// Ends of the names of numbers that clamp what goes into a layer and comes out.
const BOUNDS: [&str; 4] = [".input_min", ".input_max", ".output_min", ".output_max"];

/// Whether a tensor is the weight of a norm that multiplies by 1 more, in decoders that have such
/// norms. Those of a tower, and of what a delta rule gives, do not.
pub(crate) fn may_add_one(canonical: &str) -> bool {
    canonical.ends_with("norm.weight")
        && !canonical.starts_with("vision_tower.")
        && !canonical.ends_with(".linear_attn.norm.weight")
        && canonical != "multi_modal_projector.norm.weight"
}

pub(super) fn f32_bytes(shape: &[usize]) -> u64 {
    shape
        .iter()
        .fold(4, |product: u64, side| product.saturating_mul(*side as u64))
}

#[cfg(test)]
impl Weights {
    /// Random weights of any name and shape.
    pub(crate) fn random(seed: u64) -> Self {
        let random = rand::SeedableRng::seed_from_u64(seed);
        Self {
            access: TensorAccess::Random(random),
            ..Self::empty(Path::new(""), WeightFormatPlan::default())
        }
    }
}
