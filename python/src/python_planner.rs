//! Planners written in Python, in runs of the library.

use crate::observation::Observation;
use crate::trajectory::Trajectory;
use planagent::planning::{
    PlannerEntry, PlannerError, PlannerInitialization, PlannerInput, PlannerName, PlannerNeeds,
};
use planagent::road::LaneMap;
use planagent::{Planner, Scene, Trajectory as Planned};
use planagent_agent::planner::{check_plan, kept};
use pyo3::prelude::*;
use pyo3::types::PyTraceback;
use std::sync::Arc;

/// An exception of Python as the cause of a failed simulation: its type, its text, and where it was
/// raised.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct PythonError(String);

/// The last file and line of a traceback.
fn place(traceback: &Bound<'_, PyTraceback>) -> PyResult<String> {
    let mut last = traceback.clone().into_any();
    while let Ok(next) = last.getattr("tb_next")
        && !next.is_none()
    {
        last = next;
    }
    let code = last.getattr("tb_frame")?.getattr("f_code")?;
    Ok(format!(
        "{}, line {}",
        code.getattr("co_filename")?,
        last.getattr("tb_lineno")?
    ))
}

fn failed(py: Python<'_>, error: &PyErr) -> PlannerError {
    let at = error
        .traceback(py)
        .and_then(|traceback| place(&traceback).ok());
    let text = at.map_or_else(|| error.to_string(), |at| format!("{error} ({at})"));
    PlannerError::Failed {
        doing: "planning in Python",
        source: Box::new(PythonError(text)),
    }
}

/// A planner of Python in one simulation.
struct PythonPlanner {
    name: PlannerName,
    /// What `planagent._planners.bound` made for this simulation.
    bound: Py<PyAny>,
    map: Option<Arc<LaneMap>>,
    start_us: Option<i64>,
}

impl Planner for PythonPlanner {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.map = Some(Arc::clone(initialization.map));
        self.start_us = None;
        Python::attach(|py| {
            let reset = self.bound.call_method0(py, "reset");
            reset.map(drop).map_err(|error| failed(py, &error))
        })
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Planned, PlannerError> {
        let map = self.map.clone().ok_or(PlannerError::NotInitialized)?;
        let start_us = *self.start_us.get_or_insert(input.scene.ego.time_us);
        let observation =
            Observation::new(Scene::of_view(map, &input.scene), input.iteration, start_us);
        Python::attach(|py| {
            let plan = |observation| {
                let planned = self
                    .bound
                    .call_method1(py, "plan", (Py::new(py, observation)?,))?;
                let planned = planned.into_bound(py).cast_into::<Trajectory>()?;
                PyResult::Ok(planned.get().0.clone())
            };
            let plan = plan(observation).map_err(|error| failed(py, &error))?;
            check_plan(&plan, input.scene.ego).map_err(|jump| PlannerError::Failed {
                doing: "planning in Python",
                source: Box::new(jump),
            })?;
            Ok(plan)
        })
    }
}

/// The entry of a planner of Python in the registry; `make` gives one for each simulation.
pub(crate) fn entry(name: String, make: Py<PyAny>) -> PlannerEntry {
    let name = PlannerName::new(kept(name));
    let make = Arc::new(make);
    PlannerEntry::new(
        name,
        "a planner in Python",
        PlannerNeeds::Nothing,
        move |_| {
            Python::attach(|py| {
                let bound = make.call0(py).map_err(|error| failed(py, &error))?;
                let planner: Box<dyn Planner> = Box::new(PythonPlanner {
                    name,
                    bound,
                    map: None,
                    start_us: None,
                });
                Ok(planner)
            })
        },
    )
}
