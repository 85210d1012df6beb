//! Joints between two roads, and crossings with their connectors, stop lines, crosswalks and
//! traffic lights.

use super::line::connection;
use super::network::{Network, Passage, RoadIndex};
use super::signal::SignalPlan;
use planagent_world::LaneId;
use planagent_world::geometry::{GeometryError, Point, Polygon, Pose, wrap_angle};
use std::f64::consts::PI;

/// An end of a road, by the direction of its line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    Start,
    Finish,
}

/// A road's end at a junction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Arm {
    pub(crate) road: RoadIndex,
    pub(crate) end: End,
    /// True if it belongs to the minor of the two roads that cross.
    pub(crate) minor: bool,
}

/// Right of way at a crossing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Control {
    /// Traffic lights; `protected_left` gives left turns a phase of their own.
    Signals { protected_left: bool },
    /// The minor road stops at a sign.
    StopSigns,
    /// The minor road yields.
    Priority,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Turn {
    Left,
    Straight,
    Right,
}

impl Turn {
    /// The turn between two headings: straight below 50 degrees.
    pub(crate) fn between(from: f64, to: f64) -> Self {
        /// Radians.
        const STRAIGHT: f64 = 50.0 / 180.0 * PI;
        let angle = wrap_angle(to - from);
        if angle.abs() < STRAIGHT {
            Self::Straight
        } else if angle > 0.0 {
            Self::Left
        } else {
            Self::Right
        }
    }
}

/// A movement through a junction.
#[derive(Debug, Clone, Copy)]
struct Movement {
    from_arm: usize,
    minor: bool,
    turn: Turn,
    connector: LaneId,
}

impl Network {
    /// The mouth of an arm: its line where the junction begins, facing away from the junction.
    pub(super) fn mouth(&self, arm: Arm) -> Pose {
        let road = &self.roads[arm.road];
        match arm.end {
            End::Start => road.plan.line[0],
            End::Finish => {
                let end = road.end();
                Pose::new(end.x, end.y, wrap_angle(end.heading + PI))
            }
        }
    }

    /// Distances from an arm's line to the right and left edge of its pavement, facing away from
    /// the junction.
    pub(super) fn edges(&self, arm: Arm) -> [f64; 2] {
        let road = &self.roads[arm.road];
        match arm.end {
            End::Start => [road.right_edge(), road.left_edge()],
            End::Finish => [road.left_edge(), road.right_edge()],
        }
    }

    /// Lanes that enter the junction at an arm, leftmost first.
    pub(crate) fn arriving(&self, arm: Arm) -> &[LaneId] {
        let road = &self.roads[arm.road];
        if arm.end == End::Finish {
            &road.forward
        } else {
            &road.backward
        }
    }

    /// Lanes that leave the junction at an arm, leftmost first.
    pub(crate) fn leaving(&self, arm: Arm) -> &[LaneId] {
        let road = &self.roads[arm.road];
        if arm.end == End::Finish {
            &road.backward
        } else {
            &road.forward
        }
    }

    /// Joins two roads end to start, lane by lane, over a short paved piece (nuPlan: a pass-through
    /// intersection).
    pub(crate) fn join(
        &mut self,
        before: RoadIndex,
        after: RoadIndex,
    ) -> Result<(), GeometryError> {
        let arms = [
            Arm {
                road: before,
                end: End::Finish,
                minor: false,
            },
            Arm {
                road: after,
                end: End::Start,
                minor: false,
            },
        ];
        let junction = self.open_junction(&arms)?;
        for (from, to) in [(arms[0], arms[1]), (arms[1], arms[0])] {
            let (arriving, leaving) = (self.arriving(from).to_vec(), self.leaving(to).to_vec());
            let mut previous = None;
            for (&a, &b) in arriving.iter().zip(&leaving) {
                let line = connection(self.end_of(a), self.start_of(b));
                let passage = Passage {
                    junction,
                    // Lanes that only continue cross nothing, so they rank above every turn.
                    rank: 9,
                    stop_sign: false,
                    conflicts: Vec::new(),
                };
                let connector = self.connect(a, b, &line, passage)?;
                if let Some(left) = previous.replace(connector) {
                    self.adjoin(left, connector);
                }
            }
        }
        Ok(())
    }

    /// Adds a junction of these arms and gives its index. Its area is the pavement between them.
    fn open_junction(&mut self, arms: &[Arm]) -> Result<usize, GeometryError> {
        let area = self.junction_area(arms)?;
        Ok(self.add_junction(area, arms.iter().map(|arm| arm.road).collect()))
    }

    /// Adds a junction with the roads that it touches and gives its index.
    pub(super) fn add_junction(&mut self, area: Polygon, touching: Vec<RoadIndex>) -> usize {
        self.parts.intersections.push(area);
        self.touching.push(touching);
        self.touching.len() - 1
    }

    /// The pavement between the mouths, with rounded curbs. The arms are in counter-clockwise
    /// order.
    fn junction_area(&self, arms: &[Arm]) -> Result<Polygon, GeometryError> {
        /// Overlap with each arm against gaps at the seam, meters.
        const SEAM: f64 = 0.05;
        let sides: Vec<[Pose; 2]> = arms
            .iter()
            .map(|&arm| {
                let ([right, left], mouth) = (self.edges(arm), self.mouth(arm));
                [mouth.translated(SEAM, -right), mouth.translated(SEAM, left)]
            })
            .collect();
        let mut outline = Vec::new();
        for (i, &[right, left]) in sides.iter().enumerate() {
            outline.push(right.position());
            outline.push(left.position());
            outline.extend(curb(left, sides[(i + 1) % sides.len()][0]));
        }
        Polygon::new(outline)
    }

    /// Adds a crossing of three or four arms, which are in counter-clockwise order.
    pub(crate) fn cross(
        &mut self,
        arms: &[Arm],
        control: Control,
        crosswalks: &[bool],
    ) -> Result<(), GeometryError> {
        let junction = self.open_junction(arms)?;
        let mut movements = Vec::new();
        for (from_arm, &from) in arms.iter().enumerate() {
            for (a, b, turn, to_arm) in self.lane_pairs(arms, from_arm) {
                let line = connection(self.end_of(a), self.start_of(b));
                let rank = rank(control, from.minor, turn);
                let stop_sign = control == Control::StopSigns && from.minor;
                let connector = self.connect(
                    a,
                    b,
                    &line,
                    Passage {
                        junction,
                        rank,
                        stop_sign,
                        conflicts: Vec::new(),
                    },
                )?;
                // Only connectors that go straight lie side by side.
                let beside = movements.last().copied().filter(
                    |&(m, to, lane): &(Movement, usize, LaneId)| {
                        m.turn == Turn::Straight
                            && m.from_arm == from_arm
                            && to == to_arm
                            && lane != b
                    },
                );
                if let (Turn::Straight, Some((left, _, _))) = (turn, beside) {
                    self.adjoin(left.connector, connector);
                }
                movements.push((
                    Movement {
                        from_arm,
                        minor: from.minor,
                        turn,
                        connector,
                    },
                    to_arm,
                    b,
                ));
            }
            if matches!(control, Control::Signals { .. })
                || (control == Control::StopSigns && from.minor)
            {
                for lane in self.arriving(from).to_vec() {
                    self.add_stop_line(lane, control == Control::StopSigns)?;
                }
            }
        }
        if let Control::Signals { protected_left } = control {
            let movements: Vec<Movement> = movements.iter().map(|m| m.0).collect();
            self.signals.push(signal_plan(&movements, protected_left));
        }
        for (&arm, _) in arms.iter().zip(crosswalks).filter(|(_, wanted)| **wanted) {
            let ([right, left], mouth) = (self.edges(arm), self.mouth(arm));
            self.parts
                .crosswalks
                .push(crossing_band(mouth, right, left)?);
        }
        Ok(())
    }

    /// Pairs of lanes that a crossing connects from one arm, left turns first, leftmost first.
    fn lane_pairs(&self, arms: &[Arm], from_arm: usize) -> Vec<(LaneId, LaneId, Turn, usize)> {
        let arriving = self.arriving(arms[from_arm]);
        if arriving.is_empty() {
            return Vec::new();
        }
        let heading = wrap_angle(self.mouth(arms[from_arm]).heading + PI);
        let mut exits: Vec<(Turn, usize)> = (0..arms.len())
            .filter(|&to| to != from_arm && !self.leaving(arms[to]).is_empty())
            .map(|to| (Turn::between(heading, self.mouth(arms[to]).heading), to))
            .collect();
        exits.sort_unstable();
        let leads = |turn: Turn| exits.iter().any(|&(t, _)| t == turn);
        let count = arriving.len();
        // From three lanes on, the left one only turns; from four on, the right one too. Both need
        // an exit on that side.
        let left_only = usize::from(count >= 3 && leads(Turn::Left));
        let right_only = usize::from(count >= 4 && leads(Turn::Right));
        let mut pairs = Vec::new();
        for &(turn, to) in &exits {
            let leaving = self.leaving(arms[to]);
            let last = leaving.len() - 1;
            match turn {
                Turn::Left => pairs.push((arriving[0], leaving[0], turn, to)),
                Turn::Right => pairs.push((arriving[count - 1], leaving[last], turn, to)),
                Turn::Straight => {
                    for (i, &lane) in arriving
                        .iter()
                        .enumerate()
                        .take(count - right_only)
                        .skip(left_only)
                    {
                        if i <= last {
                            pairs.push((lane, leaving[i], turn, to));
                        }
                    }
                }
            }
        }
        // A lane without a connector takes the straight exit, or else the rightmost.
        for (i, &lane) in arriving.iter().enumerate() {
            if pairs.iter().all(|p| p.0 != lane)
                && let Some(&(turn, to)) = exits
                    .iter()
                    .max_by_key(|&&(turn, _)| (turn == Turn::Straight, turn))
            {
                let leaving = self.leaving(arms[to]);
                pairs.push((lane, leaving[i.min(leaving.len() - 1)], turn, to));
            }
        }
        pairs
    }
}

/// A crosswalk at the mouth of an arm, from curb to curb.
pub(super) fn crossing_band(mouth: Pose, right: f64, left: f64) -> Result<Polygon, GeometryError> {
    /// Distances of its edges from the mouth into the junction, meters.
    const NEAR: f64 = 1.5;
    const FAR: f64 = 4.5;
    let corner = |forward: f64, side: f64| mouth.to_map(Point::new(forward, side));
    Polygon::new([
        corner(-NEAR, left),
        corner(-FAR, left),
        corner(-FAR, -right),
        corner(-NEAR, -right),
    ])
}

/// The rounded curb between two arms' edges, without its two ends; empty if the edges are nearly
/// parallel. Both poses face away from the junction.
pub(super) fn curb(from: Pose, to: Pose) -> Vec<Point> {
    /// Pieces of the rounded curb.
    const SAMPLES: usize = 8;
    let Some(corner) = curb_corner(from, to) else {
        return Vec::new();
    };
    let (a, b) = (from.position().coords, to.position().coords);
    (1..SAMPLES)
        .map(|k| k as f64 / SAMPLES as f64)
        .map(|t| {
            Point::from(
                a * (1.0 - t).powi(2) + corner.coords * (2.0 * t * (1.0 - t)) + b * t.powi(2),
            )
        })
        .collect()
}

/// Intersection of two curb lines inside the junction, or `None` if they are nearly parallel. Both
/// poses face away from it.
fn curb_corner(a: Pose, b: Pose) -> Option<Point> {
    let (u, w) = (a.direction(), b.direction());
    let cross = u.perp(&w);
    if cross.abs() < 0.3 {
        return None;
    }
    let along = (b.position() - a.position()).perp(&w) / cross;
    // The corner lies behind the mouth, toward the junction.
    (along < 0.0).then(|| a.position() + u * along)
}

/// Rank for the right of way: higher ranks go first.
fn rank(control: Control, minor: bool, turn: Turn) -> u8 {
    let by_turn = match turn {
        Turn::Left => 1,
        Turn::Right => 2,
        Turn::Straight => 3,
    };
    match control {
        Control::Signals { .. } => by_turn,
        Control::StopSigns | Control::Priority => by_turn + if minor { 0 } else { 3 },
    }
}

/// Opposite arms share a phase. Protected left turns get theirs before it.
fn signal_plan(movements: &[Movement], protected_left: bool) -> SignalPlan {
    /// Duration of green for through traffic and for protected left turns, seconds.
    const THROUGH: f64 = 14.0;
    const LEFT: f64 = 8.0;
    let mut phases = Vec::new();
    for minor in [false, true] {
        let of = |left: bool| -> Vec<LaneId> {
            let wanted = |m: &&Movement| {
                m.minor == minor && (!protected_left || (m.turn == Turn::Left) == left)
            };
            movements
                .iter()
                .filter(wanted)
                .map(|m| m.connector)
                .collect()
        };
        if protected_left && !of(true).is_empty() {
            phases.push((of(true), LEFT));
        }
        if !of(false).is_empty() {
            phases.push((of(false), THROUGH));
        }
    }
    SignalPlan::new(&phases)
}
