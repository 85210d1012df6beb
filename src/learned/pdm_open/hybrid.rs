//! PDM-Hybrid as a planner (`tuplan_garage` `pdm_hybrid_planner.py`): PDM-Closed, whose trajectory
//! a network corrects from two seconds on.

use super::features::PdmFeatures;
use super::network::{HIDDEN, POSES, PdmNetwork};
use super::route::PdmRoute;
use crate::blocks::Probe;
use crate::frame::relative;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_score::pdm::{DrivableLayers, PdmMemory, ReferencePath, plan};
use planagent_world::geometry::Pose;
use planagent_world::{Trajectory, TrajectoryError};
use std::sync::Arc;

/// Until then PDM-Closed's trajectory is executed as it is, µs from now.
const UNCORRECTED_US: i64 = 2_000_000;
const NAME: &str = "pdm-hybrid";

/// The planner `pdm-hybrid`.
pub(crate) fn entry() -> PlannerEntry {
    let slot = Slot::new("PDM-Offset", |weights| PdmNetwork::offset(weights, HIDDEN));
    learned_entry(
        NAME,
        "PDM-Hybrid, PDM-Closed with a learned correction",
        slot,
        |network| {
            Box::new(PdmHybrid {
                network,
                memory: PdmMemory::default(),
                route: PdmRoute::default(),
            })
        },
    )
}

/// PDM-Hybrid.
#[derive(Debug)]
struct PdmHybrid {
    network: Arc<PdmNetwork>,
    memory: PdmMemory,
    route: PdmRoute,
}

impl Planner for PdmHybrid {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        (self.memory, self.route) = Default::default();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let closed = plan(&mut self.memory, scene)?.trajectory;
        let path = self.route.path(scene)?.ok_or(PlannerError::EmptyRoute)?;
        let features =
            PdmFeatures::from_scene(scene, &path).map_err(|source| PlannerError::Failed {
                doing: "filtering the history",
                source: Box::new(source),
            })?;
        let sampled = sampled(&closed, scene.ego.rear_axle, scene.ego.time_us)?;
        let inputs = features.inputs_with(&sampled).map_err(network_failed)?;
        let corrected = self
            .network
            .forward(&inputs, &Probe::off())
            .map_err(network_failed)?;
        let corrected = prediction::trajectory(
            &prediction::poses(&corrected).map_err(network_failed)?,
            prediction::HALF_SECOND_US,
            scene,
        )?;
        Ok(fused(&closed, &corrected, scene.ego.time_us)?)
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.memory
            .reference_path
            .as_ref()
            .map(ReferencePath::layers)
    }
}

/// The poses of a trajectory every half second, in the frame of the rear axle.
///
/// # Errors
/// When it is shorter than eight seconds.
pub fn sampled(
    closed: &Trajectory,
    here: Pose,
    now_us: i64,
) -> Result<[[f32; 3]; POSES], TrajectoryError> {
    let mut poses = [[0.0; 3]; POSES];
    for (time_us, pose) in (1..)
        .map(|i| now_us + i * prediction::HALF_SECOND_US)
        .zip(&mut poses)
    {
        *pose = relative(here, closed.at(time_us)?.rear_axle);
    }
    Ok(poses)
}

/// The first two seconds of one trajectory and the rest of another.
///
/// # Errors
/// When the two do not follow each other.
pub fn fused(
    closed: &Trajectory,
    corrected: &Trajectory,
    now_us: i64,
) -> Result<Trajectory, TrajectoryError> {
    let until = now_us + UNCORRECTED_US;
    let near = closed
        .states()
        .iter()
        .filter(|state| state.time_us <= until);
    let far = corrected
        .states()
        .iter()
        .filter(|state| state.time_us > until);
    Trajectory::new(near.chain(far).copied().collect())
}
