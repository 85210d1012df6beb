//! Compares a scenario with the one that comes back from nuPlan's formats.

use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{Point, Polygon, Polyline, Pose, Vector, wrap_angle};
use planagent_world::{Lane, LaneId, LaneMap, RoadblockId, StopLineId, TrackToken};
use std::collections::{BTreeMap, BTreeSet};

/// Maximal change of a coordinate, m.
pub(super) const CLOSE: f64 = 1e-6;

/// A scenario before and after, and the shift of the origin.
pub(super) struct Pair<'a> {
    pub(super) before: &'a Scenario,
    pub(super) after: &'a Scenario,
    /// Point in `after` minus point in `before`.
    pub(super) shift: Vector,
}

impl Pair<'_> {
    fn same_point(&self, a: Point, b: Point) -> bool {
        (a + self.shift - b).norm() < CLOSE
    }

    fn same_points(&self, a: &[Point], b: &[Point]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(&a, &b)| self.same_point(a, b))
    }

    pub(super) fn same_polygon(&self, a: &Polygon, b: &Polygon) -> bool {
        self.same_points(a.ring(), b.ring())
            && a.holes().len() == b.holes().len()
            && a.holes()
                .iter()
                .zip(b.holes())
                .all(|(a, b)| self.same_points(a, b))
    }

    pub(super) fn same_polygons(&self, a: &[Polygon], b: &[Polygon]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| self.same_polygon(a, b))
    }

    pub(super) fn same_line(&self, a: &Polyline, b: &Polyline) -> bool {
        self.same_points(a.vertices(), b.vertices())
    }

    fn same_pose(&self, a: Pose, b: Pose) -> bool {
        self.same_point(a.position(), b.position())
            && wrap_angle(a.heading - b.heading).abs() < 1e-12
    }

    /// The lane of the second map with the same id.
    pub(super) fn twin(&self, lane: &Lane) -> &Lane {
        let id = self.after.map.lane_by_source(lane.source_id);
        &self.after.map[id.unwrap_or_else(|| panic!("lane {} is lost", lane.source_id))]
    }

    /// Every shape and relation of a map that nuPlan can express.
    pub(super) fn check_map(&self) {
        let (before, after) = (&*self.before.map, &*self.after.map);
        assert_eq!(before.lanes().len(), after.lanes().len());
        for lane in before.lanes() {
            self.check_lane(lane);
        }
        assert_eq!(before.roadblocks().len(), after.roadblocks().len());
        let twins: BTreeMap<i64, RoadblockId> = after
            .roadblocks()
            .iter()
            .map(|b| (b.source_id, b.id))
            .collect();
        for block in before.roadblocks() {
            let twin = &after[twins[&block.source_id]];
            assert_eq!(block.kind, twin.kind);
            assert_eq!(lanes(before, &block.lanes), lanes(after, &twin.lanes));
            assert_eq!(
                blocks(before, &block.incoming),
                blocks(after, &twin.incoming)
            );
            assert_eq!(
                blocks(before, &block.outgoing),
                blocks(after, &twin.outgoing)
            );
            self.check_area(&block.areas, &twin.areas);
        }
        assert_eq!(before.stop_lines().len(), after.stop_lines().len());
        for (a, b) in before.stop_lines().iter().zip(after.stop_lines()) {
            assert!(self.same_polygon(&a.polygon, &b.polygon));
            assert_eq!(a.stop_sign, b.stop_sign);
            assert_eq!(lanes(before, &a.lanes), lanes(after, &b.lanes));
        }
        assert!(self.same_polygons(before.intersections(), after.intersections()));
        assert!(self.same_polygons(before.crosswalks(), after.crosswalks()));
        assert!(self.same_polygons(before.road_segments(), after.road_segments()));
        assert!(self.same_polygons(before.generic_drivable(), after.generic_drivable()));
        assert!(self.same_polygons(before.carparks(), after.carparks()));
    }

    fn check_lane(&self, lane: &Lane) {
        let (before, after, twin) = (&*self.before.map, &*self.after.map, self.twin(lane));
        let name = format!("{} lane {}", self.before.id, lane.source_id);
        assert_eq!(lane.kind, twin.kind, "{name}");
        assert!(
            self.same_line(&lane.centerline, &twin.centerline),
            "{name}: centerline"
        );
        assert!(
            self.same_polygon(&lane.polygon, &twin.polygon),
            "{name}: area"
        );
        assert_eq!(
            lanes(before, &lane.incoming),
            lanes(after, &twin.incoming),
            "{name}"
        );
        assert_eq!(
            lanes(before, &lane.outgoing),
            lanes(after, &twin.outgoing),
            "{name}"
        );
        // nuPlan has neighbors among the lanes of a roadblock, not among connectors.
        for (a, b) in [(&lane.left, &twin.left), (&lane.right, &twin.right)] {
            let ids = |map: &LaneMap, list: &[planagent_world::Neighbor]| {
                lanes(map, &list.iter().map(|n| n.lane).collect::<Vec<_>>())
            };
            if lane.is_connector() {
                assert!(b.is_empty(), "{name}");
            } else {
                assert_eq!(ids(before, a), ids(after, b), "{name}");
                assert!(
                    a.iter().zip(b).all(|(a, b)| (a.to_s - b.to_s).abs() < CLOSE
                        && (a.from_s - b.from_s).abs() < CLOSE),
                    "{name}"
                );
            }
        }
        assert_eq!(
            before[lane.roadblock].source_id, after[twin.roadblock].source_id,
            "{name}"
        );
        assert_eq!(lane.speed_limit, twin.speed_limit, "{name}");
        assert_eq!(lane.has_traffic_lights, twin.has_traffic_lights, "{name}");
        let stops = |lane: &Lane| {
            lane.stop_lines
                .iter()
                .copied()
                .collect::<BTreeSet<StopLineId>>()
        };
        assert_eq!(stops(lane), stops(twin), "{name}");
    }

    /// A single piece is equal; several are joined into the same area.
    fn check_area(&self, a: &[Polygon], b: &[Polygon]) {
        if let ([a], [b]) = (a, b) {
            assert!(self.same_polygon(a, b));
            return;
        }
        let held = |areas: &[Polygon], point: Point| areas.iter().any(|area| area.contains(point));
        let edge = |areas: &[Polygon], point: Point| {
            areas
                .iter()
                .map(|area| area.edge_distance(point))
                .fold(f64::INFINITY, f64::min)
        };
        let (mut inside, mut outside) = (0, 0);
        for area in a {
            let bounds = area.bounds();
            for (i, j) in (0..=24).flat_map(|i| (0..=24).map(move |j| (i, j))) {
                let share = |low: f64, high: f64, k: i32| low + (high - low) * f64::from(k) / 24.0;
                let point = Point::new(
                    share(bounds.min.x, bounds.max.x, i),
                    share(bounds.min.y, bounds.max.y, j),
                );
                if edge(a, point) > 1e-5 {
                    let here = held(a, point);
                    assert_eq!(
                        here,
                        held(b, point + self.shift),
                        "{}: {point}",
                        self.before.id
                    );
                    if here { inside += 1 } else { outside += 1 }
                }
            }
        }
        assert!(inside > 0 && outside > 0);
    }

    /// Every frame with its ego, objects and lights, and the route.
    pub(super) fn check_frames(&self) {
        let (before, after) = (self.before, self.after);
        assert_eq!(
            (before.start, before.frames.len()),
            (after.start, after.frames.len()),
            "{}",
            before.id
        );
        let mut tracks: BTreeMap<TrackToken, TrackToken> = BTreeMap::new();
        for (a, b) in before.frames.iter().zip(&after.frames) {
            self.check_frame(a, b, &mut tracks);
        }
        // Either the log goes on after the end, with all future states first, or it ends there.
        assert!(
            after.future.is_empty() || before.future.len() <= after.future.len(),
            "{}",
            before.id
        );
        for (a, b) in before.future.iter().zip(&after.future) {
            assert!(
                a.time_us == b.time_us && self.same_pose(a.rear_axle, b.rear_axle),
                "{}",
                before.id
            );
        }
        assert_eq!(
            tracks.values().collect::<BTreeSet<_>>().len(),
            tracks.len(),
            "two tracks became one"
        );
        match (before.route.goal, after.route.goal) {
            (Some(a), Some(b)) => assert!(self.same_pose(a, b)),
            (a, b) => assert_eq!(a, b),
        }
    }

    fn check_frame(&self, a: &Frame, b: &Frame, tracks: &mut BTreeMap<TrackToken, TrackToken>) {
        assert_eq!(a.ego.time_us, b.ego.time_us);
        assert!(self.same_pose(a.ego.rear_axle, b.ego.rear_axle));
        assert_eq!(
            (a.ego.velocity, a.ego.acceleration),
            (b.ego.velocity, b.ego.acceleration)
        );
        assert_eq!(
            a.objects.len(),
            b.objects.len(),
            "{} at {}",
            self.before.id,
            a.ego.time_us
        );
        for (a, b) in a.objects.iter().zip(b.objects.iter()) {
            assert_eq!(*tracks.entry(a.token).or_insert(b.token), b.token);
            assert_eq!(
                (a.kind, a.shape.length, a.shape.width),
                (b.kind, b.shape.length, b.shape.width)
            );
            assert!(self.same_pose(a.shape.center, b.shape.center));
            assert_eq!(a.velocity, b.velocity);
        }
    }
}

pub(super) fn lanes(map: &LaneMap, ids: &[LaneId]) -> BTreeSet<i64> {
    ids.iter().map(|&id| map[id].source_id).collect()
}

pub(super) fn blocks(map: &LaneMap, ids: &[RoadblockId]) -> BTreeSet<i64> {
    ids.iter().map(|&id| map[id].source_id).collect()
}
