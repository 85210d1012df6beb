//! The trajectory through waypoints, and on along the lane.

use super::SPACING_STEPS;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{Onward, PlannerError, prolonged, through_waypoints};
use planagent_agent::reasoning::WaypointList;
use planagent_world::geometry::{Polyline, Vector};
use planagent_world::{SceneView, Trajectory};

/// The plan of a list of waypoints. Behind the last one the ego keeps its speed along its lane.
#[derive(Debug, Clone, Default)]
pub(crate) struct WaypointTrack {
    active: Option<Trajectory>,
}

impl WaypointTrack {
    /// The trajectory from now on.
    pub(crate) fn through(
        waypoints: &WaypointList,
        GraphedScene { scene, graph }: GraphedScene<'_>,
    ) -> Result<Trajectory, PlannerError> {
        let places = waypoints
            .0
            .map(|place| Vector::new(place.ahead, -place.right));
        let lanes = lanes(graph);
        let onward = Onward::Along(&lanes);
        Ok(through_waypoints(
            scene.ego,
            &places,
            SPACING_STEPS,
            onward,
        )?)
    }

    /// Makes a trajectory the plan.
    pub(crate) fn adopt(&mut self, trajectory: Trajectory) {
        self.active = Some(trajectory);
    }

    /// Makes the plan reach as far as a new one.
    pub(crate) fn go_on(
        &mut self,
        scene: &SceneView<'_>,
        graph: Option<&LaneGraph>,
    ) -> Result<(), PlannerError> {
        if let Some(active) = &self.active {
            let lanes = graph.map_or_else(Vec::new, lanes);
            let longer = prolonged(active, scene.ego.time_us, Onward::Along(&lanes))?;
            self.active = Some(longer);
        }
        Ok(())
    }

    /// The plan.
    pub(crate) fn trajectory(&self) -> Option<Trajectory> {
        self.active.clone()
    }
}

fn lanes(graph: &LaneGraph) -> Vec<&Polyline> {
    let lanes = graph.centerlines.iter();
    lanes.map(|lane| &lane.path.centerline).collect()
}
