//! Parquet tables, written batch by batch.

use crate::report::ReportError;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{
    ArrayRef, ArrowPrimitiveType, BooleanArray, Float64Array, Int64Array, ListArray, NullArray,
    RecordBatch, StringArray,
};
use arrow_schema::{Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use planagent_files::{OpenFolder, WholeFile};
use std::path::PathBuf;
use std::sync::Arc;

/// Values of a column; a missing one is null.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Column {
    Text(Vec<Option<String>>),
    Float(Vec<Option<f64>>),
    Integer(Vec<Option<i64>>),
    Boolean(Vec<Option<bool>>),
    Floats(Vec<Option<Vec<f64>>>),
    Integers(Vec<Option<Vec<i64>>>),
    /// So many nulls, as pandas writes a column of `None`. It reads other nulls as NaN, which
    /// nuBoard takes for scores.
    Nulls(usize),
}

impl Column {
    /// A text column without nulls.
    pub(super) fn text(values: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self::Text(values.into_iter().map(|value| Some(value.into())).collect())
    }

    /// A column of numbers, or of nulls if it has no number.
    pub(super) fn numbers(values: Vec<Option<f64>>) -> Self {
        if values.iter().all(Option::is_none) {
            Self::Nulls(values.len())
        } else {
            Self::Float(values)
        }
    }

    fn array(self) -> ArrayRef {
        match self {
            Self::Text(values) => Arc::new(StringArray::from(values)),
            Self::Float(values) => Arc::new(Float64Array::from(values)),
            Self::Integer(values) => Arc::new(Int64Array::from(values)),
            Self::Boolean(values) => Arc::new(BooleanArray::from(values)),
            Self::Floats(values) => lists::<Float64Type>(values),
            Self::Integers(values) => lists::<Int64Type>(values),
            Self::Nulls(count) => Arc::new(NullArray::new(count)),
        }
    }
}

fn lists<T: ArrowPrimitiveType>(values: Vec<Option<Vec<T::Native>>>) -> ArrayRef {
    let rows = values
        .into_iter()
        .map(|list| list.map(|list| list.into_iter().map(Some)));
    Arc::new(ListArray::from_iter_primitive::<T, _, _>(rows))
}

/// Columns of the same length, in their order.
pub(super) type Columns = Vec<(String, Column)>;

/// A Parquet file that grows batch by batch; it gets its name when it is complete. The columns of
/// the first batch are those of the file.
pub(super) struct TableWriter {
    path: PathBuf,
    schema: Arc<Schema>,
    writer: ArrowWriter<WholeFile>,
}

impl TableWriter {
    /// Begins a file with its first batch.
    pub(super) fn begin(
        folder: &OpenFolder,
        name: &str,
        first: Columns,
    ) -> Result<Self, ReportError> {
        let path = folder.path_of(name);
        let (names, arrays): (Vec<String>, Vec<ArrayRef>) = arrays(first).unzip();
        let fields = names.into_iter().zip(&arrays);
        let fields: Vec<Field> = fields
            .map(|(name, array)| Field::new(name, array.data_type().clone(), true))
            .collect();
        let schema = Arc::new(Schema::new(fields));
        let file = WholeFile::create_in(folder, name).map_err(ReportError::write(&path))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .build();
        let writer = ArrowWriter::try_new(file, Arc::clone(&schema), Some(properties))
            .map_err(ReportError::at(&path))?;
        let mut table = Self {
            path,
            schema,
            writer,
        };
        table.write(arrays)?;
        Ok(table)
    }

    pub(super) fn append(&mut self, columns: Columns) -> Result<(), ReportError> {
        self.write(arrays(columns).map(|(_, array)| array).collect())
    }

    fn write(&mut self, arrays: Vec<ArrayRef>) -> Result<(), ReportError> {
        let batch =
            RecordBatch::try_new(Arc::clone(&self.schema), arrays).map_err(ParquetError::from);
        let written = batch.and_then(|batch| {
            self.writer.write(&batch)?;
            self.writer.flush()
        });
        written.map_err(ReportError::at(&self.path))
    }

    pub(super) fn finish(self) -> Result<(), ReportError> {
        let file = self
            .writer
            .into_inner()
            .map_err(ReportError::at(&self.path))?;
        file.finish_unsynced()
            .map_err(ReportError::write(&self.path))
    }
}

fn arrays(columns: Columns) -> impl Iterator<Item = (String, ArrayRef)> {
    columns
        .into_iter()
        .map(|(name, column)| (name, column.array()))
}
