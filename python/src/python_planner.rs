//! Planners in Python, in runs of the library.

use crate::observation::Observation;
use crate::relay::{Question, Relay};
use planagent::planning::{
    PlannerEntry, PlannerError, PlannerInitialization, PlannerInput, PlannerName, PlannerNeeds,
};
use planagent::road::LaneMap;
use planagent::{Planner, Scene, Trajectory as Planned};
use planagent_agent::planner::{check_plan, interned};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A planner in Python in one simulation.
struct PythonPlanner {
    name: PlannerName,
    /// Its number among the planners of the run.
    number: usize,
    relay: Arc<Relay>,
    /// The number of the simulation, once Python has made its planner.
    simulation: Option<u64>,
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
        static NEXT: AtomicU64 = AtomicU64::new(0);
        self.map = Some(Arc::clone(initialization.map));
        self.start_us = None;
        let simulation = if let Some(known) = self.simulation {
            known
        } else {
            let simulation = NEXT.fetch_add(1, Ordering::Relaxed);
            self.relay.ask(Question::Make {
                simulation,
                planner: self.number,
            })?;
            *self.simulation.insert(simulation)
        };
        self.relay.ask(Question::Reset { simulation }).map(drop)
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Planned, PlannerError> {
        let (map, simulation) = self
            .map
            .clone()
            .zip(self.simulation)
            .ok_or(PlannerError::NotInitialized)?;
        let start_us = *self.start_us.get_or_insert(input.scene.ego.time_us);
        let observation =
            Observation::new(Scene::of_view(map, &input.scene), input.iteration, start_us);
        let planned = self.relay.ask(Question::Plan {
            simulation,
            observation: Box::new(observation),
        })?;
        let plan = planned.ok_or(PlannerError::NotInitialized)?;
        check_plan(&plan, input.scene.ego).map_err(|jump| PlannerError::Failed {
            doing: "planning in Python",
            source: Box::new(jump),
        })?;
        Ok(plan)
    }
}

impl Drop for PythonPlanner {
    fn drop(&mut self) {
        if let Some(simulation) = self.simulation {
            self.relay.tell_end(simulation);
        }
    }
}

/// The entry of a planner in Python in the registry.
pub(crate) fn entry(name: String, number: usize, relay: Arc<Relay>) -> PlannerEntry {
    let name = PlannerName::new(interned(name));
    PlannerEntry::new(
        name,
        "a planner in Python",
        PlannerNeeds::Nothing,
        move |_| {
            Ok(Box::new(PythonPlanner {
                name,
                number,
                relay: Arc::clone(&relay),
                simulation: None,
                map: None,
                start_us: None,
            }))
        },
    )
}
