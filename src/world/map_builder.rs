//! Builds lane maps by hand, lane by lane.

use super::{
    Lane, LaneId, LaneKind, LaneMap, MapError, MapParts, Neighbor, Roadblock, RoadblockId,
    StopLine, StopLineId,
};
use crate::geometry::{GeometryError, OrientedBox, Point, Polygon, Polyline};

/// Vertices of the connector that [`MapBuilder::join`] draws.
const BEND_STEPS: u32 = 24;
/// A lane that ends this near to the start of another leads into it, meters.
const JOINT: f64 = 0.5;

/// A lane map under construction. Centerlines get a vertex every meter, those of the finished map
/// every half meter.
#[derive(Debug, Clone, Default)]
pub struct MapBuilder {
    /// The layers so far; add areas such as crosswalks here.
    pub parts: MapParts,
    groups: Vec<Vec<LaneId>>,
}

impl MapBuilder {
    /// Adds a lane of this width (meters) along a line, with a speed limit in m/s.
    ///
    /// # Errors
    /// When the points make no line.
    pub fn lane(
        &mut self,
        points: impl IntoIterator<Item = Point>,
        width: f64,
        speed_limit: Option<f64>,
    ) -> Result<LaneId, GeometryError> {
        self.piece(LaneKind::Lane, points, width, speed_limit)
    }

    /// Adds a connector of this width (meters) across an intersection.
    ///
    /// # Errors
    /// When the points make no line.
    pub fn connector(
        &mut self,
        points: impl IntoIterator<Item = Point>,
        width: f64,
    ) -> Result<LaneId, GeometryError> {
        self.piece(LaneKind::Connector, points, width, None)
    }

    fn piece(
        &mut self,
        kind: LaneKind,
        points: impl IntoIterator<Item = Point>,
        width: f64,
        speed_limit: Option<f64>,
    ) -> Result<LaneId, GeometryError> {
        let id = LaneId(self.parts.lanes.len() as u32);
        let centerline = Polyline::new(points)?.resampled(1.0);
        let polygon = Polygon::between(
            &centerline.offset(width / 2.0),
            &centerline.offset(-width / 2.0),
        )?;
        self.parts.lanes.push(Lane {
            id,
            source_id: i64::from(id.0) + 1000,
            kind,
            centerline,
            polygon,
            incoming: vec![],
            outgoing: vec![],
            left: vec![],
            right: vec![],
            roadblock: RoadblockId(0),
            speed_limit,
            has_traffic_lights: false,
            stop_lines: vec![],
        });
        Ok(id)
    }

    /// Makes one lane lead into another.
    pub fn connect(&mut self, from: LaneId, to: LaneId) {
        self.parts.lanes[from.index()].outgoing.push(to);
        self.parts.lanes[to.index()].incoming.push(from);
    }

    /// Connects every lane with those that start at its end, unless it is connected already.
    pub fn connect_touching(&mut self) {
        let ends = |lane: &Lane| (lane.id, lane.centerline.start(), lane.centerline.end());
        let ends: Vec<_> = self.parts.lanes.iter().map(ends).collect();
        for &(from, _, end) in &ends {
            for &(to, start, _) in &ends {
                let known = self.parts.lanes[from.index()].outgoing.contains(&to);
                if from != to && !known && (end - start).norm() <= JOINT {
                    self.connect(from, to);
                }
            }
        }
    }

    /// Adds a connector along a smooth bend from the end of one lane to the start of another.
    ///
    /// # Errors
    /// When the lanes already touch.
    pub fn join(&mut self, from: LaneId, to: LaneId, width: f64) -> Result<LaneId, GeometryError> {
        let (a, b) = (
            &self.parts.lanes[from.index()].centerline,
            &self.parts.lanes[to.index()].centerline,
        );
        let (start, end) = (a.pose_at(a.length()), b.pose_at(0.0));
        let pull = start.distance(&end) * 0.5;
        let (p1, p2) = (
            start.translated(pull, 0.0).position(),
            end.translated(-pull, 0.0).position(),
        );
        let bend = (0..=BEND_STEPS).map(|i| {
            let t = f64::from(i) / f64::from(BEND_STEPS);
            let (u, t2) = (1.0 - t, t * t);
            let at = start.position().coords * u.powi(3)
                + p1.coords * (3.0 * u * u * t)
                + p2.coords * (3.0 * u * t2)
                + end.position().coords * (t2 * t);
            Point::from(at)
        });
        let connector = self.connector(bend, width)?;
        self.connect(from, connector);
        self.connect(connector, to);
        Ok(connector)
    }

    /// Makes lanes, from left to right, neighbors in one roadblock.
    pub fn abreast(&mut self, lanes: &[LaneId]) {
        for pair in lanes.windows(2) {
            let (left, right) = (pair[0], pair[1]);
            let length = |id: LaneId| self.parts.lanes[id.index()].centerline.length();
            let (left_length, right_length) = (length(left), length(right));
            let to = |lane, to_s| Neighbor {
                lane,
                from_s: 0.0,
                to_s,
            };
            self.parts.lanes[left.index()]
                .right
                .push(to(right, left_length));
            self.parts.lanes[right.index()]
                .left
                .push(to(left, right_length));
        }
        self.groups.push(lanes.to_vec());
    }

    /// Gives a connector a traffic light, with a stop line of this width (meters) 1 m before it.
    pub fn stop_line(&mut self, connector: LaneId, width: f64) {
        let id = StopLineId(self.parts.stop_lines.len() as u32);
        let at = self.parts.lanes[connector.index()]
            .centerline
            .pose_at(0.0)
            .translated(-1.0, 0.0);
        let polygon = OrientedBox::new(at, 0.4, width).to_polygon();
        self.parts.stop_lines.push(StopLine {
            polygon,
            lanes: vec![connector],
            stop_sign: false,
        });
        let lane = &mut self.parts.lanes[connector.index()];
        lane.stop_lines.push(id);
        lane.has_traffic_lights = true;
    }

    /// The map. Lanes that are not [`Self::abreast`] get a roadblock each, and roadblocks are
    /// connected as their lanes are.
    ///
    /// # Errors
    /// When there is no lane.
    pub fn finish(mut self) -> Result<LaneMap, MapError> {
        for id in self
            .parts
            .lanes
            .iter()
            .map(|lane| lane.id)
            .collect::<Vec<_>>()
        {
            if !self.groups.iter().any(|group| group.contains(&id)) {
                self.groups.push(vec![id]);
            }
        }
        for (i, lanes) in self.groups.iter().enumerate() {
            for lane in lanes {
                self.parts.lanes[lane.index()].roadblock = RoadblockId(i as u32);
            }
        }
        // A second pass, because links of a roadblock need the roadblock of every lane.
        for (i, lanes) in self.groups.into_iter().enumerate() {
            let members = || lanes.iter().map(|lane| &self.parts.lanes[lane.index()]);
            let blocks = |edges: fn(&Lane) -> &[LaneId]| {
                let blocks = members()
                    .flat_map(edges)
                    .map(|lane| self.parts.lanes[lane.index()].roadblock);
                let mut blocks: Vec<RoadblockId> = blocks.collect();
                blocks.sort();
                blocks.dedup();
                blocks
            };
            let block = Roadblock {
                id: RoadblockId(i as u32),
                source_id: i as i64,
                kind: members().next().map_or(LaneKind::Lane, |lane| lane.kind),
                areas: members().map(|lane| lane.polygon.clone()).collect(),
                incoming: blocks(|lane| &lane.incoming),
                outgoing: blocks(|lane| &lane.outgoing),
                lanes: lanes.clone(),
            };
            self.parts.roadblocks.push(block);
        }
        LaneMap::new(self.parts.with_roadblocks_as_road().with_dense_baselines())
    }
}
