//! Lanes as recorded, in local coordinates, with the relations between them resolved to places in a list.

use super::trace::Trace;
use crate::geometry::{Vector, wrap_angle};
use crate::world::{LaneId, Neighbor};
use std::collections::{BTreeMap, BTreeSet};

/// The two sides of a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::scenario) enum Side {
    Left,
    Right,
}

impl Side {
    pub(in crate::scenario) const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// The unit vector to this side of a direction.
    pub(in crate::scenario) fn of(self, direction: Vector) -> Vector {
        let left = Vector::new(-direction.y, direction.x);
        match self {
            Self::Left => left,
            Self::Right => -left,
        }
    }
}

/// A value for each side.
#[derive(Debug, Clone, Default)]
pub(in crate::scenario) struct Sides<T> {
    pub(in crate::scenario) left: T,
    pub(in crate::scenario) right: T,
}

impl<T> Sides<T> {
    pub(in crate::scenario) fn at(&self, side: Side) -> &T {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    pub(in crate::scenario) fn each(mut make: impl FnMut(Side) -> T) -> Self {
        Self { left: make(Side::Left), right: make(Side::Right) }
    }
}

/// A lane for motor vehicles as recorded.
#[derive(Debug, Clone)]
pub(in crate::scenario) struct RecordedLane {
    /// Its id in the source.
    pub(in crate::scenario) id: i64,
    /// The centreline, with heights.
    pub(in crate::scenario) trace: Trace,
    /// Whether the source itself says that it is a way across an intersection.
    pub(in crate::scenario) flagged: bool,
    /// m/s.
    pub(in crate::scenario) speed_limit: Option<f64>,
    /// Places of the lanes that lead into it.
    pub(in crate::scenario) entries: Vec<usize>,
    /// Places of the lanes that it leads to.
    pub(in crate::scenario) exits: Vec<usize>,
    /// Lanes beside it.
    pub(in crate::scenario) neighbors: Sides<Vec<Beside>>,
}

impl RecordedLane {
    /// Metres.
    pub(in crate::scenario) fn length(&self) -> f64 {
        self.trace.line.length()
    }

    /// Lanes beside it that run in its direction there, in driving order.
    pub(in crate::scenario) fn neighbors_along(&self, lanes: &[Self], side: Side) -> Vec<Neighbor> {
        let listed = self.neighbors.at(side).iter().filter(|beside| beside.one_direction(&self.trace, lanes));
        let mut neighbors: Vec<Neighbor> = listed
            .map(|beside| Neighbor { lane: LaneId(beside.lane as u32), from_s: beside.from_s, to_s: beside.to_s })
            .collect();
        neighbors.sort_by(|a, b| a.from_s.total_cmp(&b.from_s).then(a.lane.cmp(&b.lane)));
        neighbors
    }
}

/// A lane beside a part of another.
#[derive(Debug, Clone, Copy)]
pub(in crate::scenario) struct Beside {
    /// Its place.
    pub(in crate::scenario) lane: usize,
    /// Arc lengths on the lane that it is beside.
    pub(in crate::scenario) from_s: f64,
    pub(in crate::scenario) to_s: f64,
}

impl Beside {
    /// Whether it runs in the direction of the lane along `trace`, in the middle of their common way.
    pub(in crate::scenario) fn one_direction(&self, trace: &Trace, lanes: &[RecordedLane]) -> bool {
        let middle = trace.line.pose_at(f64::midpoint(self.from_s, self.to_s));
        let other = lanes[self.lane].trace.line.project(middle.position());
        wrap_angle(other.heading - middle.heading).abs() < std::f64::consts::FRAC_PI_4
    }
}

/// Where the lanes of the source went.
#[derive(Debug, Default)]
pub(in crate::scenario) struct Places<'a> {
    /// Place of each lane by its id.
    pub(in crate::scenario) lanes: BTreeMap<i64, usize>,
    /// Lanes without length, with the ids of what they lead to: what leads into them leads there.
    pub(in crate::scenario) passages: BTreeMap<i64, &'a [i64]>,
}

/// What a lane of the source says about its ends.
#[derive(Debug, Clone, Copy)]
pub(in crate::scenario) struct Ends<'a> {
    /// Ids of the lanes that lead into it.
    pub(in crate::scenario) entries: &'a [i64],
    /// Ids of the lanes that it leads to.
    pub(in crate::scenario) exits: &'a [i64],
}

impl Places<'_> {
    /// Pairs of places of which the first leads to the second, be it the one or the other that says so. Ids that the source
    /// does not contain are dropped.
    pub(in crate::scenario) fn joints<'a>(&self, ends: impl Iterator<Item = Ends<'a>>) -> BTreeSet<(usize, usize)> {
        let mut joints: BTreeSet<(usize, usize)> = BTreeSet::new();
        for (place, ends) in ends.enumerate() {
            joints.extend(self.reached(ends.exits).into_iter().map(|exit| (place, exit)));
            let entries = ends.entries.iter().filter_map(|id| self.lanes.get(id));
            joints.extend(entries.map(|&entry| (entry, place)));
        }
        joints.retain(|(from, to)| from != to);
        joints
    }

    /// Lanes with length that are reached over the given ones.
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
