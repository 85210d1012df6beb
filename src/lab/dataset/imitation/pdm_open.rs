//! Samples of PDM-Open.

use super::tensors::Columns;
use super::{Moment, futures};
use planagent_learned::pdm_open::PdmFeatures;
use planagent_score::pdm::{PdmPath, centerline_poses, corrected_route, current_lane, lane_chain};
use planagent_world::LaneId;

/// Features and target (16, 3): the poses of the rear axle in its frame now. `None` off every
/// route.
pub(super) fn sample(moment: &Moment<'_>) -> Option<Columns> {
    let scene = &moment.scene;
    // The same steps as in the planner: the network must learn from the path that it will see.
    let blocks = corrected_route(scene.map, &scene.route.roadblocks, scene.ego.rear_axle);
    let lanes: Vec<LaneId> = blocks
        .iter()
        .flat_map(|&block| scene.map[block].lanes.iter().copied())
        .collect();
    let start = current_lane(scene.map, &lanes, scene.ego)?;
    let chain = lane_chain(scene.map, &blocks, &lanes, start);
    let path = PdmPath::new(&centerline_poses(scene.map, &chain)).ok()?;
    let PdmFeatures {
        position,
        velocity,
        acceleration,
        centerline,
    } = PdmFeatures::from_scene(scene, &path).ok()?;
    let target = futures::half_seconds(moment);
    let history = [position.len(), 3];
    Some(
        Columns::default()
            .with("position", &history, position.as_flattened().to_vec())
            .with("velocity", &history, velocity.as_flattened().to_vec())
            .with(
                "acceleration",
                &history,
                acceleration.as_flattened().to_vec(),
            )
            .with(
                "centerline",
                &[centerline.len(), 3],
                centerline.as_flattened().to_vec(),
            )
            .with("target", &[target.len() / 3, 3], target),
    )
}
