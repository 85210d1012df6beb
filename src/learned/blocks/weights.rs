//! The tensors of a checkpoint while a network takes them.

use super::norm::EPSILON;
use super::{LayerNorm, Linear};
use candle_core::{DType, Device, Result, Tensor};
use std::collections::BTreeMap;
use std::fmt;

/// Names that an error lists of each kind.
const MAX_NAMES: usize = 6;

/// Tensors by PyTorch's names. A network takes each that it has; [`Weights::finish`] then says what
/// did not fit.
#[derive(Debug)]
pub struct Weights {
    left: BTreeMap<String, Tensor>,
    manifest: Vec<(String, Vec<usize>)>,
    mismatch: Mismatch,
}

/// What of a checkpoint does not fit a network.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Mismatch {
    missing: Vec<String>,
    reshaped: Vec<String>,
    left_over: Vec<String>,
}

impl Weights {
    /// Of tensors by name.
    pub fn new(tensors: BTreeMap<String, Tensor>) -> Self {
        Self {
            left: tensors,
            manifest: Vec::new(),
            mismatch: Mismatch::default(),
        }
    }

    /// The tensor of this name as f32. A missing one is noted, and zeros take its place until
    /// [`Weights::finish`].
    pub(crate) fn take(&mut self, name: &str, shape: &[usize]) -> Result<Tensor> {
        self.manifest.push((name.to_owned(), shape.to_vec()));
        match self.left.remove(name) {
            Some(tensor) if tensor.dims() == shape => {
                return tensor.to_dtype(DType::F32)?.contiguous();
            }
            Some(tensor) => {
                self.mismatch
                    .reshaped
                    .push(format!("{name} {:?} instead of {shape:?}", tensor.dims()));
            }
            None => self.mismatch.missing.push(name.to_owned()),
        }
        Tensor::zeros(shape, DType::F32, &Device::Cpu)
    }

    /// The affine layer of `NAME.weight` and `NAME.bias`.
    pub(crate) fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear> {
        let weight = self.take(&format!("{name}.weight"), &[outputs, inputs])?;
        let bias = self.take(&format!("{name}.bias"), &[outputs])?;
        Linear::from_tensors(&weight, Some(bias))
    }

    /// The affine layer of `NAME.weight`.
    pub(crate) fn linear_without_bias(
        &mut self,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Linear> {
        let weight = self.take(&format!("{name}.weight"), &[outputs, inputs])?;
        Linear::from_tensors(&weight, None)
    }

    /// The layer normalization of `NAME.weight` and `NAME.bias`.
    pub(crate) fn layer_norm(&mut self, name: &str, width: usize) -> Result<LayerNorm> {
        let mut vector = |part: &str| self.take(&format!("{name}.{part}"), &[width])?.to_vec1();
        let (weight, bias) = (vector("weight")?, vector("bias")?);
        Ok(LayerNorm::new(weight, bias, EPSILON))
    }

    /// Takes a tensor that the network computes by itself; only its name and shape are checked.
    pub(crate) fn skip(&mut self, name: &str, shape: &[usize]) -> Result<()> {
        self.take(name, shape).map(|_| ())
    }

    /// The names and shapes that were asked for, in order.
    pub fn manifest(&self) -> &[(String, Vec<usize>)] {
        &self.manifest
    }

    /// Ends the loading.
    ///
    /// # Errors
    /// When a tensor was missing or had another shape, or one is left over.
    pub fn finish(mut self) -> std::result::Result<(), Mismatch> {
        self.mismatch.left_over = self.left.into_keys().collect();
        if self.mismatch == Mismatch::default() {
            Ok(())
        } else {
            Err(self.mismatch)
        }
    }
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            missing,
            reshaped,
            left_over,
        } = self;
        let kinds = [
            ("missing", missing),
            ("of another shape", reshaped),
            ("left over", left_over),
        ];
        let kinds = kinds.into_iter().filter(|(_, names)| !names.is_empty());
        for (i, (kind, names)) in kinds.enumerate() {
            // A checkpoint of another network lacks hundreds of tensors, and a few names tell which
            // network it is.
            let shown = names
                .iter()
                .take(MAX_NAMES)
                .cloned()
                .collect::<Vec<_>>()
                .join(", ");
            let more = names.len().saturating_sub(MAX_NAMES);
            write!(
                f,
                "{}{} {kind}: {shown}",
                if i == 0 { "" } else { "; " },
                names.len()
            )?;
            if more > 0 {
                write!(f, " and {more} more")?;
            }
        }
        Ok(())
    }
}

impl std::error::Error for Mismatch {}

#[cfg(test)]
mod tests {
    use super::*;

    fn tensors(names: &[(&str, usize)]) -> Weights {
        let zeros = |&(name, size): &(&str, usize)| {
            (
                name.to_owned(),
                Tensor::zeros(size, DType::F32, &Device::Cpu).unwrap(),
            )
        };
        Weights::new(names.iter().map(zeros).collect())
    }

    #[test]
    fn everything_that_does_not_fit_is_named_at_once() {
        let mut weights = tensors(&[("a", 2), ("b", 3), ("c", 4)]);
        for (name, shape) in [("a", 2), ("b", 2), ("d", 1)] {
            assert_eq!(weights.take(name, &[shape]).unwrap().dims(), [shape]);
        }
        let error = weights.finish().unwrap_err().to_string();
        assert_eq!(
            error,
            "1 missing: d; 1 of another shape: b [3] instead of [2]; 1 left over: c"
        );
    }

    #[test]
    fn what_fits_is_no_error_and_long_lists_are_cut() {
        let mut weights = tensors(&[("a", 2)]);
        weights.take("a", &[2]).unwrap();
        assert_eq!(weights.manifest(), [("a".to_owned(), vec![2])]);
        assert!(weights.finish().is_ok());
        let names: Vec<String> = (0..9).map(|i| format!("n{i}")).collect();
        let many: Vec<(&str, usize)> = names.iter().map(|name| (name.as_str(), 1)).collect();
        let error = tensors(&many).finish().unwrap_err().to_string();
        assert_eq!(error, "9 left over: n0, n1, n2, n3, n4, n5 and 3 more");
    }
}
