//! Intersections: clusters of connectors that cross, and the union of their areas.
//!
//! Connectors belong together when they cross, leave the same lane or enter the same one; a cluster in which none cross (a fork
//! of a freeway, a right turn) is no intersection, unless the source says so. Holes of the union are filled, unless a road edge
//! runs through one: then it is the island of a roundabout, and the connectors' areas stand for the intersection one by one.

use super::lanes::RecordedLane;
use super::trace::{Segments, Trace};
use crate::geometry::{Bounds, Polygon};
use std::collections::{BTreeMap, BTreeSet};

/// Connectors that belong together.
#[derive(Debug, Clone)]
pub(in crate::scenario) struct Cluster {
    /// Places of the connectors, in order.
    pub(in crate::scenario) lanes: Vec<usize>,
    /// Whether they make an intersection: by default, whether any of them cross.
    pub(in crate::scenario) intersection: bool,
}

/// All clusters, in order of their first connector.
pub(in crate::scenario) fn clusters(
    lanes: &[RecordedLane],
    connector: &[bool],
    crossings: &BTreeSet<(usize, usize)>,
) -> Vec<Cluster> {
    let mut root: Vec<usize> = (0..lanes.len()).collect();
    let siblings = lanes.iter().flat_map(|lane| [&lane.exits, &lane.entries]).flat_map(|ends| {
        let ends: Vec<usize> = ends.iter().copied().filter(|&lane| connector[lane]).collect();
        ends.windows(2).map(|pair| (pair[0], pair[1])).collect::<Vec<_>>()
    });
    for (a, b) in crossings.iter().copied().chain(siblings) {
        let (a, b) = (find(&mut root, a), find(&mut root, b));
        root[a.max(b)] = a.min(b);
    }
    let mut clusters: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for lane in (0..lanes.len()).filter(|&lane| connector[lane]) {
        clusters.entry(find(&mut root, lane)).or_default().push(lane);
    }
    let crossing: BTreeSet<usize> = crossings.iter().map(|&(a, _)| find(&mut root, a)).collect();
    clusters.into_iter().map(|(root, lanes)| Cluster { lanes, intersection: crossing.contains(&root) }).collect()
}

fn find(root: &mut [usize], mut item: usize) -> usize {
    while root[item] != item {
        root[item] = root[root[item]];
        item = root[item];
    }
    item
}

/// Pieces of a union under this are rounding, m².
const SPLINTER: f64 = 0.1;

/// The area of each cluster that makes an intersection, as one or more polygons.
pub(in crate::scenario) fn intersections(edges: &[Trace], clusters: &[Cluster], areas: &[Polygon]) -> Vec<Polygon> {
    let edges = Segments::of(edges);
    clusters
        .iter()
        .filter(|cluster| cluster.intersection)
        .flat_map(|cluster| {
            let members: Vec<Polygon> = cluster.lanes.iter().map(|&lane| areas[lane].clone()).collect();
            let mut filled = Polygon::union_of(&members);
            filled.retain(|outline| outline.area() > SPLINTER);
            let island = filled.iter().any(|outline| holds_island(outline, &members, &edges));
            if island { members } else { filled }
        })
        .collect()
}

/// Whether a road edge runs inside the outline well off every connector.
fn holds_island(outline: &Polygon, members: &[Polygon], edges: &Segments) -> bool {
    /// A kerb nearer than this to the connectors is their border, metres.
    const WELL_OFF: f64 = 1.0;
    let bounds: Bounds = outline.bounds();
    edges.within(&bounds).any(|edge| {
        outline.contains(edge.from)
            && outline.edge_distance(edge.from) > WELL_OFF
            && members.iter().all(|member| member.distance_to(edge.from) > WELL_OFF)
    })
}
