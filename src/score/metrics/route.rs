//! The lanes of a driven path (devkit `route_extractor.py`, `get_route`).

use planagent_world::geometry::{Point, Pose};
use planagent_world::{LaneId, LaneMap};

/// Connectors of the previous sample nearer than this stay assigned where the map offers only other
/// connectors, meters.
const CONNECTOR_REACH: f64 = 5.0;

/// The lane that contains a point, or all connectors that do, or none.
///
/// nuPlan asserts that no two lanes hold a point. Where a derived map breaks that, the lane counts
/// that fits `pose` (the center of the vehicle whose point this is) best by heading and distance.
pub fn lanes_at(map: &LaneMap, point: Point, pose: Pose) -> Vec<LaneId> {
    one_lane_or_connectors(map, map.lanes_at(point), pose)
}

fn one_lane_or_connectors(map: &LaneMap, found: Vec<LaneId>, pose: Pose) -> Vec<LaneId> {
    let (connectors, lanes): (Vec<LaneId>, Vec<LaneId>) =
        found.into_iter().partition(|&id| map[id].is_connector());
    match map.best_fit(&lanes, pose) {
        Some(lane) => vec![lane],
        None => connectors,
    }
}

/// The candidates that hold the point; if none does and there is a single candidate, its successors
/// that do.
pub(super) fn lanes_from(
    map: &LaneMap,
    candidates: &[LaneId],
    point: Point,
    pose: Pose,
) -> Vec<LaneId> {
    let holding = |ids: &[LaneId]| -> Vec<LaneId> {
        ids.iter()
            .copied()
            .filter(|&id| map[id].polygon.contains(point))
            .collect()
    };
    let kept = holding(candidates);
    match candidates {
        [only] if kept.is_empty() => {
            one_lane_or_connectors(map, holding(&map[*only].outgoing), pose)
        }
        _ => kept,
    }
}

/// The lanes (a lane alone, or one or several connectors, or none) at each pose of a path, each
/// sample continuing where the one before it was. Ambiguous connectors are resolved by where the
/// path ends up.
pub fn driven_route(map: &LaneMap, centers: &[Pose]) -> Vec<Vec<LaneId>> {
    let mut route: Vec<Vec<LaneId>> = Vec::with_capacity(centers.len());
    for (i, &pose) in centers.iter().enumerate() {
        let previous = route.last().map_or(&[][..], Vec::as_slice);
        let mut here = if previous.is_empty() {
            Vec::new()
        } else {
            lanes_from(map, previous, pose.position(), pose)
        };
        if here.is_empty() {
            here = lanes_at(map, pose.position(), pose);
            if i > 1
                && let Some(near) = connectors_nearby(map, previous, &here, pose.position())
            {
                here = near;
            }
        }
        route.push(here);
    }
    resolve_backwards(map, &mut route);
    route
}

/// A path that leaves its connector sideways keeps the connectors that it came along while they are
/// near.
fn connectors_nearby(
    map: &LaneMap,
    previous: &[LaneId],
    found: &[LaneId],
    point: Point,
) -> Option<Vec<LaneId>> {
    let from_connector = previous.first().is_some_and(|&id| map[id].is_connector());
    let into_open = match found.first() {
        Some(&id) => map[id].is_connector(),
        None => map.in_intersection(point),
    };
    if !(from_connector && into_open) {
        return None;
    }
    let near: Vec<LaneId> = previous
        .iter()
        .copied()
        .filter(|&id| map[id].polygon.distance_to(point) < CONNECTOR_REACH)
        .collect();
    (!near.is_empty()).then_some(near)
}

/// From the end to the start, narrows several connectors to those that lead to where the path was
/// next.
fn resolve_backwards(map: &LaneMap, route: &mut [Vec<LaneId>]) {
    for i in (0..route.len().saturating_sub(1)).rev() {
        let (head, tail) = route.split_at_mut(i + 1);
        let (Some(here), Some(next)) = (head.last_mut(), tail.first()) else {
            continue;
        };
        if here.len() <= 1 {
            continue;
        }
        let original = here.clone();
        // An empty next entry passes this test too and empties the entry: nuPlan's behavior.
        if original.len() > next.len() && next.iter().all(|id| original.contains(id)) {
            here.clone_from(next);
        }
        if let Some(&lane) = next.first().filter(|&&id| !map[id].is_connector()) {
            let leading: Vec<LaneId> = original
                .iter()
                .copied()
                .filter(|id| map[lane].incoming.contains(id))
                .collect();
            if !leading.is_empty() {
                *here = leading;
            }
        }
    }
}
