//! Small hand-made maps of straight pieces, each a lane in a roadblock of its own.

use planagent_world::geometry::{OrientedBox, Point, Polygon, Polyline};
use planagent_world::{Lane, LaneId, LaneKind, LaneMap, MapParts, Roadblock, RoadblockId, Route};

/// Lane of every hand-made map: 4 m wide.
const LANE_WIDTH: f64 = 4.0;

#[derive(Default)]
pub(super) struct Town {
    pub(super) parts: MapParts,
}

impl Town {
    /// Adds a piece with a roadblock of its own, both of one number.
    pub(super) fn piece(
        &mut self,
        kind: LaneKind,
        line: &[(f64, f64)],
        limit: Option<f64>,
    ) -> LaneId {
        let centerline = Polyline::new(line.iter().map(|&(x, y)| Point::new(x, y))).unwrap();
        let middle = centerline.pose_at(centerline.length() / 2.0);
        let polygon = OrientedBox::new(middle, centerline.length(), LANE_WIDTH).to_polygon();
        self.shaped(kind, centerline, polygon, limit)
    }

    /// Adds a piece of any outline.
    pub(super) fn shaped(
        &mut self,
        kind: LaneKind,
        line: Polyline,
        polygon: Polygon,
        limit: Option<f64>,
    ) -> LaneId {
        let number = self.parts.lanes.len() as u32;
        self.parts.roadblocks.push(Roadblock {
            id: RoadblockId(number),
            source_id: i64::from(number) + 1000,
            kind,
            lanes: vec![LaneId(number)],
            areas: vec![polygon.clone()],
            incoming: vec![],
            outgoing: vec![],
        });
        self.parts.lanes.push(Lane {
            id: LaneId(number),
            source_id: i64::from(number),
            kind,
            centerline: line,
            polygon,
            incoming: vec![],
            outgoing: vec![],
            left: vec![],
            right: vec![],
            roadblock: RoadblockId(number),
            speed_limit: limit,
            has_traffic_lights: false,
            stop_lines: vec![],
        });
        LaneId(number)
    }

    pub(super) fn lane(&mut self, from: (f64, f64), to: (f64, f64)) -> LaneId {
        self.piece(LaneKind::Lane, &[from, to], Some(10.0))
    }

    pub(super) fn connector(&mut self, from: (f64, f64), to: (f64, f64)) -> LaneId {
        self.piece(LaneKind::Connector, &[from, to], None)
    }

    /// Makes `b` follow `a`, lanes and roadblocks.
    pub(super) fn link(&mut self, a: LaneId, b: LaneId) {
        self.parts.lanes[a.index()].outgoing.push(b);
        self.parts.lanes[b.index()].incoming.push(a);
        let (a, b) = (
            self.parts.lanes[a.index()].roadblock,
            self.parts.lanes[b.index()].roadblock,
        );
        self.parts.roadblocks[a.index()].outgoing.push(b);
        self.parts.roadblocks[b.index()].incoming.push(a);
    }

    /// A row of linked lanes of 20 m along the x axis from x = 0.
    pub(super) fn row(&mut self, count: usize) -> Vec<LaneId> {
        let end = |i: usize| (20.0 * i as f64, 0.0);
        let lanes: Vec<LaneId> = (0..count).map(|i| self.lane(end(i), end(i + 1))).collect();
        for pair in lanes.windows(2) {
            self.link(pair[0], pair[1]);
        }
        lanes
    }

    pub(super) fn build(self) -> LaneMap {
        LaneMap::new(self.parts.with_dense_baselines()).unwrap()
    }
}

/// The roadblocks of lanes that have one each.
pub(super) fn blocks(lanes: &[LaneId]) -> Vec<RoadblockId> {
    lanes.iter().map(|lane| RoadblockId(lane.0)).collect()
}

pub(super) fn route(lanes: &[LaneId]) -> Route {
    Route {
        roadblocks: blocks(lanes),
        goal: None,
        goal_lane: None,
    }
}
