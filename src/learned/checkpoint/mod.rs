//! Checkpoints as their authors wrote them: Lightning's `.ckpt`, PyTorch's `.pth`, safetensors.

mod pickle;
mod torch_file;

use super::blocks::{Mismatch, Weights};
use candle_core::{DType, Device, Tensor};
use planagent_agent::planner::PlannerError;
use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Largest checkpoint that is read, bytes. The largest of the seven models, with its optimizer's
/// state, has a third of a gigabyte.
const MAX_BYTES: u64 = 4 << 30;
/// How a ZIP archive begins, which PyTorch writes since version 1.6.
const ZIP: [u8; 4] = *b"PK\x03\x04";
/// What Lightning puts before the names of a model's tensors.
const LIGHTNING: &str = "model.";

/// Why a checkpoint cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum CheckpointError {
    #[error("cannot read the checkpoint {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error(
        "the checkpoint {} cannot be read: {fault}; expected a Lightning .ckpt, a .pth file of PyTorch 1.6 or later, or safetensors",
        path.display()
    )]
    Format { path: PathBuf, fault: String },
    #[error(
        "the checkpoint {}: tensor {tensor} holds NaN, so its training failed; name another checkpoint",
        path.display()
    )]
    NotANumber { path: PathBuf, tensor: String },
    #[error("the checkpoint {} does not fit {model}: {mismatch}", path.display())]
    Mismatch {
        path: PathBuf,
        model: &'static str,
        mismatch: Mismatch,
    },
    #[error("the checkpoint {} cannot be converted", path.display())]
    Tensor {
        path: PathBuf,
        source: Box<candle_core::Error>,
    },
}

impl From<CheckpointError> for PlannerError {
    fn from(error: CheckpointError) -> Self {
        Self::Checkpoint(Box::new(error))
    }
}

/// The tensors of a file by their names, without Lightning's prefix.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    tensors: BTreeMap<String, Tensor>,
}

impl Checkpoint {
    /// Reads a file. No code of a `.ckpt` or `.pth` file is run: only tensors are taken out of it.
    ///
    /// # Errors
    /// When the file cannot be read or holds no tensors.
    pub fn open(path: &Path) -> Result<Self, CheckpointError> {
        let format = |fault: String| CheckpointError::Format {
            path: path.to_owned(),
            fault,
        };
        let bytes = read(path).map_err(|source| CheckpointError::Read {
            path: path.to_owned(),
            source,
        })?;
        let tensors = if bytes.starts_with(&ZIP) {
            torch_file::tensors(&bytes).map_err(|error| format(error.to_string()))?
        } else {
            let tensors = candle_core::safetensors::load_buffer(&bytes, &Device::Cpu);
            tensors
                .map_err(|error| format(error.to_string()))?
                .into_iter()
                .collect()
        };
        if tensors.is_empty() {
            return Err(format("it holds no tensors".to_owned()));
        }
        // A network can hide it: a comparison with NaN is false, and a planner then drives all the same.
        for (name, tensor) in &tensors {
            if holds_nan(tensor).map_err(|error| format(error.to_string()))? {
                return Err(CheckpointError::NotANumber {
                    path: path.to_owned(),
                    tensor: name.clone(),
                });
            }
        }
        let bare = |(name, tensor): (String, Tensor)| match name.strip_prefix(LIGHTNING) {
            Some(bare) => (bare.to_owned(), tensor),
            None => (name, tensor),
        };
        Ok(Self {
            path: path.to_owned(),
            tensors: tensors.into_iter().map(bare).collect(),
        })
    }

    /// The numbers of a tensor in row-major order.
    pub fn numbers(&self, name: &str) -> Option<Vec<f32>> {
        self.tensors
            .get(name)?
            .to_dtype(DType::F32)
            .ok()?
            .flatten_all()
            .ok()?
            .to_vec1()
            .ok()
    }

    /// The network that `take` makes of the tensors.
    ///
    /// # Errors
    /// When the names and shapes are not exactly those of the model.
    pub fn load<M>(
        self,
        model: &'static str,
        take: impl FnOnce(&mut Weights) -> candle_core::Result<M>,
    ) -> Result<M, CheckpointError> {
        let path = self.path;
        let mut weights = Weights::new(self.tensors);
        let taken = take(&mut weights);
        match weights.finish() {
            Ok(()) => taken.map_err(|source| CheckpointError::Tensor {
                path,
                source: Box::new(source),
            }),
            Err(mismatch) => Err(CheckpointError::Mismatch {
                path,
                model,
                mismatch,
            }),
        }
    }
}

/// Whether a tensor has a number that is none. Infinity may be that of a mask.
fn holds_nan(tensor: &Tensor) -> candle_core::Result<bool> {
    if !tensor.dtype().is_float() {
        return Ok(false);
    }
    let numbers = tensor.flatten_all()?.to_dtype(DType::F32)?;
    Ok(numbers
        .to_vec1::<f32>()?
        .iter()
        .any(|number| number.is_nan()))
}

fn read(path: &Path) -> io::Result<Vec<u8>> {
    let file = planagent_files::open(path)?;
    let mut bytes = Vec::new();
    if file.take(MAX_BYTES + 1).read_to_end(&mut bytes)? as u64 > MAX_BYTES {
        return Err(io::Error::new(
            io::ErrorKind::InvalidData,
            format!("it has more than {MAX_BYTES} bytes"),
        ));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    #[test]
    fn a_checkpoint_with_nan_is_refused_and_infinity_may_be_a_mask() {
        let work = tempfile::tempdir().unwrap();
        let file = work.path().join("network.safetensors");
        let opened = |number: f32| {
            let tensor = Tensor::new(&[1.0, number], &Device::Cpu).unwrap();
            let tensors = HashMap::from([("layer.weight", tensor)]);
            candle_core::safetensors::save(&tensors, &file).unwrap();
            Checkpoint::open(&file)
        };
        opened(f32::NEG_INFINITY).unwrap();
        let error = opened(f32::NAN).unwrap_err().to_string();
        assert!(error.contains("tensor layer.weight holds NaN"), "{error}");
    }
}
