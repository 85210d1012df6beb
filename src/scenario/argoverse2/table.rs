//! Columns of Feather and Parquet tables with checked cells.

use super::error::{Argoverse2Error, LogFault};
use super::{cells, ipc_bounds};
use crate::recording::motion::MAX_COORDINATE;
use arrow_array::{Array, RecordBatch};
use arrow_ipc::reader::FileReader;
use arrow_schema::{ArrowError, SchemaRef};
use arrow_select::concat::concat_batches;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;
use planagent_files::{KIND_BYTES, kind_of};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Cursor, Read};
use std::panic::{UnwindSafe, catch_unwind};
use std::path::Path;

/// First bytes of a Feather file of version 1.
const FEATHER_1: &[u8] = b"FEA1";

/// First bytes of a stream of Arrow.
const STREAM: &[u8] = &[0xff; 4];

/// First bytes of a Feather file of version 2, and of a Parquet file.
const FEATHER: &[u8] = b"ARROW1";
const PARQUET: &[u8] = b"PAR1";

/// Maximum size of a table in memory, bytes. The longest logs have a few MB. Compressed columns of
/// equal cells may be a thousand times smaller in the file.
const MAX_TABLE: usize = 1 << 28;
/// Maximum number of rows; a column without bytes of its own still has cells.
const MAX_ROWS: usize = 1 << 22;

/// A table with at least one row.
#[derive(Debug)]
pub(super) struct Table {
    rows: RecordBatch,
}

impl Table {
    /// Reads a Feather file of version 2 (an Arrow IPC file; uncompressed, LZ4 or ZSTD).
    pub(super) fn feather(path: &Path) -> Result<Self, Argoverse2Error> {
        let mut bytes = Vec::new();
        let read = planagent_files::open(path).and_then(|mut file| file.read_to_end(&mut bytes));
        read.map_err(Argoverse2Error::at(path))?;
        let table = if bytes.starts_with(FEATHER_1) {
            Err(LogFault::OldFeather)
        } else if bytes.starts_with(STREAM) {
            Err(LogFault::Stream)
        } else {
            check_kind(&bytes, FEATHER, "Feather").and_then(|()| guarded(|| Self::of_ipc(&bytes)))
        };
        table.map_err(Argoverse2Error::at(path))
    }

    /// Reads a Parquet file, in any of the format's compressions.
    pub(super) fn parquet(path: &Path) -> Result<Self, Argoverse2Error> {
        let mut file = planagent_files::open(path).map_err(Argoverse2Error::at(path))?;
        let mut beginning = Vec::new();
        let looked_at = (&mut file)
            .take(KIND_BYTES as u64)
            .read_to_end(&mut beginning);
        looked_at.map_err(Argoverse2Error::at(path))?;
        check_kind(&beginning, PARQUET, "Parquet").map_err(Argoverse2Error::at(path))?;
        guarded(|| Self::of_parquet(&file)).map_err(Argoverse2Error::at(path))
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
        // Arrow's errors here are those of the Parquet file.
        Self::of_batches(&schema, builder.build()?).map_err(|fault| match fault {
            LogFault::Arrow(error) => LogFault::ParquetValues(error),
            fault => fault,
        })
    }

    fn of_batches(
        schema: &SchemaRef,
        batches: impl Iterator<Item = Result<RecordBatch, ArrowError>>,
    ) -> Result<Self, LogFault> {
        let mut read = Vec::new();
        let (mut rows, mut size) = (0_usize, 0_usize);
        for batch in batches {
            let batch = batch?;
            rows = rows.saturating_add(batch.num_rows());
            size = size.saturating_add(memory(&batch)?);
            if rows > MAX_ROWS || size > MAX_TABLE {
                return Err(LogFault::TooLarge {
                    rows: MAX_ROWS,
                    mebibytes: MAX_TABLE >> 20,
                });
            }
            read.push(batch);
        }
        let rows = concat_batches(schema, &read)?;
        if rows.num_rows() == 0 {
            Err(LogFault::Empty)
        } else {
            Ok(Self { rows })
        }
    }

    /// A column of integers without empty cells.
    pub(super) fn integers(&self, column: &'static str) -> Result<Vec<i64>, LogFault> {
        self.column(column, cells::integers, "integers")
    }

    /// A column of finite numbers up to [`MAX_COORDINATE`], without empty cells.
    pub(super) fn numbers(&self, column: &'static str) -> Result<Vec<f64>, LogFault> {
        let values = self.column(column, cells::numbers, "numbers")?;
        in_range(column, values, |value| value.abs() <= MAX_COORDINATE)
    }

    /// A column of text without empty cells.
    pub(super) fn words(&self, column: &'static str) -> Result<Vec<String>, LogFault> {
        self.column(column, cells::words, "text")
    }

    /// Number of different texts in a column.
    pub(super) fn distinct(&self, column: &'static str) -> Result<usize, LogFault> {
        Ok(self
            .words(column)?
            .into_iter()
            .collect::<BTreeSet<_>>()
            .len())
    }

    /// A column without empty cells, by a function that gives nothing for another type of column.
    fn column<T>(
        &self,
        column: &'static str,
        read: impl Fn(&dyn Array) -> Option<Vec<Option<T>>>,
        needed: &'static str,
    ) -> Result<Vec<T>, LogFault> {
        let found = self
            .rows
            .column_by_name(column)
            .ok_or(LogFault::NoColumn { column })?;
        let wrong_type = || LogFault::WrongType {
            column,
            found: found.data_type().to_string(),
            needed,
        };
        let cells = read(found).ok_or_else(wrong_type)?.into_iter().enumerate();
        cells
            .map(|(row, cell)| cell.ok_or(LogFault::NoValue { column, row }))
            .collect()
    }
}

/// Size of the cells of a batch, bytes.
fn memory(batch: &RecordBatch) -> Result<usize, ArrowError> {
    let sizes = batch.columns().iter().map(|column| {
        // A slice of a larger batch counts with its own cells alone.
        column.to_data().get_slice_memory_size()
    });
    sizes.sum()
}

/// Refuses a file that is known to be of another kind.
fn check_kind(beginning: &[u8], magic: &[u8], needed: &'static str) -> Result<(), LogFault> {
    match kind_of(beginning) {
        Some(kind) if !beginning.starts_with(magic) => Err(LogFault::OtherFile { needed, kind }),
        _ => Ok(()),
    }
}

/// Checks all values of a column.
pub(super) fn in_range(
    column: &'static str,
    values: Vec<f64>,
    is_valid: impl Fn(f64) -> bool,
) -> Result<Vec<f64>, LogFault> {
    match values.iter().position(|&value| !is_valid(value)) {
        Some(row) => Err(LogFault::OutOfRange {
            column,
            row,
            value: values[row],
        }),
        None => Ok(values),
    }
}

/// Turns a panic into a fault: the readers of both formats panic at lengths that contradict each
/// other.
fn guarded(read: impl FnOnce() -> Result<Table, LogFault> + UnwindSafe) -> Result<Table, LogFault> {
    catch_unwind(read).unwrap_or(Err(LogFault::Unreadable))
}
