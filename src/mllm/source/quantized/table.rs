//! The tensors of a folder by name, to be taken layer by layer, and the bytes behind them.

use crate::MllmError;
use crate::checkpoint::safetensors_folder::{RawFiles, RawTensor};
use crate::checkpoint::{TensorSource, WeightFile};
use half::{bf16, f16};
use safetensors::Dtype;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A tensor and the file that it is in.
#[derive(Debug, Clone)]
pub(super) struct Part {
    pub file: Arc<WeightFile>,
    pub tensor: RawTensor,
}

impl Part {
    pub(super) fn shape(&self) -> &[usize] {
        &self.tensor.shape
    }

    /// Its shape, if it is a matrix.
    pub(super) fn matrix(&self) -> Result<[usize; 2], MllmError> {
        <[usize; 2]>::try_from(self.shape())
            .map_err(|_| self.error(format!("expected two dimensions, found {:?}", self.shape())))
    }

    /// Checks its shape.
    pub(super) fn check_shape(&self, shape: &[usize]) -> Result<(), MllmError> {
        if self.shape() == shape {
            return Ok(());
        }
        Err(self.error(format!(
            "expected shape {shape:?}, found {:?}",
            self.shape()
        )))
    }

    /// Checks its type.
    pub(super) fn of_type(self, dtypes: &[Dtype]) -> Result<Self, MllmError> {
        if dtypes.contains(&self.tensor.dtype) {
            return Ok(self);
        }
        let known: Vec<String> = dtypes.iter().map(|dtype| format!("{dtype:?}")).collect();
        Err(self.error(format!(
            "expected number format {}, found {:?}",
            known.join(" or "),
            self.tensor.dtype
        )))
    }

    /// Checks that it is no larger than scales are, before it is read.
    pub(super) fn checked_side(self) -> Result<Self, MllmError> {
        if self.tensor.bytes > MAX_SIDE {
            return Err(self.error(format!(
                "its {} bytes are more than the {MAX_SIDE} that scales may have",
                self.tensor.bytes
            )));
        }
        Ok(self)
    }

    pub(super) fn bytes(&self) -> Result<Vec<u8>, MllmError> {
        self.file.part(self.tensor.begin, self.tensor.bytes)
    }

    /// Its 32-bit words.
    pub(super) fn words(&self) -> Result<Vec<u32>, MllmError> {
        let bytes = self.bytes()?;
        let words = bytes.as_chunks::<4>().0.iter();
        Ok(words.map(|word| u32::from_le_bytes(*word)).collect())
    }

    /// Its numbers, which are finite.
    pub(super) fn floats(&self) -> Result<Vec<f32>, MllmError> {
        let bytes = self.bytes()?;
        let halves = || bytes.as_chunks::<2>().0.iter();
        let floats: Vec<f32> = match self.tensor.dtype {
            Dtype::F16 => halves()
                .map(|half| f16::from_le_bytes(*half).to_f32())
                .collect(),
            Dtype::BF16 => halves()
                .map(|half| bf16::from_le_bytes(*half).to_f32())
                .collect(),
            Dtype::F32 => {
                let words = bytes.as_chunks::<4>().0.iter();
                words.map(|word| f32::from_le_bytes(*word)).collect()
            }
            // Powers of two; 255 is NaN.
            Dtype::F8_E8M0 | Dtype::U8 => bytes.iter().map(|byte| exponent(*byte)).collect(),
            other => return Err(self.error(format!("{other:?} is no format of scales"))),
        };
        match floats.iter().position(|float| !float.is_finite()) {
            None => Ok(floats),
            Some(element) => Err(MllmError::NonFiniteWeight {
                path: self.file.path().to_path_buf(),
                name: self.tensor.name.clone(),
                element,
                value: floats.get(element).copied().unwrap_or(f32::NAN),
            }),
        }
    }

    /// An error about the tensor.
    pub(super) fn error(&self, problem: impl Into<String>) -> MllmError {
        MllmError::PackedTensor {
            path: self.file.path().to_path_buf(),
            name: self.tensor.name.clone(),
            problem: problem.into(),
        }
    }
}

/// The number of a byte of `F8_E8M0`.
fn exponent(byte: u8) -> f32 {
    match byte {
        255 => f32::NAN,
        byte => f64::from(i32::from(byte) - 127).exp2() as f32,
    }
}

/// Largest tensor of scales, bytes. A table of 256 thousand tokens and 16 thousand numbers in groups
/// of 32 has 268 MB.
const MAX_SIDE: u64 = 1 << 29;

/// Types of scales.
pub(super) const FLOATS: [Dtype; 3] = [Dtype::F16, Dtype::BF16, Dtype::F32];

/// The tensors of a folder that no layer has taken yet.
#[derive(Debug)]
pub(super) struct TensorTable {
    pub folder: PathBuf,
    parts: BTreeMap<String, Part>,
}

impl TensorTable {
    pub(super) fn new(folder: &Path, files: RawFiles) -> Result<Self, MllmError> {
        let mut parts = BTreeMap::new();
        for (file, tensors) in files {
            for tensor in tensors {
                let (name, file) = (tensor.name.clone(), Arc::clone(&file));
                if parts.insert(name.clone(), Part { file, tensor }).is_some() {
                    let place = folder.to_path_buf();
                    return Err(MllmError::TwiceStored { place, name });
                }
            }
        }
        Ok(Self {
            folder: folder.to_path_buf(),
            parts,
        })
    }

    pub(super) fn parts(&self) -> impl Iterator<Item = &Part> {
        self.parts.values()
    }

    pub(super) fn get(&self, layer: &str, part: &str) -> Option<&Part> {
        self.parts.get(&format!("{layer}.{part}"))
    }

    /// The layers that have a tensor of this name, for which a condition holds.
    pub(super) fn layers(&self, part: &str, condition: impl Fn(&Part) -> bool) -> Vec<String> {
        let layer = |(name, found): (&String, &Part)| {
            let layer = name.strip_suffix(part)?.strip_suffix('.')?;
            condition(found).then(|| layer.to_owned())
        };
        self.parts.iter().filter_map(layer).collect()
    }

    /// Takes the tensor of a layer that it may have.
    pub(super) fn take(&mut self, layer: &str, part: &str) -> Option<Part> {
        self.parts.remove(&format!("{layer}.{part}"))
    }

    /// Takes a tensor that a layer must have.
    pub(super) fn need(&mut self, layer: &str, part: &str) -> Result<Part, MllmError> {
        self.take(layer, part)
            .ok_or_else(|| self.error(layer, format!("it has no {part}, so it is incomplete")))
    }

    /// Takes the scales or zero points of a layer, which are read when the folder is opened.
    pub(super) fn need_side(&mut self, layer: &str, part: &str) -> Result<Part, MllmError> {
        self.need(layer, part)?.checked_side()
    }

    /// Leaves out the tensors of which a condition holds.
    pub(super) fn leave_out(&mut self, condition: impl Fn(&str) -> bool) {
        self.parts.retain(|name, _| !condition(name));
    }

    /// An error about a layer.
    pub(super) fn error(&self, layer: &str, problem: impl Into<String>) -> MllmError {
        MllmError::PackedTensor {
            path: self.folder.clone(),
            name: layer.to_owned(),
            problem: problem.into(),
        }
    }
}
