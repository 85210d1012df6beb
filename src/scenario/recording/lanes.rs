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

/// Sources list neighbors from one vertex of a line to another, and the stretch before the first
/// vertex, after the last and between two neighbors is left out. A stretch up to this length counts
/// as listed, meters: lanes have a vertex every half meter.
/// Why: docs/decisions/147-lanes-beside-recorded-roads.md.
const UNLISTED: f64 = 1.1;

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
        close_gaps(&mut neighbors, self.length());
        neighbors
    }
}

/// Lets the neighbors of a lane with this length meet where the list leaves out [`UNLISTED`] or
/// less.
fn close_gaps(neighbors: &mut [Neighbor], length: f64) {
    let is_short = |from: f64, to: f64| to > from && to - from <= UNLISTED;
    let mut listed_to = 0.0;
    for place in 0..neighbors.len() {
        let next = neighbors.get(place + 1).map_or(length, |next| next.from_s);
        let one = &mut neighbors[place];
        if is_short(listed_to, one.from_s) {
            one.from_s = listed_to;
        }
        if is_short(one.to_s, next) {
            one.to_s = next;
        }
        listed_to = one.to_s;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::trace::Place;

    /// A lane to the east with a vertex every half meter.
    fn lane(id: i64, y: f64, left: Vec<Beside>) -> RecordedLane {
        let points: Vec<Place> = (0..=40)
            .map(|i| Place::new(0.5 * f64::from(i), y, 0.0))
            .collect();
        let trace = Trace::from_points(id, &points, Vector::zeros());
        RecordedLane {
            id,
            trace: trace.unwrap().unwrap(),
            flagged: false,
            speed_limit: None,
            entries: vec![],
            exits: vec![],
            neighbors: Sides {
                left,
                right: vec![],
            },
        }
    }

    /// The stretches of a lane of 20 m beside which neighbors are listed.
    fn listed(stretches: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let beside = stretches.iter().map(|&(from_s, to_s)| Beside {
            lane: 1,
            from_s,
            to_s,
        });
        let lanes = [lane(0, 0.0, beside.collect()), lane(1, 3.5, vec![])];
        let neighbors = lanes[0].neighbors_along(&lanes, Side::Left);
        neighbors.iter().map(|n| (n.from_s, n.to_s)).collect()
    }

    #[test]
    fn neighbors_meet_where_the_list_leaves_out_the_stretch_between_two_vertices() {
        assert_eq!(
            listed(&[(0.5, 7.5), (8.0, 19.0)]),
            [(0.0, 8.0), (8.0, 20.0)]
        );
        assert_eq!(
            listed(&[(3.0, 7.5), (12.0, 17.0)]),
            [(3.0, 7.5), (12.0, 17.0)],
            "nothing is beside the lane there"
        );
    }
}
