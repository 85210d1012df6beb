//! Small hand-made maps and drives on them.

use planagent_world::geometry::{OrientedBox, Point, Polygon, Polyline, Pose, Vector};
use planagent_world::{
    EgoState, HistorySample, Lane, LaneId, LaneKind, LaneMap, MapParts, ObjectKind, PACIFICA,
    Roadblock, RoadblockId, StopLine, StopLineId, TrackToken, TrackedObject,
};

/// Lane of every hand-made map: 4 m wide.
pub(crate) const LANE_WIDTH: f64 = 4.0;

/// Builds maps of straight pieces, each its own roadblock unless joined.
#[derive(Default)]
pub(crate) struct Road {
    pub(crate) parts: MapParts,
}

impl Road {
    /// Adds a straight piece of 4 m width; returns its id.
    pub(crate) fn piece(
        &mut self,
        kind: LaneKind,
        from: (f64, f64),
        to: (f64, f64),
        limit: Option<f64>,
    ) -> LaneId {
        let centerline = Polyline::new([from, to].map(|(x, y)| Point::new(x, y))).unwrap();
        let middle = centerline.pose_at(centerline.length() / 2.0);
        let polygon = OrientedBox::new(middle, centerline.length(), LANE_WIDTH).to_polygon();
        self.add(kind, centerline, polygon, limit)
    }

    /// Adds a straight piece with a vertex every meter.
    pub(crate) fn dense(
        &mut self,
        kind: LaneKind,
        from: (f64, f64),
        to: (f64, f64),
        limit: Option<f64>,
    ) -> LaneId {
        let id = self.piece(kind, from, to, limit);
        let line = &mut self.parts.lanes[id.index()].centerline;
        *line = line.resampled(1.0);
        id
    }

    /// Adds a piece along a line, 4 m wide.
    pub(crate) fn along(&mut self, kind: LaneKind, line: Polyline, limit: Option<f64>) -> LaneId {
        let side = |lateral: f64| line.offset(lateral);
        let polygon = Polygon::between(&side(LANE_WIDTH / 2.0), &side(-LANE_WIDTH / 2.0)).unwrap();
        self.add(kind, line, polygon, limit)
    }

    /// Adds a stop line across the x axis from `x` to `x + 0.5`, for a lane.
    pub(crate) fn stop_line(&mut self, x: f64, lane: LaneId) -> StopLineId {
        let id = StopLineId(self.parts.stop_lines.len() as u32);
        let polygon = rectangle((x, x + 0.5), (-LANE_WIDTH / 2.0, LANE_WIDTH / 2.0));
        self.parts.stop_lines.push(StopLine {
            polygon,
            lanes: vec![lane],
            stop_sign: false,
        });
        self.parts.lanes[lane.index()].stop_lines.push(id);
        id
    }

    fn add(
        &mut self,
        kind: LaneKind,
        centerline: Polyline,
        polygon: Polygon,
        limit: Option<f64>,
    ) -> LaneId {
        let id = LaneId(self.parts.lanes.len() as u32);
        let roadblock = RoadblockId(self.parts.roadblocks.len() as u32);
        self.parts.roadblocks.push(Roadblock {
            id: roadblock,
            source_id: i64::from(roadblock.0) + 1000,
            kind,
            lanes: vec![id],
            areas: vec![polygon.clone()],
            incoming: vec![],
            outgoing: vec![],
        });
        self.parts.lanes.push(Lane {
            id,
            source_id: i64::from(id.0),
            kind,
            centerline,
            polygon,
            incoming: vec![],
            outgoing: vec![],
            left: vec![],
            right: vec![],
            roadblock,
            speed_limit: limit,
            has_traffic_lights: false,
            stop_lines: vec![],
        });
        id
    }

    pub(crate) fn lane(&mut self, from: (f64, f64), to: (f64, f64)) -> LaneId {
        self.piece(LaneKind::Lane, from, to, Some(15.0))
    }

    pub(crate) fn connector(&mut self, from: (f64, f64), to: (f64, f64)) -> LaneId {
        self.piece(LaneKind::Connector, from, to, None)
    }

    /// Makes `b` follow `a`.
    pub(crate) fn link(&mut self, a: LaneId, b: LaneId) {
        self.parts.lanes[a.index()].outgoing.push(b);
        self.parts.lanes[b.index()].incoming.push(a);
    }

    pub(crate) fn build(self) -> LaneMap {
        LaneMap::new(self.parts.with_roadblocks_as_road().with_dense_baselines()).unwrap()
    }
}

pub(crate) fn rectangle(x: (f64, f64), y: (f64, f64)) -> Polygon {
    Polygon::new([(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)].map(|(x, y)| Point::new(x, y)))
        .unwrap()
}

/// One lane along the x axis from −100 to 400 m.
pub(crate) fn straight() -> LaneMap {
    let mut road = Road::default();
    road.lane((-100.0, 0.0), (400.0, 0.0));
    road.build()
}

/// Two lanes along the x axis, centered at y = 0 and y = 4, without a road around them.
pub(crate) fn two_lanes() -> LaneMap {
    let mut road = Road::default();
    road.lane((-100.0, 0.0), (400.0, 0.0));
    road.lane((-100.0, 4.0), (400.0, 4.0));
    road.build()
}

/// An ego whose box is centered at (x, y).
pub(crate) fn ego(step: i64, x: f64, y: f64, heading: f64, speed: f64) -> EgoState {
    let rear = PACIFICA.rear_axle_of(Pose::new(x, y, heading));
    EgoState::from_log(
        step * 100_000,
        rear,
        Vector::new(speed, 0.0),
        Vector::zeros(),
    )
}

/// `n` states 0.1 s apart at constant speed along the x axis; a negative speed backs up.
pub(crate) fn cruise(n: usize, x: f64, y: f64, speed: f64) -> Vec<EgoState> {
    (0..n)
        .map(|k| ego(k as i64, x + 0.1 * speed * k as f64, y, 0.0, speed))
        .collect()
}

pub(crate) fn object(
    token: u32,
    kind: ObjectKind,
    center: Pose,
    size: (f64, f64),
    speed: f64,
) -> TrackedObject {
    TrackedObject {
        token: TrackToken(token),
        kind,
        shape: OrientedBox::new(center, size.0, size.1),
        velocity: center.direction() * speed,
    }
}

/// Samples of an ego among objects that are the same at every instant.
pub(crate) fn samples(states: &[EgoState], objects: &[TrackedObject]) -> Vec<HistorySample> {
    states
        .iter()
        .map(|&ego| HistorySample {
            ego,
            objects: objects.into(),
        })
        .collect()
}
