//! Results of runs, and what reads or joins the folders of runs.

use crate::errors::{Failure, Outcome};
use crate::table::Table;
use crate::work::{computed, long, quick};
use planagent::runs::RunResults as Finished;
use planagent_runs::report::page::{PageSettings, write as write_page};
use planagent_runs::report::{
    ReportError, RunFolder, SimulationRow, simulation_folders, simulation_metrics,
};
use planagent_runs::runner::{RunnerError, merge as merge_runs};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_pickle::{DeOptions, SerOptions};
use std::path::PathBuf;
use std::sync::Arc;

/// The results of a finished run.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct RunResults {
    folder: PathBuf,
    rows: Arc<Vec<SimulationRow>>,
    missing: usize,
    /// How many simulations the whole run has.
    total: usize,
}

impl From<Finished> for RunResults {
    fn from(finished: Finished) -> Self {
        let missing = finished
            .missing
            .iter()
            .map(|missing| missing.absent.len() + missing.excluded.len())
            .sum();
        Self {
            total: finished.rows.len(),
            folder: finished.folder,
            rows: Arc::new(finished.rows),
            missing,
        }
    }
}

#[pymethods]
impl RunResults {
    #[getter]
    fn folder(&self) -> PathBuf {
        self.folder.clone()
    }

    /// How many scenarios of the splits the data lacks.
    #[getter]
    fn missing(&self) -> usize {
        self.missing
    }

    /// How many simulations the whole run has.
    #[getter]
    fn total(&self) -> usize {
        self.total
    }

    /// The rows as bytes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = quick(py, || {
            serde_pickle::to_vec(&*self.rows, SerOptions::new())
                .map_err(|error| Failure::panic(format!("the results as bytes: {error}")))
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The results of rows as bytes.
    #[staticmethod]
    fn of_bytes(
        py: Python<'_>,
        folder: PathBuf,
        rows: &[u8],
        missing: usize,
        total: usize,
    ) -> PyResult<Self> {
        quick(py, || {
            let rows = serde_pickle::from_slice(rows, DeOptions::new());
            let rows =
                rows.map_err(|error| Failure::argument(format!("the bytes of results: {error}")))?;
            Ok(Self {
                folder,
                rows: Arc::new(rows),
                missing,
                total,
            })
        })
    }

    fn table(&self, py: Python<'_>) -> PyResult<Table> {
        let rows = Arc::clone(&self.rows);
        quick(py, || Table::of_rows(&rows))
    }
}

fn of_report(error: ReportError) -> Failure {
    RunnerError::Report(error).into()
}

/// What is completed of the run in a folder.
pub(crate) fn completed(folder: PathBuf) -> Outcome<RunResults> {
    let manifest = RunFolder::manifest(&folder).map_err(of_report)?;
    let rows = RunFolder::read_completed(&folder).map_err(of_report)?.rows;
    let lists = &manifest.scenarios.missing;
    Ok(RunResults {
        missing: lists
            .iter()
            .map(|missing| missing.absent.len() + missing.excluded.len())
            .sum(),
        total: manifest.simulations(),
        rows: Arc::new(rows),
        folder,
    })
}

/// What is completed of the run in a folder.
#[pyfunction]
pub(crate) fn read_run(py: Python<'_>, folder: PathBuf) -> PyResult<RunResults> {
    long(py, || computed(|| completed(folder)), &|| ())
}

/// Merges the shards of a run into a new folder.
#[pyfunction]
pub(crate) fn merge(py: Python<'_>, runs: Vec<PathBuf>, folder: PathBuf) -> PyResult<RunResults> {
    let work = move || Ok(RunResults::from(merge_runs(&runs, Some(&folder))?));
    long(py, || computed(work), &|| ())
}

/// The statistics of all metrics of the simulations in the folder of a run.
#[pyfunction]
pub(crate) fn statistics(py: Python<'_>, folder: PathBuf) -> PyResult<Table> {
    let work = move || {
        let rows = RunFolder::read_completed(&folder).map_err(of_report)?.rows;
        let folders = simulation_folders(&folder).map_err(of_report)?;
        let mut all = Vec::new();
        for row in rows.into_iter().filter(|row| row.error.is_none()) {
            if let Some(place) = folders.get(&row.number) {
                let metrics = simulation_metrics(place).map_err(of_report)?;
                all.push((row, metrics));
            }
        }
        Table::of_statistics(&all)
    };
    long(py, || computed(work), &|| ())
}

/// Writes the page of the run in a folder.
#[pyfunction]
pub(crate) fn write_report(py: Python<'_>, folder: PathBuf, out: PathBuf) -> PyResult<()> {
    let work = move || {
        let written = write_page(&[folder], Some(&out), &PageSettings::default(), &|_, _| ());
        written.map(drop).map_err(of_report)
    };
    long(py, || computed(work), &|| ())
}
