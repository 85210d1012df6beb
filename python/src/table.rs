//! Results as Arrow tables, which pandas, polars, pyarrow and `DuckDB` read by the `PyCapsule`
//! interface.

use crate::errors::{Failure, Outcome, Raise};
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, RecordBatchIterator,
    StringArray,
};
use arrow_schema::{ArrowError, DataType, Field, Schema, ffi::FFI_ArrowSchema};
use planagent_runs::report::SimulationRow;
use planagent_score::metrics::{MetricResult, Statistic};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyList};
use std::sync::Arc;

/// A table: named columns of texts, numbers and truth values.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Table {
    batch: RecordBatch,
}

fn texts<'a>(values: impl Iterator<Item = Option<&'a str>>) -> ArrayRef {
    Arc::new(values.collect::<StringArray>())
}

fn numbers(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    Arc::new(values.collect::<Float64Array>())
}

fn counts(values: impl Iterator<Item = usize>) -> ArrayRef {
    Arc::new(Int64Array::from_iter_values(
        values.map(|value| value as i64),
    ))
}

impl Table {
    /// A row for each simulation: what it was, its score, the scores of the metrics, how it was
    /// planned. The names are those of `planagent simulate --csv`, with `scenario` (its word) and
    /// `seconds` beside them.
    pub(crate) fn of_rows(rows: &[SimulationRow]) -> Outcome<Self> {
        let all = || rows.iter();
        let text = |of: fn(&SimulationRow) -> Option<&str>| texts(all().map(of));
        let count = |of: fn(&SimulationRow) -> usize| counts(all().map(of));
        let mut columns: Vec<(String, ArrayRef)> = [
            ("scenario", text(|row| Some(&row.source))),
            ("id", text(|row| Some(&row.scenario))),
            ("scenario_type", text(|row| Some(&row.scenario_type))),
            ("log_name", text(|row| Some(&row.log_name))),
            ("planner", text(|row| Some(&row.planner))),
            ("challenge", text(|row| Some(row.challenge.short_name()))),
            (
                "succeeded",
                Arc::new(
                    all()
                        .map(|row| Some(row.error.is_none()))
                        .collect::<BooleanArray>(),
                ),
            ),
            ("score", numbers(all().map(|row| row.score))),
            ("error", text(|row| row.error.as_deref())),
            ("planning_calls", count(|row| row.planning_calls)),
            ("gated_calls", count(|row| row.gated_calls)),
            ("refused_calls", count(|row| row.refused_calls)),
            ("rethinks", count(|row| row.rethinks)),
            ("parse_errors", count(|row| row.parse_errors)),
            ("deadlines", count(|row| row.deadlines)),
            ("failed_calls", count(|row| row.failed_calls)),
            ("unreadable_calls", count(SimulationRow::unreadable)),
            (
                "seconds",
                numbers(all().map(|row| Some(row.time.ended_s - row.time.started_s))),
            ),
        ]
        .map(|(name, column)| (name.to_owned(), column))
        .into();
        let mut metrics: Vec<&str> = Vec::new();
        for metric in all()
            .flat_map(|row| &row.metrics)
            .filter(|metric| metric.score.is_some())
        {
            if !metrics.contains(&metric.name.as_str()) {
                metrics.push(&metric.name);
            }
        }
        for name in metrics {
            columns.push((name.to_owned(), numbers(all().map(|row| row.metric(name)))));
        }
        Self::from_columns(columns)
    }

    /// A row for each statistic of each metric of each simulation.
    pub(crate) fn of_statistics(all: &[(SimulationRow, Vec<MetricResult>)]) -> Outcome<Self> {
        let rows: Vec<(&SimulationRow, &MetricResult, &Statistic)> = all
            .iter()
            .flat_map(|(row, metrics)| metrics.iter().map(move |metric| (row, metric)))
            .flat_map(|(row, metric)| metric.statistics.iter().map(move |one| (row, metric, one)))
            .collect();
        let of_row =
            |of: fn(&SimulationRow) -> &str| texts(rows.iter().map(move |(row, ..)| Some(of(row))));
        Self::from_columns(
            [
                ("scenario", of_row(|row| &row.scenario)),
                ("planner", of_row(|row| &row.planner)),
                ("challenge", of_row(|row| row.challenge.short_name())),
                (
                    "metric",
                    texts(rows.iter().map(|(_, metric, _)| Some(metric.name.as_str()))),
                ),
                (
                    "metric_score",
                    numbers(rows.iter().map(|(_, metric, _)| metric.score)),
                ),
                (
                    "statistic",
                    texts(rows.iter().map(|(.., one)| Some(one.name.as_str()))),
                ),
                (
                    "value",
                    numbers(rows.iter().map(|(.., one)| Some(one.value))),
                ),
                (
                    "unit",
                    texts(rows.iter().map(|(.., one)| Some(one.unit.as_str()))),
                ),
            ]
            .map(|(name, column)| (name.to_owned(), column))
            .into(),
        )
    }

    fn from_columns(columns: Vec<(String, ArrayRef)>) -> Outcome<Self> {
        let fields: Vec<Field> = columns
            .iter()
            .map(|(name, column)| Field::new(name, column.data_type().clone(), true))
            .collect();
        let arrays = columns.into_iter().map(|(_, column)| column).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays);
        Ok(Self {
            batch: batch.map_err(|error| failed(&error))?,
        })
    }
}

fn failed(error: &ArrowError) -> Failure {
    Failure::panic(error.to_string())
}

/// A column as a list; a missing value is None.
fn list<'py>(py: Python<'py>, column: &dyn Array) -> PyResult<Bound<'py, PyList>> {
    let any = column.as_any();
    if let Some(column) = any.downcast_ref::<StringArray>() {
        PyList::new(py, column.iter().collect::<Vec<_>>())
    } else if let Some(column) = any.downcast_ref::<Float64Array>() {
        PyList::new(py, column.iter().collect::<Vec<_>>())
    } else if let Some(column) = any.downcast_ref::<Int64Array>() {
        PyList::new(py, column.iter().collect::<Vec<_>>())
    } else if let Some(column) = any.downcast_ref::<BooleanArray>() {
        PyList::new(py, column.iter().collect::<Vec<_>>())
    } else {
        Err(Failure::panic(format!("a column has the type {}", column.data_type())).raised(py))
    }
}

#[pymethods]
impl Table {
    /// A table of columns as lists with their names and kinds (`text`, `number`, `count`, `truth`).
    #[staticmethod]
    fn of_columns(
        py: Python<'_>,
        columns: Vec<(String, String, Bound<'_, PyAny>)>,
    ) -> PyResult<Self> {
        let mut made: Vec<(String, ArrayRef)> = Vec::new();
        for (name, kind, values) in columns {
            let column: ArrayRef = match kind.as_str() {
                "text" => {
                    let values: Vec<Option<String>> = values.extract()?;
                    Arc::new(values.into_iter().collect::<StringArray>())
                }
                "number" => Arc::new(Float64Array::from(values.extract::<Vec<Option<f64>>>()?)),
                "count" => Arc::new(Int64Array::from(values.extract::<Vec<Option<i64>>>()?)),
                _ => Arc::new(BooleanArray::from(values.extract::<Vec<Option<bool>>>()?)),
            };
            made.push((name, column));
        }
        Self::from_columns(made).or_raise(py)
    }

    /// The kinds of the columns.
    fn kinds(&self) -> Vec<&'static str> {
        let kind = |column: &ArrayRef| match column.data_type() {
            DataType::Utf8 => "text",
            DataType::Float64 => "number",
            DataType::Int64 => "count",
            _ => "truth",
        };
        self.batch.columns().iter().map(kind).collect()
    }

    fn __len__(&self) -> usize {
        self.batch.num_rows()
    }

    #[getter]
    fn columns(&self) -> Vec<String> {
        self.batch
            .schema()
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect()
    }

    /// The columns as lists.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (field, column) in self
            .batch
            .schema()
            .fields()
            .iter()
            .zip(self.batch.columns())
        {
            dict.set_item(field.name(), list(py, column.as_ref())?)?;
        }
        Ok(dict)
    }

    /// The schema as an Arrow capsule.
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.batch.schema().as_ref());
        PyCapsule::new_with_value(
            py,
            schema.map_err(|error| failed(&error)).or_raise(py)?,
            c"arrow_schema",
        )
    }

    /// The table as a stream of Arrow arrays.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // A consumer may ask for other types, and must accept these.
        drop(requested_schema);
        let batches: Vec<Result<RecordBatch, ArrowError>> = vec![Ok(self.batch.clone())];
        let reader = RecordBatchIterator::new(batches, self.batch.schema());
        PyCapsule::new_with_value(
            py,
            FFI_ArrowArrayStream::new(Box::new(reader)),
            c"arrow_array_stream",
        )
    }
}
