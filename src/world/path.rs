//! Paths along lanes.

use super::{LaneId, LaneMap, Route};
use crate::geometry::{Polyline, wrap_angle};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// A chain of connected lanes with its centerline in one piece.
#[derive(Debug, Clone, PartialEq)]
pub struct LanePath {
    /// The lanes in driving order.
    pub lanes: Vec<LaneId>,
    /// Arc length on [`Self::centerline`] at which each lane begins, meters.
    pub starts: Vec<f64>,
    /// Their centerlines joined.
    pub centerline: Polyline,
}

impl LanePath {
    /// Joins a chain of lanes; `None` when it is empty.
    pub fn from_lanes(map: &LaneMap, lanes: Vec<LaneId>) -> Option<Self> {
        let (&first, rest) = lanes.split_first()?;
        let mut starts = vec![0.0];
        let mut centerline = map[first].centerline.clone();
        for &lane in rest {
            starts.push(centerline.length());
            centerline = centerline.joined(&map[lane].centerline);
        }
        Some(Self {
            lanes,
            starts,
            centerline,
        })
    }

    /// The path from the start of `first` that stays on the route as long as possible, then follows
    /// the straightest successors, for at least `length` meters or until a dead end.
    pub fn along(map: &LaneMap, route: &Route, first: LaneId, length: f64) -> Self {
        let mut lanes = longest_on_route(map, &route.lanes(map), first);
        let mut covered: f64 = lanes
            .iter()
            .map(|&lane| map[lane].centerline.length())
            .sum();
        while covered < length {
            let Some(next) = lanes
                .last()
                .and_then(|&last| straightest_successor(map, last))
            else {
                break;
            };
            if lanes.contains(&next) {
                break;
            }
            covered += map[next].centerline.length();
            lanes.push(next);
        }
        while lanes.len() > 1 && covered - map[lanes[lanes.len() - 1]].centerline.length() >= length
        {
            covered -= map[lanes[lanes.len() - 1]].centerline.length();
            lanes.pop();
        }
        Self::from_lanes(map, lanes).expect("the chain begins with the first lane")
    }

    /// The lane at arc length `s` of the joined centerline (clamped).
    #[inline]
    pub fn lane_at(&self, s: f64) -> LaneId {
        let place = self
            .starts
            .partition_point(|&start| start <= s)
            .saturating_sub(1);
        self.lanes[place]
    }
}

/// Of the chains from `first` through lanes of the route, the one with most lanes; the first found
/// wins ties.
fn longest_on_route(map: &LaneMap, route_lanes: &BTreeSet<LaneId>, first: LaneId) -> Vec<LaneId> {
    let mut parent: BTreeMap<LaneId, LaneId> = BTreeMap::new();
    let mut queue = VecDeque::from([first]);
    let mut last = first;
    while let Some(lane) = queue.pop_front() {
        last = lane;
        let mut onward: Vec<LaneId> = map[lane]
            .outgoing
            .iter()
            .copied()
            .filter(|l| route_lanes.contains(l))
            .collect();
        onward.sort_by(|a, b| bend(map, *a).total_cmp(&bend(map, *b)));
        for next in onward {
            if next != first && !parent.contains_key(&next) {
                parent.insert(next, lane);
                queue.push_back(next);
            }
        }
    }
    let mut lanes = vec![last];
    while let Some(&before) = parent.get(&lanes[lanes.len() - 1]) {
        lanes.push(before);
    }
    lanes.reverse();
    lanes
}

/// Angle between the start and the end of a lane, radians, without sign.
fn bend(map: &LaneMap, lane: LaneId) -> f64 {
    let line = &map[lane].centerline;
    wrap_angle(line.heading_at(line.length()) - line.heading_at(0.0)).abs()
}

/// The successor with the smallest angle.
fn straightest_successor(map: &LaneMap, lane: LaneId) -> Option<LaneId> {
    map[lane]
        .outgoing
        .iter()
        .copied()
        .min_by(|a, b| bend(map, *a).total_cmp(&bend(map, *b)))
}
