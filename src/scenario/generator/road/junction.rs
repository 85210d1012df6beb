//! Where roads meet: joints on the way, crossings with their turns, stop lines, crosswalks and lights.

use super::line::connection;
use super::network::{Network, Passage, RoadIndex};
use super::signal::SignalPlan;
use crate::geometry::{GeometryError, Point, Polygon, Pose, wrap_angle};
use crate::world::LaneId;
use std::f64::consts::PI;

/// Which end of a road meets a junction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// Where its line begins.
    Start,
    /// Where its line ends.
    Finish,
}

/// A road's end at a junction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Arm {
    /// Which road.
    pub(crate) road: RoadIndex,
    /// Which of its ends.
    pub(crate) end: End,
    /// Whether it belongs to the lesser of the two roads that cross.
    pub(crate) minor: bool,
}

/// Who goes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Control {
    /// Lights; whether left turns have a phase of their own.
    Signals {
        /// Left turns have their own green.
        protected_left: bool,
    },
    /// The major road goes first; the minor one stops at a sign.
    StopSigns,
    /// The major road goes first; the minor one gives way.
    Priority,
}

/// Which way a connector turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Turn {
    /// To the left.
    Left,
    /// Ahead.
    Straight,
    /// To the right.
    Right,
}

impl Turn {
    /// The turn between two headings: straight up to 50 degrees.
    pub(crate) fn between(from: f64, to: f64) -> Self {
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
    /// The mouth of an arm: the pose of its line where the junction begins, looking away from the junction.
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

    /// Distances from an arm's line to the edges of its pavement, seen from the junction outwards: right, left.
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
        if arm.end == End::Finish { &road.forward } else { &road.backward }
    }

    /// Lanes that leave the junction at an arm, leftmost first.
    pub(crate) fn leaving(&self, arm: Arm) -> &[LaneId] {
        let road = &self.roads[arm.road];
        if arm.end == End::Finish { &road.backward } else { &road.forward }
    }

    /// Joins two roads end to start, lane by lane, across a short paved piece (nuPlan: a pass-through intersection).
    ///
    /// # Errors
    /// When the two ends coincide.
    pub(crate) fn join(&mut self, before: RoadIndex, after: RoadIndex) -> Result<(), GeometryError> {
        let arms =
            [Arm { road: before, end: End::Finish, minor: false }, Arm { road: after, end: End::Start, minor: false }];
        let junction = self.open_junction(&arms)?;
        for (from, to) in [(arms[0], arms[1]), (arms[1], arms[0])] {
            let (arriving, leaving) = (self.arriving(from).to_vec(), self.leaving(to).to_vec());
            let mut previous = None;
            for (&a, &b) in arriving.iter().zip(&leaving) {
                let line = connection(self.end_of(a), self.start_of(b));
                let passage = Passage { junction, rank: 9, stop_sign: false, conflicts: Vec::new() };
                let connector = self.connect(a, b, &line, passage)?;
                if let Some(left) = previous.replace(connector) {
                    self.adjoin(left, connector);
                }
            }
        }
        Ok(())
    }

    /// Begins a junction of these arms: its number; its area is the pavement between them.
    fn open_junction(&mut self, arms: &[Arm]) -> Result<usize, GeometryError> {
        let area = self.junction_area(arms)?;
        Ok(self.add_junction(area, arms.iter().map(|arm| arm.road).collect()))
    }

    /// Begins a junction of the given area that touches the given roads: its number.
    pub(super) fn add_junction(&mut self, area: Polygon, touching: Vec<RoadIndex>) -> usize {
        self.parts.intersections.push(area);
        self.touching.push(touching);
        self.touching.len() - 1
    }

    /// The pavement between the mouths, with rounded kerbs. The arms stand in counter-clockwise order.
    fn junction_area(&self, arms: &[Arm]) -> Result<Polygon, GeometryError> {
        /// How far the area reaches into each arm, so that no gap opens at the seam, metres.
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
            outline.extend(kerb(left, sides[(i + 1) % sides.len()][0]));
        }
        Polygon::new(outline)
    }

    /// Lays a crossing of three or four arms, which stand in counter-clockwise order.
    ///
    /// # Errors
    /// When the arms coincide.
    pub(crate) fn cross(&mut self, arms: &[Arm], control: Control, crosswalks: &[bool]) -> Result<(), GeometryError> {
        let junction = self.open_junction(arms)?;
        let mut movements = Vec::new();
        for (from_arm, &from) in arms.iter().enumerate() {
            for (a, b, turn, to_arm) in self.lane_pairs(arms, from_arm) {
                let line = connection(self.end_of(a), self.start_of(b));
                let rank = rank(control, from.minor, turn);
                let stop_sign = control == Control::StopSigns && from.minor;
                let connector =
                    self.connect(a, b, &line, Passage { junction, rank, stop_sign, conflicts: Vec::new() })?;
                let beside = movements.last().copied().filter(|&(m, to, lane): &(Movement, usize, LaneId)| {
                    m.turn == Turn::Straight && m.from_arm == from_arm && to == to_arm && lane != b
                });
                if let (Turn::Straight, Some((left, _, _))) = (turn, beside) {
                    self.adjoin(left.connector, connector);
                }
                movements.push((Movement { from_arm, minor: from.minor, turn, connector }, to_arm, b));
            }
            if matches!(control, Control::Signals { .. }) || (control == Control::StopSigns && from.minor) {
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
            self.parts.crosswalks.push(crossing_band(mouth, right, left)?);
        }
        Ok(())
    }

    /// Pairs of lanes that a crossing connects, from one arm, left turns first, leftmost first.
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
        let ways = |turn: Turn| exits.iter().any(|&(t, _)| t == turn);
        let count = arriving.len();
        // With three lanes or more the outer ones turn only, where there is somewhere to turn to.
        let left_only = usize::from(count >= 3 && ways(Turn::Left));
        let right_only = usize::from(count >= 4 && ways(Turn::Right));
        let mut pairs = Vec::new();
        for &(turn, to) in &exits {
            let leaving = self.leaving(arms[to]);
            let last = leaving.len() - 1;
            match turn {
                Turn::Left => pairs.push((arriving[0], leaving[0], turn, to)),
                Turn::Right => pairs.push((arriving[count - 1], leaving[last], turn, to)),
                Turn::Straight => {
                    for (i, &lane) in arriving.iter().enumerate().take(count - right_only).skip(left_only) {
                        if i <= last {
                            pairs.push((lane, leaving[i], turn, to));
                        }
                    }
                }
            }
        }
        // A lane that would lead nowhere takes the outermost way that its arm has.
        for (i, &lane) in arriving.iter().enumerate() {
            if pairs.iter().all(|p| p.0 != lane)
                && let Some(&(turn, to)) = exits.iter().max_by_key(|&&(turn, _)| (turn == Turn::Straight, turn))
            {
                let leaving = self.leaving(arms[to]);
                pairs.push((lane, leaving[i.min(leaving.len() - 1)], turn, to));
            }
        }
        pairs
    }
}

/// A crosswalk just behind the mouth of an arm, from kerb to kerb.
pub(super) fn crossing_band(mouth: Pose, right: f64, left: f64) -> Result<Polygon, GeometryError> {
    /// Distances of its edges from the mouth into the junction, metres.
    const NEAR: f64 = 1.5;
    const FAR: f64 = 4.5;
    let corner = |forward: f64, side: f64| mouth.to_map(Point::new(forward, side));
    Polygon::new([corner(-NEAR, left), corner(-FAR, left), corner(-FAR, -right), corner(-NEAR, -right)])
}

/// The rounded kerb between two arms' edges (both poses look away from the junction), without its two ends; empty when
/// the edges are nearly parallel.
pub(super) fn kerb(from: Pose, to: Pose) -> Vec<Point> {
    const SAMPLES: usize = 8;
    let Some(corner) = kerb_corner(from, to) else { return Vec::new() };
    let (a, b) = (from.position().coords, to.position().coords);
    (1..SAMPLES)
        .map(|k| k as f64 / SAMPLES as f64)
        .map(|t| Point::from(a * (1.0 - t).powi(2) + corner.coords * (2.0 * t * (1.0 - t)) + b * t.powi(2)))
        .collect()
}

/// Where two kerb lines meet inside the junction; both poses look away from it. `None` when they are nearly parallel.
fn kerb_corner(a: Pose, b: Pose) -> Option<Point> {
    let (u, w) = (a.direction(), b.direction());
    let cross = u.perp(&w);
    if cross.abs() < 0.3 {
        return None;
    }
    let along = (b.position() - a.position()).perp(&w) / cross;
    // The corner lies behind the mouth, towards the junction.
    (along < 0.0).then(|| a.position() + u * along)
}

/// Right of way: higher goes first.
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

/// Opposite arms share a phase; protected left turns get theirs before it.
fn signal_plan(movements: &[Movement], protected_left: bool) -> SignalPlan {
    /// Seconds of green for through traffic and for protected left turns.
    const THROUGH: f64 = 14.0;
    const LEFT: f64 = 8.0;
    let mut phases = Vec::new();
    for minor in [false, true] {
        let of = |left: bool| -> Vec<LaneId> {
            let wanted = |m: &&Movement| m.minor == minor && (!protected_left || (m.turn == Turn::Left) == left);
            movements.iter().filter(wanted).map(|m| m.connector).collect()
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
