//! DTPP as a planner (`MCZhi/DTPP` `planner.py`).

use super::network::{Dtpp, DtppConfig, STEPS};
use super::paths::paths;
use super::tree::{TreeError, scored_tree};
use crate::gameformer::ActorFeatures;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::{STEP_US, Trajectory};
use std::sync::Arc;

/// Half side of the square of the map, meters.
const RADIUS: f64 = 80.0;

/// The planners `dtpp` and `dtpp-small`.
pub(crate) fn entries() -> [PlannerEntry; 2] {
    let published = Slot::new("DTPP", |weights| Dtpp::take(weights, DtppConfig::PUBLISHED));
    let small = Slot::new("DTPP (small)", |weights| {
        Dtpp::take(weights, DtppConfig::SMALL)
    });
    [
        ("dtpp", "DTPP, a learned planner", published),
        ("dtpp-small", "DTPP in a small shape", small),
    ]
    .map(|(name, summary, slot)| {
        learned_entry(name, summary, slot, move |network| {
            Box::new(DtppPlanner { name, network })
        })
    })
}

/// DTPP: it plans again at every iteration.
#[derive(Debug)]
struct DtppPlanner {
    name: &'static str,
    network: Arc<Dtpp>,
}

impl Planner for DtppPlanner {
    fn name(&self) -> &'static str {
        self.name
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let inputs = ActorFeatures::from_scene(scene, RADIUS)
            .inputs()
            .map_err(network_failed)?;
        let (paths, limit) = paths(scene);
        let start = [scene.ego.velocity.x as f32, scene.ego.acceleration.x as f32];
        let seed = scene.ego.time_us.unsigned_abs();
        let plan = match scored_tree(&self.network, &inputs, &paths, limit, start, seed) {
            Ok(tree) => tree.best,
            // As upstream, which catches every exception.
            Err(TreeError::NoTrajectory) => vec![[0.0; 3]; STEPS],
            Err(TreeError::Network(error)) => return Err(network_failed(error)),
        };
        prediction::trajectory(&plan, STEP_US, scene)
    }
}
