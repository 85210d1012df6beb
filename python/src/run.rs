//! Runs of many simulations.

use crate::command::trial;
use crate::errors::{Failure, Outcome, Raise};
use crate::interrupts::Interrupts;
use crate::python_planner::entry;
use crate::relay::{Question, Relay};
use crate::run_results::{RunResults, completed};
use crate::settings::{config, shared_model};
use crate::trajectory::Trajectory;
use crate::work::{POLL, guarded, lock, own_pool, spawned};
use planagent::planning::{PlannerRegistry, all_planners};
use planagent::runs::{Config, Event, Request, StopSwitch, resume, start};
use planagent::sources::DataRoots;
use planagent_runs::runner::{RunnerError, Shard};
use pyo3::prelude::*;
use serde::Deserialize;
use std::collections::HashMap;
use std::mem::take;
use std::path::PathBuf;
use std::process;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

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
    /// A command that controls the other agents.
    agents: Option<String>,
    /// Time that a command may take for a step, seconds.
    exec_timeout: Option<f64>,
    /// Settings over the defaults, as JSON; of a run that is resumed, its own without any.
    settings: Option<String>,
    retry_failed: bool,
    accept_changes: bool,
}

impl Asked {
    fn request(self, registry: PlannerRegistry, stop: &StopSwitch) -> Outcome<Request> {
        let shard = self.shard.map(|text| text.parse()).transpose();
        let usual = Request::default();
        let exec_timeout = match self.exec_timeout {
            None => usual.exec_timeout,
            Some(seconds) => Duration::try_from_secs_f64(seconds).map_err(|error| {
                Failure::argument(format!("exec_timeout is {seconds}: {error}"))
            })?,
        };
        Ok(Request {
            agents: self.agents,
            exec_timeout,
            accept_changes: self.accept_changes,
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
            ..usual
        })
    }
}

/// What a run has done so far. Its threads write it; the thread of Python that waits for the run
/// reads it.
#[derive(Default)]
struct Progress {
    total: AtomicUsize,
    done: AtomicUsize,
    failed: AtomicUsize,
    steps: AtomicUsize,
    news: Mutex<News>,
    changed: Condvar,
}

/// What the thread of Python shall know at once.
#[derive(Default)]
struct News {
    notes: Vec<String>,
    /// Seats that need a thread of Python.
    seats: Vec<usize>,
    ended: Option<Outcome<RunResults>>,
    /// What was completed of a run that was stopped and whose files are not kept.
    so_far: Option<RunResults>,
    is_over: bool,
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
            Event::Note(note) => lock(&self.news).notes.push(note),
            Event::SimulationFailed { failure } => lock(&self.news).notes.push(failure),
            Event::CallFailed(call) => lock(&self.news).notes.push(call.to_string()),
            _ => {}
        }
    }

    fn want(&self, seat: usize) {
        lock(&self.news).seats.push(seat);
        self.changed.notify_all();
    }

    fn end(&self, outcome: Outcome<RunResults>, so_far: Option<RunResults>) {
        let mut news = lock(&self.news);
        (news.ended, news.so_far, news.is_over) = (Some(outcome), so_far, true);
        self.changed.notify_all();
    }
}

/// A run in progress. A thread of Python waits for it, and starts threads of Python for the seats
/// of its planners in Python.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Run {
    progress: Arc<Progress>,
    relay: Arc<Relay>,
    switch: StopSwitch,
    /// Only while somebody waits for the run.
    watch: Mutex<Option<Interrupts>>,
    /// The process that simulates: a forked one has none of its threads, and locks that they held.
    pid: u32,
}

impl Run {
    fn end(&self) {
        if self.pid == process::id() {
            self.switch.stop();
            self.relay.close();
        }
    }
}

/// Whether it is over; done, total, failed and steps; new notes; seats that need a thread.
type Look = (bool, [usize; 4], Vec<String>, Vec<usize>);

/// A question to a planner in Python: what (`make`, `reset`, `plan`, `drop`), the number of the
/// simulation, and the number of the planner or the observation.
type Put<'py> = (&'static str, u64, Option<Bound<'py, PyAny>>);

#[pymethods]
impl Run {
    /// Starts or resumes a run; `planners` holds the names of the planners in Python. Of a run
    /// whose files are `not_kept`, the folder is removed once it is left.
    #[new]
    fn new(
        py: Python<'_>,
        asked: String,
        folder: PathBuf,
        is_resumed: bool,
        planners: Vec<String>,
        not_kept: Option<PathBuf>,
    ) -> PyResult<Self> {
        let watch = Interrupts::of_this_thread(py)?;
        let pool = own_pool().or_raise(py)?;
        let progress = Arc::new(Progress::default());
        let wanting = Arc::clone(&progress);
        let seats = pool.current_num_threads();
        let relay = Arc::new(Relay::new(seats, move |seat| wanting.want(seat)));
        let switch = StopSwitch::default();
        let (stop, questions, hearing) =
            (switch.clone(), Arc::clone(&relay), Arc::clone(&progress));
        let work = move || {
            let listener: Arc<dyn Fn(Event) + Send + Sync> = {
                let hearing = Arc::clone(&hearing);
                Arc::new(move |event| hearing.hear(event))
            };
            let outcome = pool.install(|| {
                guarded(|| {
                    let asked: Asked = serde_json::from_str(&asked)
                        .map_err(|error| Failure::panic(error.to_string()))?;
                    let built_in = all_planners();
                    let mut registry = all_planners();
                    for (number, name) in planners.into_iter().enumerate() {
                        if built_in.find(&name).is_ok() {
                            return Err(Failure::argument(format!(
                                "'{name}' is the name of a planner of the library; give yours another by a dictionary: \
                                 planners={{'my-{name}': ...}}"
                            )));
                        }
                        registry = registry.with(entry(name, number, Arc::clone(&questions)));
                    }
                    let mut config = match (&asked.settings, is_resumed) {
                        (None, true) => Config::of_run(&folder)?,
                        (settings, _) => config(settings.as_deref().unwrap_or("{}"))?,
                    };
                    config.mllm.trust = trial();
                    let request = asked.request(registry, &stop)?;
                    let finished = if is_resumed {
                        resume(&folder, &request, &config, &listener)
                            .map_err(|error| of_own_planner(&request, error))?
                    } else {
                        start(&request, &config, Some(&folder), &listener)?
                    };
                    Ok(RunResults::from(finished))
                })
            });
            questions.close();
            // Who was interrupted has removed the folder, and it may have been written since.
            let mut so_far = None;
            if stop.is_stopped()
                && let Some(temporary) = not_kept
            {
                // A run that had not begun has completed nothing.
                so_far = completed(folder).ok();
                let _ = std::fs::remove_dir_all(temporary);
            }
            hearing.end(outcome, so_far);
        };
        spawned(work).or_raise(py)?;
        Ok(Self {
            progress,
            relay,
            switch,
            watch: Mutex::new(Some(watch)),
            pid: process::id(),
        })
    }

    /// Waits without the GIL until something happens, at most some seconds. Raises
    /// `KeyboardInterrupt` after Ctrl-C where Python itself does not.
    fn wait(&self, py: Python<'_>, seconds: f64) -> PyResult<Look> {
        let time = Duration::try_from_secs_f64(seconds).unwrap_or(POLL);
        let (notes, seats, is_over) = py.detach(|| {
            let news = lock(&self.progress.news);
            let nothing = |news: &mut News| !news.is_over && news.seats.is_empty();
            let waited = self
                .progress
                .changed
                .wait_timeout_while(news, time, nothing);
            let (mut news, _) = waited.unwrap_or_else(PoisonError::into_inner);
            let (notes, seats) = (take(&mut news.notes), take(&mut news.seats));
            (notes, seats, news.is_over)
        });
        if is_over || self.switch.is_stopped() {
            lock(&self.watch).take();
        } else if let Some(watch) = &*lock(&self.watch) {
            watch.check()?;
        }
        let load = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);
        let progress = &self.progress;
        let counts = [
            load(&progress.done),
            load(&progress.total),
            load(&progress.failed),
            load(&progress.steps),
        ];
        Ok((is_over, counts, notes, seats))
    }

    /// Stops the run: what is completed stays, what is simulated is left where it is.
    fn stop(&self, py: Python<'_>) {
        py.detach(|| self.end());
    }

    /// Whether it was stopped.
    #[getter]
    fn is_stopped(&self) -> bool {
        self.switch.is_stopped()
    }

    /// What was completed of a run that was stopped and whose files are not kept, once it is over.
    fn so_far(&self, py: Python<'_>) -> Option<RunResults> {
        py.detach(|| lock(&self.progress.news).so_far.take())
    }

    /// The results of a run that is over, once.
    fn result(&self, py: Python<'_>) -> PyResult<RunResults> {
        let ended = py.detach(|| lock(&self.progress.news).ended.take());
        ended
            .unwrap_or_else(|| Err(Failure::panic("the run is not over")))
            .or_raise(py)
    }

    /// The next question of a seat to the planners in Python; none once the run is over.
    fn question<'py>(&self, py: Python<'py>, seat: usize) -> PyResult<Option<Put<'py>>> {
        let Some(question) = py.detach(|| self.relay.next(seat)) else {
            return Ok(None);
        };
        Ok(Some(match question {
            Question::Make {
                simulation,
                planner,
            } => (
                "make",
                simulation,
                Some(planner.into_pyobject(py)?.into_any()),
            ),
            Question::Reset { simulation } => ("reset", simulation, None),
            Question::Plan {
                simulation,
                observation,
            } => (
                "plan",
                simulation,
                Some(Bound::new(py, *observation)?.into_any()),
            ),
            Question::Drop { simulation } => ("drop", simulation, None),
        }))
    }

    /// Answers the last question of a seat: a trajectory where one was asked for.
    #[pyo3(signature = (seat, plan=None))]
    fn answer(&self, py: Python<'_>, seat: usize, plan: Option<&Bound<'_, Trajectory>>) {
        let plan = plan.map(|plan| plan.get().0.clone());
        py.detach(|| self.relay.answer(seat, Ok(plan)));
    }

    /// Answers the last question of a seat by an error.
    fn fail(&self, py: Python<'_>, seat: usize, text: String) {
        py.detach(|| self.relay.answer(seat, Err(text)));
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // Nobody waits for it any more.
        self.end();
    }
}

/// The error of a resumed run; where one of its planners is in Python, it says how to give it.
fn of_own_planner(request: &Request, error: RunnerError) -> Failure {
    let mut cause = &error;
    while let RunnerError::CannotResume { source, .. } = cause {
        cause = source;
    }
    let RunnerError::Planner(unknown) = cause else {
        return error.into();
    };
    if !request.planners.is_empty() {
        return error.into();
    }
    Failure::argument(format!(
        "a planner of this run is in Python, and the folder holds its name alone; give all planners of the run again: \
         planagent.resume(out, planners=...) ({unknown})"
    ))
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
