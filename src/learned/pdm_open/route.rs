//! The path that PDM's learned planners follow (`tuplan_garage` `abstract_pdm_planner.py`).

use planagent_score::pdm::{PdmPath, centerline_poses, corrected_route, current_lane, lane_chain};
use planagent_world::geometry::GeometryError;
use planagent_world::{LaneId, RoadblockId, SceneView};

/// The route as it was repaired at the first iteration.
#[derive(Debug, Default)]
pub(super) struct PdmRoute {
    corrected: Option<(Vec<RoadblockId>, Vec<LaneId>)>,
}

impl PdmRoute {
    /// The path from the ego's present lane on; `None` where the route has no lanes.
    pub(super) fn path(&mut self, scene: &SceneView<'_>) -> Result<Option<PdmPath>, GeometryError> {
        let (blocks, lanes) = self.corrected.get_or_insert_with(|| {
            let blocks = corrected_route(scene.map, &scene.route.roadblocks, scene.ego.rear_axle);
            let lanes = blocks
                .iter()
                .flat_map(|&block| scene.map[block].lanes.iter().copied())
                .collect();
            (blocks, lanes)
        });
        let Some(start) = current_lane(scene.map, lanes, scene.ego) else {
            return Ok(None);
        };
        let chain = lane_chain(scene.map, blocks, lanes, start);
        PdmPath::new(&centerline_poses(scene.map, &chain)).map(Some)
    }
}
