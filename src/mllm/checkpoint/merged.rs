//! Tensors that are made of stored ones, such as those that an adapter is merged into.

use super::load_report::MergedAdapter;
use super::row_order::{RowOrder, unpaired};
use super::weight_file::{TensorPlace, TensorSource};
use super::weight_format_plan::FileKind;
use super::weights::{StoredTensor, Weights};
use crate::MllmError;
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::StoredFormat;
use std::path::Path;
use std::sync::Arc;

/// The format of a tensor that another is made of.
#[derive(Debug, Clone)]
pub(super) struct MergedFormat {
    /// What a report calls it.
    pub(super) name: String,
    /// The format itself; of a packed tensor the one that holds its numbers in memory.
    pub(super) format: StoredFormat,
}

/// A tensor of a file, for what is made of it.
#[derive(Debug, Clone)]
pub(crate) struct BaseTensor {
    file: Arc<dyn TensorSource>,
    name: String,
    place: TensorPlace,
    rows: RowOrder,
}

impl BaseTensor {
    /// A tensor `name` of a file, its rows in Hugging Face's order.
    pub(crate) fn new(file: Arc<dyn TensorSource>, name: String, place: TensorPlace) -> Self {
        Self {
            file,
            name,
            place,
            rows: RowOrder::Plain,
        }
    }

    /// The same with rows in the order of a file.
    pub(crate) fn with_rows(self, rows: RowOrder) -> Self {
        Self { rows, ..self }
    }

    /// Its name in its file.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn shape(&self) -> &[usize] {
        &self.place.shape
    }

    /// Its format, for what is made of it.
    fn format(&self) -> MergedFormat {
        let packed = self.file.packed(&self.place);
        let format = packed.map_or(self.place.format, |form| form.weight_format.stored());
        MergedFormat {
            name: packed.map_or_else(|| format.name(), |form| form.label.clone()),
            format,
        }
    }

    pub(crate) fn path(&self) -> &Path {
        self.file.path()
    }

    /// Its numbers in Hugging Face's order of rows, each checked to be finite.
    pub(crate) fn values(&self) -> Result<Vec<f32>, MllmError> {
        let bytes = self.file.bytes(&self.place)?;
        let rows = self.place.shape.first().copied().unwrap_or(1);
        let bytes = match self.rows {
            RowOrder::Plain => bytes,
            RowOrder::Paired { heads } => unpaired(&bytes, rows, heads),
        };
        let values = self.place.format.widen(bytes)?;
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(values),
            Some(element) => Err(MllmError::NonFiniteWeight {
                path: self.path().to_path_buf(),
                name: self.name.clone(),
                element,
                value: values.get(element).copied().unwrap_or(f32::NAN),
            }),
        }
    }
}

impl Weights {
    /// A tensor that is not taken yet.
    pub(crate) fn base_tensor(&self, canonical: &str) -> Option<BaseTensor> {
        let stored = self.tensors.get(canonical)?;
        Some(BaseTensor {
            file: Arc::clone(self.files.get(stored.file)?),
            name: stored.name.clone(),
            place: stored.place.clone(),
            rows: stored.rows,
        })
    }

    /// Whether the weights are those of GGUF files.
    pub(crate) fn is_gguf(&self) -> bool {
        self.plan.kind == FileKind::Gguf
    }

    /// Gives a tensor a second name, under which it is a tensor of its own.
    pub(crate) fn copy(&mut self, canonical: &str, second: &str) {
        if let Some(stored) = self.tensors.get(canonical) {
            let stored = stored.clone();
            self.unless_tied(second);
            self.tensors.insert(second.to_owned(), stored);
        }
    }

    /// Notes the adapter that is merged.
    pub(crate) fn set_adapter(&mut self, adapter: MergedAdapter) {
        self.report.adapter = Some(adapter);
    }

    /// Puts a tensor in f32 that was made of `base` in the place of another, or beside them.
    pub(crate) fn put_merged(
        &mut self,
        canonical: &str,
        base: &BaseTensor,
        merged: impl TensorSource + 'static,
    ) {
        let shape = base.place.shape.clone();
        let bytes = shape.iter().fold(size_of::<f32>() as u64, |bytes, side| {
            bytes.saturating_mul(*side as u64)
        });
        let stored = StoredTensor {
            file: self.add_file(merged),
            name: base.name.clone(),
            place: TensorPlace {
                format: GgmlDType::F32.into(),
                shape,
                begin: 0,
                bytes,
            },
            rows: RowOrder::Plain,
            merged: Some(base.format()),
        };
        self.unless_tied(canonical);
        self.tensors.insert(canonical.to_owned(), stored);
    }
}
