//! Runs of many simulations.

use crate::errors::{Failure, Outcome};
use crate::python_planner::entry;
use crate::settings::{config, shared_model};
use crate::table::Table;
use crate::work::{lock, long};
use planagent::planning::{PlannerRegistry, all_planners};
use planagent::runs::{Config, Event, Request, RunResults as Finished, StopSwitch, resume, start};
use planagent::sources::DataRoots;
use planagent_runs::report::SimulationRow;
use planagent_runs::runner::{Shard, merge as merge_runs};
use pyo3::prelude::*;
use serde::Deserialize;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// What Python asks for, as JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    scenarios: Vec<String>,
    splits: Vec<String>,
    types: Vec<String>,
    shuffle: bool,
    limit: Option<usize>,
    shard: Option<String>,
    planners: Vec<String>,
    challenges: Vec<String>,
    /// Settings over the defaults, as JSON; of a run that is resumed, its own without any.
    settings: Option<String>,
    retry_failed: bool,
}

impl Asked {
    fn request(self, registry: PlannerRegistry, stop: &StopSwitch) -> Outcome<Request> {
        let shard = self.shard.map(|text| text.parse()).transpose();
        Ok(Request {
            scenarios: self.scenarios,
            splits: self.splits,
            types: self.types,
            shuffle: self.shuffle,
            limit: self.limit,
            shard: shard.map_err(|error| Failure::argument(format!("{error}")))?,
            planners: self.planners,
            challenges: self.challenges,
            registry,
            loader: shared_model,
            roots: DataRoots::from_environment(),
            retry_failed: self.retry_failed,
            stop: Some(stop.clone()),
            ..Request::default()
        })
    }
}

/// What a run has done so far. Worker threads write it; the thread that waits for the run shows it.
#[derive(Default)]
struct Progress {
    total: AtomicUsize,
    done: AtomicUsize,
    failed: AtomicUsize,
    steps: AtomicUsize,
    notes: Mutex<Vec<String>>,
}

impl Progress {
    fn hear(&self, event: Event) {
        match event {
            Event::Started { total } => self.total.store(total, Ordering::Relaxed),
            Event::Stepped => drop(self.steps.fetch_add(1, Ordering::Relaxed)),
            Event::Ended { failed } => {
                self.failed
                    .fetch_add(usize::from(failed), Ordering::Relaxed);
                self.done.fetch_add(1, Ordering::Relaxed);
            }
            Event::Note(note) => lock(&self.notes).push(note),
            Event::CallFailed(call) => lock(&self.notes).push(call.to_string()),
            _ => {}
        }
    }

    /// Calls back with done, total, failed, steps and the new notes, if anything changed.
    fn tell(&self, py: Python<'_>, callback: &Py<PyAny>, last: &Mutex<[usize; 4]>) -> PyResult<()> {
        let load = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);
        let now = [
            load(&self.done),
            load(&self.total),
            load(&self.failed),
            load(&self.steps),
        ];
        let notes = std::mem::take(&mut *lock(&self.notes));
        if notes.is_empty() && *lock(last) == now {
            return Ok(());
        }
        *lock(last) = now;
        callback
            .call1(py, (now[0], now[1], now[2], now[3], notes))
            .map(drop)
    }
}

/// The results of a finished run.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct RunResults {
    folder: PathBuf,
    rows: Arc<Vec<SimulationRow>>,
    missing: usize,
}

impl From<Finished> for RunResults {
    fn from(finished: Finished) -> Self {
        let missing = finished
            .missing
            .iter()
            .map(|missing| missing.absent.len() + missing.excluded.len())
            .sum();
        Self {
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

    fn table(&self, py: Python<'_>) -> PyResult<Table> {
        let rows = Arc::clone(&self.rows);
        crate::work::quick(py, || Table::of_rows(&rows))
    }
}

/// Starts or resumes a run; `planners` holds the planners in Python with their names.
#[pyfunction]
#[pyo3(signature = (asked, folder, is_resumed, planners, progress=None))]
pub(crate) fn run(
    py: Python<'_>,
    asked: String,
    folder: PathBuf,
    is_resumed: bool,
    planners: Vec<(String, Py<PyAny>)>,
    progress: Option<Py<PyAny>>,
) -> PyResult<RunResults> {
    let (switch, heard) = (StopSwitch::default(), Arc::new(Progress::default()));
    let (stop, hearing) = (switch.clone(), Arc::clone(&heard));
    let work = move || {
        let asked: Asked =
            serde_json::from_str(&asked).map_err(|error| Failure::argument(error.to_string()))?;
        let built_in = all_planners();
        let mut registry = all_planners();
        for (name, make) in planners {
            if built_in.find(&name).is_ok() {
                let text =
                    format!("'{name}' is the name of a planner of the library; give yours another");
                return Err(Failure::argument(text));
            }
            registry = registry.with(entry(name, make));
        }
        let config = match (&asked.settings, is_resumed) {
            (None, true) => Config::of_run(&folder)?,
            (settings, _) => config(settings.as_deref().unwrap_or("{}"))?,
        };
        let request = asked.request(registry, &switch)?;
        let listener: Arc<dyn Fn(Event) + Send + Sync> = Arc::new(move |event| hearing.hear(event));
        let finished = if is_resumed {
            resume(&folder, &request, &config, &listener)
        } else {
            start(&request, &config, Some(&folder), &listener)
        };
        Ok(RunResults::from(finished?))
    };
    let last = Mutex::new([0; 4]);
    let look = move |py: Python<'_>| match &progress {
        Some(callback) => heard.tell(py, callback, &last),
        None => Ok(()),
    };
    long(py, work, &move || stop.stop(), &look)
}

/// The shard that environment variables name; none without any.
#[pyfunction]
pub(crate) fn shard_of_environment(
    py: Python<'_>,
    variables: HashMap<String, String>,
) -> PyResult<Option<String>> {
    let shard = Shard::of_environment(|name| variables.get(name).cloned());
    shard
        .map(|shard| shard.map(|shard| shard.to_string()))
        .map_err(|error| Failure::argument(error.to_string()).raised(py))
}

/// Merges the shards of a run into a new folder.
#[pyfunction]
pub(crate) fn merge(py: Python<'_>, runs: Vec<PathBuf>, folder: PathBuf) -> PyResult<RunResults> {
    let work = move || Ok(RunResults::from(merge_runs(&runs, Some(&folder))?));
    long(py, work, &|| (), &|_| Ok(()))
}
