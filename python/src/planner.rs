//! The planners of the library by name.

use crate::errors::{Failure, Outcome};
use crate::observation::Observation;
use crate::scenario::Scenario;
use crate::settings::{config, model};
use crate::trajectory::Trajectory;
use crate::work::{computed, lock, long, quick};
use planagent::Planner as LibraryPlanner;
use planagent::planning::{
    PlannerInitialization, PlannerInput, PlannerNeeds, PlannerParts, PlanningCall, all_planners,
};
use planagent::road::LaneMap;
use planagent_runs::report::CallRecord;
use planagent_runs::runner::silent;
use planagent_runs::worker::run::{AgentParts, with_causes};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};

/// A planner of the library. It holds the state of one simulation.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Planner {
    name: String,
    state: Arc<Mutex<PlannerState>>,
}

/// A planner and whether it knows its map.
pub(crate) struct PlannerState {
    pub(crate) planner: Box<dyn LibraryPlanner>,
    pub(crate) is_initialized: bool,
    /// The map that it was initialized with by [`Planner::plan`].
    map: Option<Arc<LaneMap>>,
    /// The scenario in the records of planning calls.
    scenario: String,
}

impl Planner {
    pub(crate) fn shared(&self) -> Arc<Mutex<PlannerState>> {
        Arc::clone(&self.state)
    }
}

/// The names of the library's planners with a line about each, and whether it needs a model.
#[pyfunction]
pub(crate) fn planners() -> Vec<(&'static str, &'static str, bool)> {
    let registry = all_planners();
    registry
        .entries()
        .iter()
        .map(|entry| (entry.name.as_str(), entry.summary, entry.needs_model()))
        .collect()
}

/// The parts of planners by settings as JSON; the model is loaded where the planner needs one.
fn parts(name: &str, settings: &str) -> Outcome<AgentParts> {
    let config = config(settings)?;
    let registry = all_planners();
    let entry = registry
        .find(name)
        .map_err(|error| Failure::argument(error.to_string()))?;
    let agent_settings = config.agent_settings();
    if let Some(key) = entry.unsupported(&agent_settings) {
        return Err(Failure::argument(format!(
            "{key} is not supported by {name}; remove one of them"
        )));
    }
    if entry.needs_model() {
        return Ok(model(&config)?.agent_parts(&config, &silent())?);
    }
    Ok(AgentParts {
        settings: agent_settings,
        ..AgentParts::default()
    })
}

#[pymethods]
impl Planner {
    /// A planner for any scene, or as a run makes it for a scenario.
    #[new]
    #[pyo3(signature = (name, settings, scenario=None))]
    fn new(
        py: Python<'_>,
        name: String,
        settings: String,
        scenario: Option<&Bound<'_, Scenario>>,
    ) -> PyResult<Self> {
        let scenario = scenario.map(|scenario| Arc::clone(&scenario.get().opened));
        let word = name.clone();
        let built = move || {
            let parts = parts(&word, &settings)?;
            let registry = all_planners();
            let entry = registry
                .find(&word)
                .map_err(|error| Failure::argument(error.to_string()))?;
            let failed =
                |error: &dyn std::error::Error| Failure::new("PlannerError", with_causes(error));
            let planner = match &scenario {
                Some(scenario) => computed(|| {
                    parts
                        .planner(entry.name, scenario)
                        .map_err(|error| failed(&error))
                })?,
                None if entry.needs == PlannerNeeds::Recording => {
                    return Err(Failure::argument(format!(
                        "{word} needs a scenario, whose recording it replays"
                    )));
                }
                None => {
                    let of_any_scene = PlannerParts {
                        name: entry.name,
                        settings: &parts.settings,
                        model: parts.model.as_ref(),
                        recording: &[],
                        simulation: None,
                        shuffled_bev: None,
                    };
                    entry.build(&of_any_scene)?
                }
            };
            let scenario = scenario.map_or_else(String::new, |scenario| scenario.id.clone());
            Ok(PlannerState {
                planner,
                is_initialized: false,
                map: None,
                scenario,
            })
        };
        let state = long(py, built, &|| ())?;
        Ok(Self {
            name,
            state: Arc::new(Mutex::new(state)),
        })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Discards all state: the next plan begins again.
    fn reset(&self, py: Python<'_>) {
        py.detach(|| {
            let mut state = lock(&self.state);
            (state.map, state.is_initialized) = (None, false);
        });
    }

    /// The trajectory from an observation on. Another map than the last one discards all state.
    fn plan(&self, py: Python<'_>, observation: &Bound<'_, Observation>) -> PyResult<Trajectory> {
        let (scene, iteration) = (
            Arc::clone(&observation.get().scene),
            observation.get().iteration,
        );
        let state = Arc::clone(&self.state);
        let work = move || {
            // Who waits for this agent does so outside the pool.
            let mut state = lock(&state);
            let state = &mut *state;
            computed(move || {
                if !state
                    .map
                    .as_ref()
                    .is_some_and(|map| Arc::ptr_eq(map, &scene.map))
                {
                    state.planner.initialize(&PlannerInitialization {
                        map: &scene.map,
                        route: &scene.route,
                    })?;
                    (state.map, state.is_initialized) = (Some(Arc::clone(&scene.map)), true);
                }
                let input = PlannerInput {
                    iteration,
                    scene: scene.view(),
                };
                Ok(Trajectory(state.planner.compute_trajectory(&input)?))
            })
        };
        long(py, work, &|| ())
    }

    /// The planning calls of an agent since its last reset, each as JSON.
    fn calls(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        quick(py, || {
            let state = lock(&self.state);
            let record = |call: &PlanningCall| {
                let record =
                    CallRecord::from_call(&state.scenario, &self.name, None, call).to_json();
                record
                    .map(|json| json.to_string())
                    .map_err(|error| Failure::panic(error.to_string()))
            };
            state.planner.calls().iter().map(record).collect()
        })
    }
}
