//! Tables of named columns, written batch by batch.

use crate::report::ReportError;
use crate::report::atomic;
use arrow::array::{ArrayRef, BooleanArray, Float64Array, Int64Array, ListArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Field, Float64Type, Int64Type, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Values of a column; a missing one is null.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Column {
    /// UTF-8.
    Text(Vec<Option<String>>),
    /// Doubles.
    Float(Vec<Option<f64>>),
    /// 64-bit integers.
    Integer(Vec<Option<i64>>),
    /// Truth values.
    Boolean(Vec<Option<bool>>),
    /// Lists of doubles.
    Floats(Vec<Option<Vec<f64>>>),
    /// Lists of 64-bit integers.
    Integers(Vec<Option<Vec<i64>>>),
}

impl Column {
    /// The same text in every row.
    pub(super) fn text(values: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self::Text(values.into_iter().map(|value| Some(value.into())).collect())
    }

    fn array(self) -> ArrayRef {
        match self {
            Self::Text(values) => Arc::new(StringArray::from(values)),
            Self::Float(values) => Arc::new(Float64Array::from(values)),
            Self::Integer(values) => Arc::new(Int64Array::from(values)),
            Self::Boolean(values) => Arc::new(BooleanArray::from(values)),
            Self::Floats(values) => Arc::new(ListArray::from_iter_primitive::<Float64Type, _, _>(
                values.into_iter().map(|list| list.map(|list| list.into_iter().map(Some))),
            )),
            Self::Integers(values) => Arc::new(ListArray::from_iter_primitive::<Int64Type, _, _>(
                values.into_iter().map(|list| list.map(|list| list.into_iter().map(Some))),
            )),
        }
    }

    fn data_type(&self) -> DataType {
        let list = |item| DataType::List(Arc::new(Field::new_list_field(item, true)));
        match self {
            Self::Text(_) => DataType::Utf8,
            Self::Float(_) => DataType::Float64,
            Self::Integer(_) => DataType::Int64,
            Self::Boolean(_) => DataType::Boolean,
            Self::Floats(_) => list(DataType::Float64),
            Self::Integers(_) => list(DataType::Int64),
        }
    }
}

/// Columns of the same length, in their order.
pub(super) type Columns = Vec<(String, Column)>;

/// A Parquet file that grows batch by batch; it gets its name when it is complete. The columns of the first batch are
/// those of the file.
pub(super) struct TableWriter {
    path: PathBuf,
    schema: Arc<Schema>,
    writer: ArrowWriter<File>,
}

impl TableWriter {
    /// Begins a file with its first batch.
    pub(super) fn begin(path: &Path, first: Columns) -> Result<Self, ReportError> {
        let fields: Vec<Field> =
            first.iter().map(|(name, column)| Field::new(name, column.data_type(), true)).collect();
        let schema = Arc::new(Schema::new(fields));
        let temporary = atomic::unfinished(path);
        let file = File::create(&temporary).map_err(ReportError::write(&temporary))?;
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer = ArrowWriter::try_new(file, Arc::clone(&schema), Some(properties)).map_err(failed(path))?;
        let mut table = Self { path: path.to_owned(), schema, writer };
        table.append(first)?;
        Ok(table)
    }

    /// Writes a further batch.
    pub(super) fn append(&mut self, columns: Columns) -> Result<(), ReportError> {
        let arrays = columns.into_iter().map(|(_, column)| column.array()).collect();
        let batch = RecordBatch::try_new(Arc::clone(&self.schema), arrays).map_err(ParquetError::from);
        let written = batch.and_then(|batch| {
            self.writer.write(&batch)?;
            self.writer.flush()
        });
        written.map_err(failed(&self.path))
    }

    /// Completes the file.
    pub(super) fn finish(self) -> Result<(), ReportError> {
        self.writer.close().map_err(failed(&self.path))?;
        fs::rename(atomic::unfinished(&self.path), &self.path).map_err(ReportError::write(&self.path))
    }
}

fn failed(path: &Path) -> impl FnOnce(ParquetError) -> ReportError {
    let path = path.to_owned();
    move |source| ReportError::Parquet { path, source }
}
