//! Queries of the lane map.

use super::{Lane, LaneId, LaneKind, LaneMap, RoadblockId, StopLineId};
use crate::geometry::{Bounds, OrientedBox, Point, Polygon, Pose, SpatialIndex, wrap_angle};

fn any_holds(index: &SpatialIndex, polygons: &[Polygon], point: Point) -> bool {
    index
        .at(point)
        .into_iter()
        .any(|i| polygons[i].contains(point))
}

impl LaneMap {
    /// Lanes and connectors whose polygon holds the point, in map order.
    pub fn lanes_at(&self, point: Point) -> Vec<LaneId> {
        let found = self
            .lane_index
            .at(point)
            .into_iter()
            .map(|i| &self.parts.lanes[i]);
        found
            .filter(|lane| lane.polygon.contains(point))
            .map(|lane| lane.id)
            .collect()
    }

    /// Those of one kind whose polygon holds the point, in map order.
    pub fn lanes_of_kind_at(&self, point: Point, kind: LaneKind) -> Vec<LaneId> {
        self.lanes_at(point)
            .into_iter()
            .filter(|&id| self[id].kind == kind)
            .collect()
    }

    /// Lanes and connectors whose polygon meets the square patch of `half_size` meters around
    /// `point`, in map order.
    pub fn lanes_near(&self, point: Point, half_size: f64) -> Vec<LaneId> {
        let patch = Bounds::square(point, half_size);
        let side = 2.0 * half_size;
        let square = OrientedBox::new(Pose::at(point, 0.0), side, side);
        let found = self
            .lane_index
            .within(&patch)
            .into_iter()
            .map(|i| &self.parts.lanes[i]);
        found
            .filter(|lane| lane.polygon.meets_box(&square))
            .map(|lane| lane.id)
            .collect()
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

    /// Roadblocks (and connectors) whose area meets the square patch of `half_size` meters around
    /// `point`, in map order.
    pub fn roadblocks_near(&self, point: Point, half_size: f64) -> Vec<RoadblockId> {
        let side = 2.0 * half_size;
        let square = OrientedBox::new(Pose::at(point, 0.0), side, side);
        let areas = self
            .block_index
            .within(&Bounds::square(point, half_size))
            .into_iter()
            .map(|i| self.block_areas[i]);
        let met = areas.filter(|&(block, area)| self[block].areas[area].meets_box(&square));
        let mut found: Vec<RoadblockId> = met.map(|(block, _)| block).collect();
        found.dedup();
        found
    }

    /// Whether the area of a roadblock holds the point.
    pub fn roadblock_holds(&self, block: RoadblockId, point: Point) -> bool {
        self[block].areas.iter().any(|area| area.contains(point))
    }

    /// Intersections whose bounds meet the given ones, in map order.
    pub fn intersections_within(&self, bounds: &Bounds) -> impl Iterator<Item = &Polygon> {
        self.intersection_index
            .within(bounds)
            .into_iter()
            .map(|i| &self.parts.intersections[i])
    }

    /// Car parks whose bounds meet the given ones, in map order.
    pub fn carparks_within(&self, bounds: &Bounds) -> impl Iterator<Item = &Polygon> {
        self.carpark_index
            .within(bounds)
            .into_iter()
            .map(|i| &self.parts.carparks[i])
    }

    /// The stop line nearest to a point, of equally near ones the first; `None` when the map has
    /// none.
    pub fn nearest_stop_line(&self, point: Point) -> Option<StopLineId> {
        let mut best: Option<(f64, usize)> = None;
        for place in self.stop_index.nearest(point) {
            let polygon = &self.parts.stop_lines[place].polygon;
            let distance = polygon.distance_to(point);
            match best {
                // The shapes come by growing distance of their bounds, which is never more than
                // their own.
                Some((least, _)) if polygon.bounds().distance_to(point) > least => break,
                Some(known) if (distance, place) >= known => {}
                _ => best = Some((distance, place)),
            }
        }
        best.map(|(_, place)| StopLineId(place as u32))
    }

    /// Whether the point lies in an intersection.
    pub fn in_intersection(&self, point: Point) -> bool {
        any_holds(&self.intersection_index, &self.parts.intersections, point)
    }

    /// Whether the point lies on a crosswalk.
    pub fn on_crosswalk(&self, point: Point) -> bool {
        any_holds(&self.crosswalk_index, &self.parts.crosswalks, point)
    }

    /// Whether the point lies in nuPlan's drivable area: road segments, intersections, generic
    /// drivable areas, car parks.
    pub fn is_drivable(&self, point: Point) -> bool {
        any_holds(&self.road_index, &self.parts.road_segments, point)
            || any_holds(&self.intersection_index, &self.parts.intersections, point)
            || any_holds(&self.generic_index, &self.parts.generic_drivable, point)
            || any_holds(&self.carpark_index, &self.parts.carparks, point)
    }

    /// Distance from a point to the drivable area, meters, searched up to `reach`; `None` when
    /// there is none so near.
    pub fn distance_to_drivable(&self, point: Point, reach: f64) -> Option<f64> {
        let patch = Bounds::square(point, reach);
        let layers = [
            (&self.road_index, &self.parts.road_segments),
            (&self.intersection_index, &self.parts.intersections),
            (&self.generic_index, &self.parts.generic_drivable),
            (&self.carpark_index, &self.parts.carparks),
        ];
        let areas = layers.into_iter().flat_map(|(index, polygons)| {
            index
                .within(&patch)
                .into_iter()
                .map(|i| polygons[i].distance_to(point))
        });
        let nearest = areas.fold(f64::INFINITY, f64::min);
        (nearest <= reach).then_some(nearest)
    }

    /// Crosswalks that meet the square patch, in map order.
    pub fn crosswalks_near(&self, point: Point, half_size: f64) -> impl Iterator<Item = &Polygon> {
        self.crosswalk_index
            .within(&Bounds::square(point, half_size))
            .into_iter()
            .map(|i| &self.parts.crosswalks[i])
    }

    /// The lane or connector that a vehicle at `pose` is driving on: of those that hold the point,
    /// the one that fits best by heading and distance to its centerline; where none holds it, the
    /// one with the nearest polygon within `reach` meters.
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

    /// The lane so many lanes to the left of one (negative: to the right) beside a point, and the
    /// nearest pose on its centerline.
    pub fn beside(&self, lane: LaneId, point: Point, lanes: i32) -> Option<(LaneId, Pose)> {
        let (mut lane, mut at) = (lane, point);
        for _ in 0..lanes.abs() {
            let s = self[lane].centerline.project(at).s;
            lane = if lanes > 0 {
                self[lane].left_at(s)
            } else {
                self[lane].right_at(s)
            }?;
            at = self[lane].centerline.project(at).point;
        }
        let foot = self[lane].centerline.project(at);
        Some((lane, Pose::at(foot.point, foot.heading)))
    }

    /// Of several lanes the one that fits a pose best.
    pub fn best_fit(&self, lanes: &[LaneId], pose: Pose) -> Option<LaneId> {
        let misfit = |&id: &LaneId| misfit(&self[id], pose);
        lanes
            .iter()
            .copied()
            .min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }
}

/// Misfit of a lane and a pose, meters: distance to the centerline plus weighted heading error.
fn misfit(lane: &Lane, pose: Pose) -> f64 {
    /// A radian of heading error weighs as much as this many meters beside the line: a lane width.
    const METERS_PER_RADIAN: f64 = 3.5;
    let foot = lane.centerline.project(pose.position());
    foot.distance + METERS_PER_RADIAN * wrap_angle(foot.heading - pose.heading).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MapParts, StopLine};
    use proptest::prelude::*;

    /// Squares as stop lines, car parks and intersections of a map with one lane far away.
    fn map(squares: &[(f64, f64, f64)]) -> LaneMap {
        let polygons: Vec<Polygon> = squares
            .iter()
            .map(|&(x, y, heading)| {
                OrientedBox::new(Pose::new(x, y, heading), 8.0, 1.0).to_polygon()
            })
            .collect();
        let line =
            crate::geometry::Polyline::new([Point::new(1e4, 0.0), Point::new(1e4, 9.0)]).unwrap();
        let lane = Lane {
            id: LaneId(0),
            source_id: 0,
            kind: LaneKind::Lane,
            polygon: OrientedBox::new(line.pose_at(4.0), 8.0, 4.0).to_polygon(),
            centerline: line,
            incoming: vec![],
            outgoing: vec![],
            left: vec![],
            right: vec![],
            roadblock: RoadblockId(0),
            speed_limit: None,
            has_traffic_lights: false,
            stop_lines: vec![],
        };
        let block = crate::Roadblock {
            id: RoadblockId(0),
            source_id: 0,
            kind: LaneKind::Lane,
            lanes: vec![LaneId(0)],
            areas: polygons.clone(),
            incoming: vec![],
            outgoing: vec![],
        };
        let stop = |polygon: &Polygon| StopLine {
            polygon: polygon.clone(),
            lanes: vec![],
            stop_sign: false,
        };
        LaneMap::new(MapParts {
            lanes: vec![lane],
            roadblocks: vec![block],
            stop_lines: polygons.iter().map(stop).collect(),
            intersections: polygons.clone(),
            carparks: polygons,
            ..MapParts::default()
        })
        .unwrap()
    }

    proptest! {
        #[test]
        fn queries_answer_like_plain_scans(
            squares in prop::collection::vec((-60.0..60.0f64, -60.0..60.0f64, -3.0..3.0f64), 0..30),
            x in -60.0..60.0f64, y in -60.0..60.0f64, r in 0.1..30.0f64,
        ) {
            let map = map(&squares);
            let point = Point::new(x, y);
            let distance = |i: usize| map.stop_lines()[i].polygon.distance_to(point);
            let nearest = (0..squares.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            prop_assert_eq!(map.nearest_stop_line(point).map(StopLineId::index), nearest);
            let square = OrientedBox::new(Pose::at(point, 0.0), 2.0 * r, 2.0 * r);
            let meets = map.intersections().iter().any(|area| area.meets_box(&square));
            prop_assert_eq!(!map.roadblocks_near(point, r).is_empty(), meets);
            let patch = Bounds::square(point, r);
            let plain: Vec<&Polygon> = map.carparks().iter().filter(|area| area.bounds().overlaps(&patch)).collect();
            prop_assert_eq!(map.carparks_within(&patch).collect::<Vec<_>>(), plain.clone());
            prop_assert_eq!(map.intersections_within(&patch).collect::<Vec<_>>(), plain);
        }
    }
}
