//! The road network under construction: roads with their lanes, junctions with their connectors.

use super::line::shifted;
use super::signal::SignalPlan;
use planagent_world::geometry::{GeometryError, Point, Polygon, Polyline, Pose};
use planagent_world::{
    Lane, LaneId, LaneKind, MapParts, Neighbor, Roadblock, RoadblockId, StopLine, StopLineId,
};

/// How much wider the lanes of a road are than its lane width, meters: along the line and against
/// it, leftmost first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExtraWidths(pub(crate) [[f64; MAX_LANES]; 2]);

/// Maximum number of lanes in a direction.
pub(crate) const MAX_LANES: usize = 4;

impl ExtraWidths {
    /// Of a lane by its index.
    fn of_lane(extra: Option<Self>, along: bool, lane: usize) -> f64 {
        extra.map_or(0.0, |Self(widths)| {
            widths[usize::from(!along)]
                .get(lane)
                .copied()
                .unwrap_or(0.0)
        })
    }

    /// Sum over the first `lanes` lanes.
    pub(crate) fn before(extra: Option<Self>, along: bool, lanes: usize) -> f64 {
        (0..lanes)
            .map(|lane| Self::of_lane(extra, along, lane))
            .sum()
    }
}

/// Parameters of a road. Lanes in the direction of the line lie to its right, oncoming ones to its
/// left.
#[derive(Debug, Clone)]
pub(crate) struct RoadPlan {
    /// Line between the two directions, with exact tangents.
    pub(crate) line: Vec<Pose>,
    /// Lanes along the line.
    pub(crate) forward: usize,
    /// Lanes against it.
    pub(crate) backward: usize,
    /// Meters.
    pub(crate) lane_width: f64,
    /// How much wider single lanes are.
    pub(crate) extra: Option<ExtraWidths>,
    /// m/s.
    pub(crate) speed_limit: f64,
    /// Paved width beside the outermost lanes (curb margin, bicycle strip or parking strip), right
    /// and left of the line, meters.
    pub(crate) shoulder: [f64; 2],
}

impl RoadPlan {
    /// Distance from the line to the left edge of a lane, counted from the line; for the number of
    /// lanes to the last edge.
    fn edge(&self, along: bool, lane: usize) -> f64 {
        lane as f64 * self.lane_width + ExtraWidths::before(self.extra, along, lane)
    }

    /// Distance from the line to the middle of a lane.
    fn middle(&self, along: bool, lane: usize) -> f64 {
        let extra = ExtraWidths::before(self.extra, along, lane)
            + ExtraWidths::of_lane(self.extra, along, lane) / 2.0;
        (lane as f64 + 0.5) * self.lane_width + extra
    }

    /// Distance from the line to the outer edge of the outermost lane.
    fn reach(&self, along: bool) -> f64 {
        self.edge(along, if along { self.forward } else { self.backward })
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Road {
    pub(crate) plan: RoadPlan,
    /// Lanes along the line, leftmost first.
    pub(crate) forward: Vec<LaneId>,
    /// Lanes against it, leftmost for their drivers first.
    pub(crate) backward: Vec<LaneId>,
    /// Outline from curb to curb.
    pub(crate) outline: Polygon,
}

impl Road {
    /// Distance from the line to the right edge of the pavement, meters.
    pub(crate) fn right_edge(&self) -> f64 {
        self.plan.reach(true) + self.plan.shoulder[0]
    }

    /// Distance from the line to the left edge of the pavement, meters.
    pub(crate) fn left_edge(&self) -> f64 {
        self.plan.reach(false) + self.plan.shoulder[1]
    }

    pub(crate) fn end(&self) -> Pose {
        self.plan.line[self.plan.line.len() - 1]
    }
}

/// Index in [`Network::roads`].
pub(crate) type RoadIndex = usize;

/// Right of way of a connector.
#[derive(Debug, Clone)]
pub(crate) struct Passage {
    pub(crate) junction: usize,
    /// Higher ranks go first.
    pub(crate) rank: u8,
    /// True if every vehicle must stop before it.
    pub(crate) stop_sign: bool,
    /// Conflicts with other connectors of the junction.
    pub(crate) conflicts: Vec<Conflict>,
}

/// A conflict with another connector: both cannot be driven at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Conflict {
    pub(crate) other: LaneId,
    /// Start and end on this connector, meters.
    pub(crate) own: [f64; 2],
    /// Start and end on the other connector, meters.
    pub(crate) others: [f64; 2],
    /// True if this connector yields.
    pub(crate) yields: bool,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct Network {
    pub(crate) parts: MapParts,
    pub(crate) roads: Vec<Road>,
    /// By lane; `None` for lanes of roads.
    pub(crate) passages: Vec<Option<Passage>>,
    pub(crate) signals: Vec<SignalPlan>,
    /// Roads that each intersection polygon touches.
    pub(crate) touching: Vec<Vec<RoadIndex>>,
}

impl Network {
    /// Adds a road with its lanes, roadblocks and margins.
    pub(crate) fn add_road(&mut self, plan: RoadPlan) -> Result<RoadIndex, GeometryError> {
        let forward = self.add_side(&plan, plan.forward, true)?;
        let backward = self.add_side(&plan, plan.backward, false)?;
        let (right, left) = (plan.reach(true), plan.reach(false));
        let strips = [
            (-right, -right - plan.shoulder[0]),
            (left + plan.shoulder[1], left),
        ];
        for (upper, lower) in strips {
            self.parts
                .generic_drivable
                .push(band(&plan.line, upper, lower)?);
        }
        let outline = band(
            &plan.line,
            left + plan.shoulder[1],
            -right - plan.shoulder[0],
        )?;
        self.roads.push(Road {
            plan,
            forward,
            backward,
            outline,
        });
        Ok(self.roads.len() - 1)
    }

    /// Adds the lanes of one direction with their roadblock, leftmost for their drivers first.
    fn add_side(
        &mut self,
        plan: &RoadPlan,
        count: usize,
        along: bool,
    ) -> Result<Vec<LaneId>, GeometryError> {
        if count == 0 {
            return Ok(Vec::new());
        }
        let side = if along { -1.0 } else { 1.0 };
        // Left and right are those of the drivers, so lines against the road are reversed.
        let edge = |lanes: usize| -> Vec<Point> {
            let line = shifted(&plan.line, side * plan.edge(along, lanes));
            if along {
                line
            } else {
                line.into_iter().rev().collect()
            }
        };
        let block = RoadblockId(self.parts.roadblocks.len() as u32);
        let first = self.parts.lanes.len() as u32;
        let mut lanes = Vec::with_capacity(count);
        for i in 0..count {
            let center = shifted(&plan.line, side * plan.middle(along, i));
            let center = if along {
                center
            } else {
                center.into_iter().rev().collect()
            };
            let centerline = Polyline::new(center)?;
            let length = centerline.length();
            let beside = |j: usize| {
                vec![Neighbor {
                    lane: LaneId(first + j as u32),
                    from_s: 0.0,
                    to_s: length,
                }]
            };
            let id = LaneId(first + i as u32);
            lanes.push(id);
            self.parts.lanes.push(Lane {
                id,
                source_id: i64::from(id.0),
                kind: LaneKind::Lane,
                polygon: ring(edge(i), edge(i + 1))?,
                incoming: Vec::new(),
                outgoing: Vec::new(),
                left: if i > 0 { beside(i - 1) } else { Vec::new() },
                right: if i + 1 < count {
                    beside(i + 1)
                } else {
                    Vec::new()
                },
                roadblock: block,
                speed_limit: Some(plan.speed_limit),
                has_traffic_lights: false,
                stop_lines: Vec::new(),
                centerline,
            });
            self.passages.push(None);
        }
        self.parts.roadblocks.push(Roadblock {
            id: block,
            source_id: i64::from(block.0),
            kind: LaneKind::Lane,
            lanes: lanes.clone(),
            areas: vec![ring(edge(0), edge(count))?],
            incoming: Vec::new(),
            outgoing: Vec::new(),
        });
        Ok(lanes)
    }

    /// Width of a lane of a road, meters.
    pub(crate) fn width_of(&self, lane: LaneId) -> f64 {
        let owner = self
            .roads
            .iter()
            .find(|road| road.forward.contains(&lane) || road.backward.contains(&lane));
        owner.map_or(3.5, |road| {
            let along = road.forward.iter().position(|&one| one == lane);
            let against = road.backward.iter().position(|&one| one == lane);
            road.plan.lane_width
                + ExtraWidths::of_lane(
                    road.plan.extra,
                    along.is_some(),
                    along.or(against).expect("the owner has the lane"),
                )
        })
    }

    /// Adds a connector along `line` from the end of one lane to the start of another.
    pub(crate) fn connect(
        &mut self,
        from: LaneId,
        to: LaneId,
        line: &[Pose],
        passage: Passage,
    ) -> Result<LaneId, GeometryError> {
        let (w0, w1) = (self.width_of(from) / 2.0, self.width_of(to) / 2.0);
        let last = (line.len() - 1) as f64;
        // Lanes on both sides may differ in width, and the area must meet both without a step.
        let edge = |side: f64| -> Vec<Point> {
            let half = |i: usize| w0 + (w1 - w0) * i as f64 / last;
            line.iter()
                .enumerate()
                .map(|(i, pose)| pose.to_map(Point::new(0.0, side * half(i))))
                .collect()
        };
        let polygon = ring(edge(1.0), edge(-1.0))?;
        let id = LaneId(self.parts.lanes.len() as u32);
        let block = self.connector_block(from, to);
        self.parts.roadblocks[block.index()].lanes.push(id);
        self.parts.roadblocks[block.index()]
            .areas
            .push(polygon.clone());
        self.parts.lanes[from.index()].outgoing.push(id);
        self.parts.lanes[to.index()].incoming.push(id);
        self.parts.lanes.push(Lane {
            id,
            source_id: i64::from(id.0),
            kind: LaneKind::Connector,
            centerline: Polyline::new(line.iter().map(Pose::position))?,
            polygon,
            incoming: vec![from],
            outgoing: vec![to],
            left: Vec::new(),
            right: Vec::new(),
            roadblock: block,
            speed_limit: None,
            has_traffic_lights: false,
            stop_lines: Vec::new(),
        });
        self.passages.push(Some(passage));
        Ok(id)
    }

    /// The roadblock connector between the roadblocks of two lanes.
    fn connector_block(&mut self, from: LaneId, to: LaneId) -> RoadblockId {
        let (before, after) = (
            self.parts.lanes[from.index()].roadblock,
            self.parts.lanes[to.index()].roadblock,
        );
        let known = self.parts.roadblocks.iter().find(|b| {
            b.kind == LaneKind::Connector
                && b.incoming.first() == Some(&before)
                && b.outgoing.first() == Some(&after)
        });
        if let Some(block) = known {
            return block.id;
        }
        let id = RoadblockId(self.parts.roadblocks.len() as u32);
        self.parts.roadblocks.push(Roadblock {
            id,
            source_id: i64::from(id.0),
            kind: LaneKind::Connector,
            lanes: Vec::new(),
            areas: Vec::new(),
            incoming: vec![before],
            outgoing: vec![after],
        });
        self.parts.roadblocks[before.index()].outgoing.push(id);
        self.parts.roadblocks[after.index()].incoming.push(id);
        id
    }

    /// Makes two connectors neighbors that join neighboring lanes side by side.
    pub(crate) fn adjoin(&mut self, left: LaneId, right: LaneId) {
        let length =
            |network: &Self, lane: LaneId| network.parts.lanes[lane.index()].centerline.length();
        let (of_left, of_right) = (length(self, left), length(self, right));
        self.parts.lanes[left.index()].right.push(Neighbor {
            lane: right,
            from_s: 0.0,
            to_s: of_left,
        });
        self.parts.lanes[right.index()].left.push(Neighbor {
            lane: left,
            from_s: 0.0,
            to_s: of_right,
        });
    }

    /// Puts a stop line across the first meter of the connectors that leave `lane`.
    pub(crate) fn add_stop_line(
        &mut self,
        lane: LaneId,
        stop_sign: bool,
    ) -> Result<(), GeometryError> {
        /// Distances of the line's two edges from the end of the lane, meters.
        const PAINTED: [f64; 2] = [0.2, 0.7];
        let half = self.width_of(lane) / 2.0;
        let end = self.end_of(lane);
        let corner = |forward: f64, left: f64| end.to_map(Point::new(forward, left));
        let polygon = Polygon::new([
            corner(PAINTED[0], -half),
            corner(PAINTED[1], -half),
            corner(PAINTED[1], half),
            corner(PAINTED[0], half),
        ])?;
        let id = StopLineId(self.parts.stop_lines.len() as u32);
        let lanes = self.parts.lanes[lane.index()].outgoing.clone();
        for connector in &lanes {
            let connector = &mut self.parts.lanes[connector.index()];
            connector.stop_lines.push(id);
            connector.has_traffic_lights |= !stop_sign;
        }
        self.parts.stop_lines.push(StopLine {
            polygon,
            lanes,
            stop_sign,
        });
        Ok(())
    }

    /// End of a road's lane, with the tangent of the road.
    pub(crate) fn end_of(&self, lane: LaneId) -> Pose {
        let centerline = &self.parts.lanes[lane.index()].centerline;
        Pose::at(centerline.end(), self.tangent(lane, false))
    }

    /// Start of a road's lane, with the tangent of the road.
    pub(crate) fn start_of(&self, lane: LaneId) -> Pose {
        let centerline = &self.parts.lanes[lane.index()].centerline;
        Pose::at(centerline.start(), self.tangent(lane, true))
    }

    /// Heading of the road's line at an end of a lane.
    fn tangent(&self, lane: LaneId, at_start: bool) -> f64 {
        let turned = planagent_world::geometry::wrap_angle;
        for road in &self.roads {
            let line = &road.plan.line;
            if road.forward.contains(&lane) {
                return if at_start {
                    line[0].heading
                } else {
                    line[line.len() - 1].heading
                };
            }
            if road.backward.contains(&lane) {
                let pose = if at_start {
                    line[line.len() - 1]
                } else {
                    line[0]
                };
                return turned(pose.heading + std::f64::consts::PI);
            }
        }
        let centerline = &self.parts.lanes[lane.index()].centerline;
        centerline.heading_at(if at_start { 0.0 } else { centerline.length() })
    }
}

/// The area between two parallels of a line, the first to the left of the second.
pub(crate) fn band(line: &[Pose], left: f64, right: f64) -> Result<Polygon, GeometryError> {
    ring(shifted(line, left), shifted(line, right))
}

/// The area between a left and a right edge in the same direction: along the right edge, back along
/// the left.
fn ring(left: Vec<Point>, right: Vec<Point>) -> Result<Polygon, GeometryError> {
    Polygon::new(right.into_iter().chain(left.into_iter().rev()))
}
