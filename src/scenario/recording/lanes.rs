//! Recorded lanes in local coordinates. Relations between them are indices.

use super::trace::Trace;
use planagent_world::geometry::{Vector, wrap_angle};
use planagent_world::{LaneId, Neighbor};
use std::collections::{BTreeMap, BTreeSet};

/// The two sides of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Left,
    Right,
}

impl Side {
    pub(crate) const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The unit vector to this side of a direction.
    pub(crate) fn normal(self, direction: Vector) -> Vector {
        let left = Vector::new(-direction.y, direction.x);
        match self {
            Self::Left => left,
            Self::Right => -left,
        }
    }
}

/// A value for each side.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sides<T> {
    pub(crate) left: T,
    pub(crate) right: T,
}

impl<T> Sides<T> {
    pub(crate) fn at(&self, side: Side) -> &T {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    pub(crate) fn each(mut make: impl FnMut(Side) -> T) -> Self {
        Self {
            left: make(Side::Left),
            right: make(Side::Right),
        }
    }
}

/// A lane for motor vehicles as recorded.
#[derive(Debug, Clone)]
pub(crate) struct RecordedLane {
    pub(crate) id: i64,
    pub(crate) trace: Trace,
    /// True if the source marks it as a connector.
    pub(crate) flagged: bool,
    pub(crate) speed_limit: Option<f64>,
    pub(crate) entries: Vec<usize>,
    pub(crate) exits: Vec<usize>,
    pub(crate) neighbors: Sides<Vec<Beside>>,
}

impl RecordedLane {
    pub(crate) fn length(&self) -> f64 {
        self.trace.line.length()
    }

    /// Neighbors of the same direction, in driving order.
    pub(crate) fn neighbors_along(&self, lanes: &[Self], side: Side) -> Vec<Neighbor> {
        let listed = self
            .neighbors
            .at(side)
            .iter()
            .filter(|beside| beside.one_direction(&self.trace, lanes));
        let mut neighbors: Vec<Neighbor> = listed
            .map(|beside| Neighbor {
                lane: LaneId(beside.lane as u32),
                from_s: beside.from_s,
                to_s: beside.to_s,
            })
            .collect();
        neighbors.sort_by(|a, b| a.from_s.total_cmp(&b.from_s).then(a.lane.cmp(&b.lane)));
        neighbors
    }
}

/// A neighbor of a part of a lane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Beside {
    pub(crate) lane: usize,
    /// Arc lengths on the lane, not on the neighbor.
    pub(crate) from_s: f64,
    pub(crate) to_s: f64,
}

impl Beside {
    /// True if it runs in the direction of `trace`, judged in the middle of the common part.
    pub(crate) fn one_direction(&self, trace: &Trace, lanes: &[RecordedLane]) -> bool {
        let middle = trace.line.pose_at(f64::midpoint(self.from_s, self.to_s));
        let other = lanes[self.lane].trace.line.project(middle.position());
        wrap_angle(other.heading - middle.heading).abs() < std::f64::consts::FRAC_PI_4
    }
}

/// Indices of the source's lanes.
#[derive(Debug, Default)]
pub(crate) struct Places<'a> {
    /// By id.
    pub(crate) lanes: BTreeMap<i64, usize>,
    /// Lanes without length, and the ids of the lanes behind them. Lanes that lead into them lead
    /// there.
    pub(crate) passages: BTreeMap<i64, &'a [i64]>,
}

/// Ids of the lanes at the ends of a lane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ends<'a> {
    pub(crate) entries: &'a [i64],
    pub(crate) exits: &'a [i64],
}

impl Places<'_> {
    /// Pairs of lanes of which the first leads to the second, as stated by either. Unknown ids are
    /// dropped.
    pub(crate) fn joints<'a>(&self, ends: impl Iterator<Item = Ends<'a>>) -> Joints {
        let mut joints: BTreeSet<(usize, usize)> = BTreeSet::new();
        for (place, ends) in ends.enumerate() {
            joints.extend(
                self.reached(ends.exits)
                    .into_iter()
                    .map(|exit| (place, exit)),
            );
            let entries = ends.entries.iter().filter_map(|id| self.lanes.get(id));
            joints.extend(entries.map(|&entry| (entry, place)));
        }
        joints.retain(|(from, to)| from != to);
        Joints(joints)
    }

    /// Lanes with a length behind these ids.
    fn reached(&self, exits: &[i64]) -> BTreeSet<usize> {
        let mut found = BTreeSet::new();
        let mut seen = BTreeSet::new();
        let mut open: Vec<i64> = exits.to_vec();
        while let Some(id) = open.pop() {
            if let Some(&place) = self.lanes.get(&id) {
                found.insert(place);
            } else if let Some(onward) = self.passages.get(&id).filter(|_| seen.insert(id)) {
                open.extend(onward.iter());
            }
        }
        found
    }
}

/// Pairs of lanes of which the first leads to the second.
#[derive(Debug)]
pub(crate) struct Joints(BTreeSet<(usize, usize)>);

impl Joints {
    pub(crate) fn before(&self, lane: usize) -> Vec<usize> {
        self.0
            .iter()
            .filter(|(_, to)| *to == lane)
            .map(|(from, _)| *from)
            .collect()
    }

    pub(crate) fn after(&self, lane: usize) -> Vec<usize> {
        self.0
            .iter()
            .filter(|(from, _)| *from == lane)
            .map(|(_, to)| *to)
            .collect()
    }
}
