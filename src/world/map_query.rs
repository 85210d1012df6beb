//! Questions to the lane map: what lies here, what is near, where does the road go.

use super::{Lane, LaneId, LaneKind, LaneMap, RoadblockId};
use crate::geometry::{Bounds, OrientedBox, Point, Polygon, Pose, SpatialIndex, wrap_angle};

fn any_holds(index: &SpatialIndex, polygons: &[Polygon], point: Point) -> bool {
    index.at(point).into_iter().any(|i| polygons[i].contains(point))
}

impl LaneMap {
    /// Lanes and connectors whose polygon holds the point, in map order.
    pub fn lanes_at(&self, point: Point) -> Vec<LaneId> {
        let found = self.lane_index.at(point).into_iter().map(|i| &self.parts.lanes[i]);
        found.filter(|lane| lane.polygon.contains(point)).map(|lane| lane.id).collect()
    }

    /// Those of one kind whose polygon holds the point, in map order.
    pub fn lanes_of_kind_at(&self, point: Point, kind: LaneKind) -> Vec<LaneId> {
        self.lanes_at(point).into_iter().filter(|&id| self[id].kind == kind).collect()
    }

    /// Lanes and connectors whose polygon meets the square patch of `half_size` metres around `point`, in map order.
    pub fn lanes_near(&self, point: Point, half_size: f64) -> Vec<LaneId> {
        let patch = Bounds::square(point, half_size);
        let side = 2.0 * half_size;
        let square = OrientedBox::new(Pose::at(point, 0.0), side, side);
        let found = self.lane_index.within(&patch).into_iter().map(|i| &self.parts.lanes[i]);
        found.filter(|lane| lane.polygon.meets_box(&square)).map(|lane| lane.id).collect()
    }

    /// Roadblocks (and connectors) whose area holds the point, in map order.
    pub fn roadblocks_at(&self, point: Point) -> Vec<RoadblockId> {
        let mut found: Vec<RoadblockId> = self
            .block_index
            .at(point)
            .into_iter()
            .map(|i| self.block_areas[i])
            .filter(|&(block, area)| self[block].areas[area].contains(point))
            .map(|(block, _)| block)
            .collect();
        found.dedup();
        found
    }

    /// Whether the area of a roadblock holds the point.
    pub fn roadblock_holds(&self, block: RoadblockId, point: Point) -> bool {
        self[block].areas.iter().any(|area| area.contains(point))
    }

    /// Whether the point lies in an intersection.
    pub fn in_intersection(&self, point: Point) -> bool {
        any_holds(&self.intersection_index, &self.parts.intersections, point)
    }

    /// Whether the point lies on a crosswalk.
    pub fn on_crosswalk(&self, point: Point) -> bool {
        any_holds(&self.crosswalk_index, &self.parts.crosswalks, point)
    }

    /// Whether the point lies in nuPlan's drivable area: road segments, intersections, generic drivable areas, car parks.
    pub fn is_drivable(&self, point: Point) -> bool {
        any_holds(&self.road_index, &self.parts.road_segments, point)
            || any_holds(&self.intersection_index, &self.parts.intersections, point)
            || any_holds(&self.generic_index, &self.parts.generic_drivable, point)
            || any_holds(&self.carpark_index, &self.parts.carparks, point)
    }

    /// Distance from a point to the drivable area, metres, searched up to `reach`; `None` when there is none so near.
    pub fn distance_to_drivable(&self, point: Point, reach: f64) -> Option<f64> {
        let patch = Bounds::square(point, reach);
        let layers = [
            (&self.road_index, &self.parts.road_segments),
            (&self.intersection_index, &self.parts.intersections),
            (&self.generic_index, &self.parts.generic_drivable),
            (&self.carpark_index, &self.parts.carparks),
        ];
        let areas = layers
            .into_iter()
            .flat_map(|(index, polygons)| index.within(&patch).into_iter().map(|i| polygons[i].distance_to(point)));
        let nearest = areas.fold(f64::INFINITY, f64::min);
        (nearest <= reach).then_some(nearest)
    }

    /// Crosswalks that meet the square patch, in map order.
    pub fn crosswalks_near(&self, point: Point, half_size: f64) -> impl Iterator<Item = &Polygon> {
        self.crosswalk_index.within(&Bounds::square(point, half_size)).into_iter().map(|i| &self.parts.crosswalks[i])
    }

    /// The lane or connector that a vehicle at `pose` is driving on: of those that hold the point, the one that fits best by
    /// heading and distance to its centreline; where none holds it, the one with the nearest polygon within `reach` metres.
    pub fn lane_of(&self, pose: Pose, reach: f64) -> Option<LaneId> {
        let point = pose.position();
        let holding = self.lanes_at(point);
        if !holding.is_empty() {
            return self.best_fit(&holding, pose);
        }
        let near: Vec<LaneId> = self
            .lanes_near(point, reach)
            .into_iter()
            .filter(|&id| self[id].polygon.distance_to(point) <= reach)
            .collect();
        self.best_fit(&near, pose)
    }

    /// Of several lanes the one that fits a pose best.
    pub fn best_fit(&self, lanes: &[LaneId], pose: Pose) -> Option<LaneId> {
        let misfit = |&id: &LaneId| misfit(&self[id], pose);
        lanes.iter().copied().min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }
}

/// How badly a lane fits a pose: metres beside the centreline plus metres for the turn away from it.
fn misfit(lane: &Lane, pose: Pose) -> f64 {
    /// A radian of heading error weighs as much as this many metres beside the line: a lane width.
    const METRES_PER_RADIAN: f64 = 3.5;
    let foot = lane.centerline.project(pose.position());
    foot.distance + METRES_PER_RADIAN * wrap_angle(foot.heading - pose.heading).abs()
}
