//! Columns of Feather and Parquet tables, every cell checked.

use super::error::{Argoverse2Error, LogFault};
use super::ipc_bounds;
use arrow::array::{Array, ArrayRef, AsArray, RecordBatch};
use arrow::compute::{cast, concat_batches};
use arrow::datatypes::{DataType, Float64Type, Int64Type, SchemaRef};
use arrow::error::ArrowError;
use arrow::ipc::reader::FileReader;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;
use std::fs::File;
use std::io::Cursor;
use std::panic::{UnwindSafe, catch_unwind};
use std::path::Path;

/// First bytes of a Feather file of version 1.
const FEATHER_1: &[u8] = b"FEA1";
/// Numbers beyond this are no place on Earth and no size of anything, metres.
const FARTHEST: f64 = 1e8;

/// A table with at least one row.
#[derive(Debug)]
pub(super) struct Table {
    rows: RecordBatch,
}

impl Table {
    /// Reads a Feather file (version 2, which is an Arrow IPC file; uncompressed, LZ4 or ZSTD).
    ///
    /// # Errors
    /// When it cannot be read, is none, or the table is empty.
    pub(super) fn feather(path: &Path) -> Result<Self, Argoverse2Error> {
        let failed = |source| Argoverse2Error::Read { path: path.to_owned(), source };
        let bytes = std::fs::read(path).map_err(failed)?;
        let table =
            if bytes.starts_with(FEATHER_1) { Err(LogFault::OldFeather) } else { guarded(|| Self::of_ipc(&bytes)) };
        table.map_err(|fault| Argoverse2Error::Content { path: path.to_owned(), fault })
    }

    /// Reads a Parquet file (uncompressed or Snappy).
    ///
    /// # Errors
    /// When it cannot be read, is none, or the table is empty.
    pub(super) fn parquet(path: &Path) -> Result<Self, Argoverse2Error> {
        let failed = |source| Argoverse2Error::Read { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        guarded(|| Self::of_parquet(&file)).map_err(|fault| Argoverse2Error::Content { path: path.to_owned(), fault })
    }

    fn of_ipc(bytes: &[u8]) -> Result<Self, LogFault> {
        ipc_bounds::check(bytes)?;
        let reader = FileReader::try_new(Cursor::new(bytes), None)?;
        let schema = reader.schema();
        Self::of_batches(&schema, reader)
    }

    fn of_parquet(file: &File) -> Result<Self, LogFault> {
        let file = file.try_clone().map_err(ParquetError::from)?;
        let builder = ParquetRecordBatchReaderBuilder::try_new(file)?;
        let schema = builder.schema().clone();
        Self::of_batches(&schema, builder.build()?)
    }

    fn of_batches(
        schema: &SchemaRef,
        batches: impl Iterator<Item = Result<RecordBatch, ArrowError>>,
    ) -> Result<Self, LogFault> {
        let batches = batches.collect::<Result<Vec<_>, ArrowError>>()?;
        let rows = concat_batches(schema, &batches)?;
        if rows.num_rows() == 0 { Err(LogFault::Empty) } else { Ok(Self { rows }) }
    }

    /// A column of whole numbers.
    ///
    /// # Errors
    /// When it is missing, holds something else or has an empty cell.
    pub(super) fn integers(&self, column: &'static str) -> Result<Vec<i64>, LogFault> {
        let values = self.column(column, DataType::is_integer, &DataType::Int64, "whole numbers")?;
        Ok(values.as_primitive::<Int64Type>().values().to_vec())
    }

    /// A column of finite numbers no larger than a place on Earth.
    ///
    /// # Errors
    /// When it is missing, holds something else, or has a cell that is empty or not to be believed.
    pub(super) fn numbers(&self, column: &'static str) -> Result<Vec<f64>, LogFault> {
        let values = self.column(column, DataType::is_numeric, &DataType::Float64, "numbers")?;
        let values = values.as_primitive::<Float64Type>().values().to_vec();
        match values.iter().position(|value| value.is_nan() || value.abs() > FARTHEST) {
            Some(row) => Err(LogFault::Unbelievable { column, row, value: values[row] }),
            None => Ok(values),
        }
    }

    /// A column of words.
    ///
    /// # Errors
    /// When it is missing, holds something else or has an empty cell.
    pub(super) fn words(&self, column: &'static str) -> Result<Vec<String>, LogFault> {
        let is_text = |kind: &DataType| matches!(kind, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View);
        let of_text = |kind: &DataType| match kind {
            DataType::Dictionary(_, values) => is_text(values),
            plain => is_text(plain),
        };
        let values = self.column(column, of_text, &DataType::Utf8, "words")?;
        Ok(values.as_string::<i32>().iter().map(|word| word.unwrap_or_default().to_owned()).collect())
    }

    /// A column as `wanted`, without empty cells.
    fn column(
        &self,
        column: &'static str,
        suits: impl Fn(&DataType) -> bool,
        wanted: &DataType,
        needed: &'static str,
    ) -> Result<ArrayRef, LogFault> {
        let found = self.rows.column_by_name(column).ok_or(LogFault::NoColumn { column })?;
        if !suits(found.data_type()) {
            return Err(LogFault::WrongType { column, found: found.data_type().to_string(), needed });
        }
        // A value that does not fit the wanted type becomes empty.
        let values = cast(found, wanted)?;
        match (0..values.len()).find(|&row| values.is_null(row)) {
            Some(row) => Err(LogFault::NoValue { column, row }),
            None => Ok(values),
        }
    }
}

/// Reads a table, be it as damaged as it may: the readers of both formats stop with a panic at lengths that do not fit each
/// other, and a damaged file is a fault of that file.
fn guarded(read: impl FnOnce() -> Result<Table, LogFault> + UnwindSafe) -> Result<Table, LogFault> {
    catch_unwind(read).unwrap_or(Err(LogFault::Unreadable))
}
