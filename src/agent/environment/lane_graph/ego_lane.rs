//! The lane that holds the ego.

use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneId, SceneView};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3};

/// An ego this near to a lane counts as on it, meters.
pub(crate) const OFF_ROAD_REACH: f64 = 3.0;
/// A route lane that turns away from the ego's heading by more than this does not hold the ego,
/// radians.
const ROUTE_LANE_TURN: f64 = FRAC_PI_3;

/// The best-fitting lane of the route under the ego, else the best-fitting lane of the map.
pub(super) fn ego_lane(scene: &SceneView<'_>) -> Option<LaneId> {
    let (map, pose) = (scene.map, scene.ego.center());
    let turn = |lane: LaneId| {
        wrap_angle(map[lane].centerline.project(pose.position()).heading - pose.heading).abs()
    };
    let fits =
        |&lane: &LaneId| scene.route.contains(map[lane].roadblock) && turn(lane) <= ROUTE_LANE_TURN;
    let on_route: Vec<LaneId> = map
        .lanes_at(pose.position())
        .into_iter()
        .filter(fits)
        .collect();
    let found = map
        .best_fit(&on_route, pose)
        .or_else(|| map.lane_of(pose, OFF_ROAD_REACH))?;
    if turn(found) <= FRAC_PI_2 {
        return Some(found);
    }
    // An ego that passes something on a lane against traffic belongs to the lane that it left.
    let near = map
        .lanes_near(pose.position(), OFF_ROAD_REACH)
        .into_iter()
        .filter(fits);
    let left: Vec<LaneId> = near
        .filter(|&lane| map[lane].polygon.distance_to(pose.position()) <= OFF_ROAD_REACH)
        .collect();
    map.best_fit(&left, pose).or(Some(found))
}
