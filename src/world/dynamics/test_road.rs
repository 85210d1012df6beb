//! Hand-made roads for tests.
#![allow(
    dead_code,
    reason = "each crate has its own copy and uses a part of it"
)]

use planagent_world::geometry::{OrientedBox, Point, Polygon, Polyline, Pose, Vector};
use planagent_world::{
    EgoState, Lane, LaneId, LaneKind, LaneMap, MapParts, ObjectKind, Roadblock, RoadblockId, Route,
    StopLine, StopLineId, TrackToken, TrackedObject,
};

/// Width of every lane, meters.
pub(crate) const LANE_WIDTH: f64 = 3.6;

/// A piece of the road: a lane, a connector, or a connector with a traffic light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Stretch {
    Lane(f64),
    Connector(f64),
    Signal(f64),
}

fn strip(from: f64, to: f64) -> Polygon {
    let half = LANE_WIDTH / 2.0;
    Polygon::new(
        [(from, -half), (to, -half), (to, half), (from, half)].map(|(x, y)| Point::new(x, y)),
    )
    .unwrap()
}

/// A road along the x axis from x = 0, one lane id a stretch, in a roadblock of its own; a signal
/// has a stop line 1 m before it. Lanes have the speed limit.
pub(crate) fn straight_road(stretches: &[Stretch], speed_limit: Option<f64>) -> LaneMap {
    let mut parts = MapParts {
        name: "straight".into(),
        ..MapParts::default()
    };
    let mut from = 0.0;
    for (i, &stretch) in stretches.iter().enumerate() {
        let id = LaneId(i as u32);
        let (Stretch::Lane(length) | Stretch::Connector(length) | Stretch::Signal(length)) =
            stretch;
        let kind = if matches!(stretch, Stretch::Lane(_)) {
            LaneKind::Lane
        } else {
            LaneKind::Connector
        };
        let polygon = strip(from, from + length);
        let before: Vec<u32> = i.checked_sub(1).map(|b| b as u32).into_iter().collect();
        let after: Vec<u32> = (i + 1 < stretches.len())
            .then_some(i as u32 + 1)
            .into_iter()
            .collect();
        let mut stop_lines = Vec::new();
        if matches!(stretch, Stretch::Signal(_)) {
            stop_lines.push(StopLineId(parts.stop_lines.len() as u32));
            let polygon = strip(from - 1.0, from - 0.5);
            parts.stop_lines.push(StopLine {
                polygon,
                lanes: vec![id],
                stop_sign: false,
            });
        }
        if kind == LaneKind::Connector {
            parts.intersections.push(polygon.clone());
        }
        let vertices = (0..=length as usize).map(|m| Point::new(from + m as f64, 0.0));
        parts.lanes.push(Lane {
            id,
            source_id: i as i64,
            kind,
            centerline: Polyline::new(vertices.chain([Point::new(from + length, 0.0)])).unwrap(),
            polygon: polygon.clone(),
            incoming: before.iter().copied().map(LaneId).collect(),
            outgoing: after.iter().copied().map(LaneId).collect(),
            left: vec![],
            right: vec![],
            roadblock: RoadblockId(i as u32),
            speed_limit: speed_limit.filter(|_| kind == LaneKind::Lane),
            has_traffic_lights: matches!(stretch, Stretch::Signal(_)),
            stop_lines,
        });
        parts.roadblocks.push(Roadblock {
            id: RoadblockId(i as u32),
            source_id: 100 + i as i64,
            kind,
            lanes: vec![id],
            areas: vec![polygon],
            incoming: before.into_iter().map(RoadblockId).collect(),
            outgoing: after.into_iter().map(RoadblockId).collect(),
        });
        from += length;
    }
    LaneMap::new(parts.with_roadblocks_as_road().with_dense_baselines()).unwrap()
}

/// The route along a whole straight road.
pub(crate) fn whole_route(map: &LaneMap) -> Route {
    Route {
        roadblocks: map.roadblocks().iter().map(|block| block.id).collect(),
        goal: None,
        goal_lane: None,
    }
}

/// An ego whose rear axle is at x on the road.
pub(crate) fn ego_at(time_us: i64, x: f64, speed: f64) -> EgoState {
    EgoState::from_log(
        time_us,
        Pose::new(x, 0.0, 0.0),
        Vector::new(speed, 0.0),
        Vector::zeros(),
    )
}

/// An object of a kind, centered at (x, y), that faces along the road.
pub(crate) fn object(token: u32, kind: ObjectKind, x: f64, y: f64, speed: f64) -> TrackedObject {
    let (length, width) = if kind == ObjectKind::Vehicle {
        (4.6, 2.0)
    } else {
        (0.6, 0.6)
    };
    TrackedObject {
        token: TrackToken(token),
        kind,
        shape: OrientedBox::new(Pose::new(x, y, 0.0), length, width),
        velocity: Vector::new(speed, 0.0),
    }
}
