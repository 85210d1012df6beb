//! The lane that holds the ego.

use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneId, LaneKind, SceneView};
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
    let of_route = map.best_fit(&on_route, pose);
    let found = of_route.or_else(|| map.lane_of(pose, OFF_ROAD_REACH))?;
    let near: Vec<LaneId> = map
        .lanes_near(pose.position(), OFF_ROAD_REACH)
        .into_iter()
        .filter(fits)
        .collect();
    // An ego that cuts a corner belongs to the lane of the route that it still touches: under it
    // are connectors that lead elsewhere.
    if of_route.is_none() && map[found].kind == LaneKind::Connector {
        let footprint = scene.ego.footprint();
        let touched: Vec<LaneId> = near
            .iter()
            .copied()
            .filter(|&lane| map[lane].polygon.meets_box(&footprint))
            .collect();
        if let Some(lane) = map.best_fit(&touched, pose) {
            return Some(lane);
        }
    }
    if turn(found) <= FRAC_PI_2 {
        return Some(found);
    }
    // An ego that passes something on a lane against traffic belongs to the lane that it left.
    let left: Vec<LaneId> = near
        .into_iter()
        .filter(|&lane| map[lane].polygon.distance_to(pose.position()) <= OFF_ROAD_REACH)
        .collect();
    map.best_fit(&left, pose).or(Some(found))
}
