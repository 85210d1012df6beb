//! The ego's roadblock and its lane of the route (`tuplan_garage` `route_utils.py`,
//! `abstract_pdm_planner.py`).

use planagent_world::geometry::{Point, Pose, wrap_angle};
use planagent_world::{EgoState, Lane, LaneId, LaneKind, LaneMap, Roadblock, RoadblockId};
use std::f64::consts::FRAC_PI_4;

/// Half size of the square around the rear axle in which roadblocks are searched, meters.
const SEARCH_RADIUS: f64 = 1.0;
/// Heading errors below this qualify a lane, radians.
const MAX_HEADING_ERROR: f64 = FRAC_PI_4;
/// Distances to the nearest vertex of its baseline below this qualify a lane, meters.
const MAX_DISPLACEMENT: f64 = 3.0;

/// Distance of a pose from the nearest vertex of a lane's baseline.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Misfit {
    /// Meters.
    displacement: f64,
    /// Radians in [0, π].
    heading_error: f64,
}

impl Misfit {
    fn new(lane: &Lane, pose: Pose) -> Self {
        let poses = lane.centerline.vertex_poses();
        let distances = poses
            .iter()
            .map(|vertex| (vertex.distance(&pose), vertex.heading));
        let (displacement, heading) = distances
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, 0.0));
        Self {
            displacement,
            heading_error: wrap_angle(heading - pose.heading).abs(),
        }
    }

    fn qualifies(self) -> bool {
        self.heading_error < MAX_HEADING_ERROR && self.displacement < MAX_DISPLACEMENT
    }
}

/// The roadblock under the ego, and the candidates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StartingBlock {
    /// The chosen roadblock.
    pub block: RoadblockId,
    /// The chosen one and its rivals of the same rank: qualifying ones on the route, else
    /// qualifying ones off it, else all. One that qualifies by several lanes stands several times.
    pub candidates: Vec<RoadblockId>,
}

/// The roadblock that `rear_axle` is on: of those within 1 m (else the nearest of either kind) one
/// with a lane within 3 m and 45°, on the route if possible, by the distance to the nearest vertex
/// of a baseline. `None` when no roadblock of the map has lanes.
pub fn starting_block(
    map: &LaneMap,
    route: &[RoadblockId],
    rear_axle: Pose,
) -> Option<StartingBlock> {
    let (mut on_route, mut off_route, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for block in blocks_around(map, rear_axle.position()) {
        let misfits: Vec<Misfit> = block
            .lanes
            .iter()
            .map(|&lane| Misfit::new(&map[lane], rear_axle))
            .collect();
        let ranked = if route.contains(&block.id) {
            &mut on_route
        } else {
            &mut off_route
        };
        ranked.extend(
            misfits
                .iter()
                .filter(|m| m.qualifies())
                .map(|m| (block.id, m.displacement)),
        );
        all.extend(
            misfits
                .iter()
                .map(|m| m.displacement)
                .min_by(f64::total_cmp)
                .map(|least| (block.id, least)),
        );
    }
    // Three lists and not one order: all of the list that decides are candidates for the route's
    // repair.
    let ranked = [on_route, off_route, all]
        .into_iter()
        .find(|list| !list.is_empty())?;
    let &(block, _) = ranked.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(StartingBlock {
        block,
        candidates: ranked.into_iter().map(|(block, _)| block).collect(),
    })
}

/// Roadblocks, then roadblock connectors, that meet the square around a point; where there are
/// none, the nearest of each.
fn blocks_around(map: &LaneMap, point: Point) -> Vec<&Roadblock> {
    let near = map
        .roadblocks_near(point, SEARCH_RADIUS)
        .into_iter()
        .map(|block| &map[block]);
    let mut near: Vec<_> = near.filter(|block| !block.lanes.is_empty()).collect();
    if !near.is_empty() {
        near.sort_by_key(|block| block.kind == LaneKind::Connector);
        return near;
    }
    let of_kind = |kind| {
        map.roadblocks()
            .iter()
            .filter(move |b| b.kind == kind && !b.lanes.is_empty())
    };
    let distance = |block: &&Roadblock| {
        block
            .areas
            .iter()
            .map(|area| area.distance_to(point))
            .min_by(f64::total_cmp)
            .unwrap_or(f64::INFINITY)
    };
    let nearest = |kind| of_kind(kind).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest(LaneKind::Lane)
        .into_iter()
        .chain(nearest(LaneKind::Connector))
        .collect()
}

/// The lane that the ego is on: of the lanes of the route under the rear axle the one that fits
/// best by heading; without one, the first of the route under the center of the box; without that,
/// the nearest to the box. `route_lanes` are the lanes of the route in its order; `None` when there
/// are none.
pub fn current_lane(map: &LaneMap, route_lanes: &[LaneId], ego: &EgoState) -> Option<LaneId> {
    let rear_axle = ego.rear_axle;
    let under = map
        .lanes_at(rear_axle.position())
        .into_iter()
        .filter(|lane| route_lanes.contains(lane));
    let misfits = under.map(|lane| (lane, Misfit::new(&map[lane], rear_axle).heading_error));
    if let Some((lane, _)) = misfits.min_by(|a, b| a.1.total_cmp(&b.1)) {
        return Some(lane);
    }
    let footprint = ego.footprint();
    let center = footprint.center.position();
    let holding = route_lanes
        .iter()
        .copied()
        .find(|&lane| map[lane].polygon.contains(center));
    let distance = |lane: &LaneId| map[*lane].polygon.distance_to_box(&footprint);
    holding.or_else(|| {
        route_lanes
            .iter()
            .copied()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    })
}
