//! Crossings of lanes, and intersections: clusters of connectors that cross, and the union of their
//! areas.
//!
//! Connectors are in one cluster if they cross, leave the same lane or enter the same lane. A
//! cluster without a crossing (a fork of a freeway, a right turn) is no intersection, unless the
//! source says so. Holes of the union are filled. If a road edge runs through a hole, it is the
//! island of a roundabout, and the areas of the connectors are the intersection.

use super::lanes::RecordedLane;
use super::trace::{SAME_LEVEL, Segments, Trace};
use planagent_world::geometry::{Bounds, Point, Polygon};
use std::collections::{BTreeMap, BTreeSet};

/// Centerlines that meet at a smaller angle merge or run against each other, radians.
const CROSSING_ANGLE: f64 = std::f64::consts::PI / 12.0;

/// Pairs of lanes (smaller index first) whose centerlines cross on one level at 15° to 165°.
pub(crate) fn crossings(lanes: &[RecordedLane]) -> BTreeSet<(usize, usize)> {
    let segments = Segments::from_traces(lanes.iter().map(|lane| &lane.trace));
    let mut pairs = BTreeSet::new();
    for a in segments.list() {
        let along = a.to - a.from;
        for b in segments
            .within(&Bounds::around(&[a.from, a.to]))
            .filter(|b| b.owner > a.owner)
        {
            let across = b.to - b.from;
            let angle = along.perp(&across).atan2(along.dot(&across)).abs();
            // Lanes that follow each other share a point and do not cross, however sharp the bend.
            let follow =
                lanes[a.owner].exits.contains(&b.owner) || lanes[b.owner].exits.contains(&a.owner);
            let steep = angle > CROSSING_ANGLE && angle < std::f64::consts::PI - CROSSING_ANGLE;
            if steep
                && !follow
                && (a.height - b.height).abs() < SAME_LEVEL
                && cross(a.from, a.to, b.from, b.to)
            {
                pairs.insert((a.owner, b.owner));
            }
        }
    }
    pairs
}

/// True if two segments cross. A line through a vertex crosses one of the two segments that meet
/// there.
fn cross(a: Point, b: Point, c: Point, d: Point) -> bool {
    let left = |p: Point, q: Point, r: Point| (q - p).perp(&(r - p)) > 0.0;
    left(c, d, a) != left(c, d, b) && left(a, b, c) != left(a, b, d)
}

/// Connectors of one junction.
#[derive(Debug, Clone)]
pub(crate) struct Cluster {
    /// Indices of the connectors, in order.
    pub(crate) lanes: Vec<usize>,
    /// True if they form an intersection: by default, if any of them cross.
    pub(crate) intersection: bool,
}

/// All clusters in order of their first connector.
pub(crate) fn clusters(
    lanes: &[RecordedLane],
    connector: &[bool],
    crossings: &BTreeSet<(usize, usize)>,
) -> Vec<Cluster> {
    let mut root: Vec<usize> = (0..lanes.len()).collect();
    let siblings = lanes
        .iter()
        .flat_map(|lane| [&lane.exits, &lane.entries])
        .flat_map(|ends| {
            let ends: Vec<usize> = ends
                .iter()
                .copied()
                .filter(|&lane| connector[lane])
                .collect();
            ends.windows(2)
                .map(|pair| (pair[0], pair[1]))
                .collect::<Vec<_>>()
        });
    for (a, b) in crossings.iter().copied().chain(siblings) {
        let (a, b) = (find(&mut root, a), find(&mut root, b));
        // The smallest member is the root, which gives clusters the order of their first connector.
        root[a.max(b)] = a.min(b);
    }
    let mut clusters: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for lane in (0..lanes.len()).filter(|&lane| connector[lane]) {
        clusters
            .entry(find(&mut root, lane))
            .or_default()
            .push(lane);
    }
    let crossing: BTreeSet<usize> = crossings.iter().map(|&(a, _)| find(&mut root, a)).collect();
    clusters
        .into_iter()
        .map(|(root, lanes)| Cluster {
            lanes,
            intersection: crossing.contains(&root),
        })
        .collect()
}

fn find(root: &mut [usize], mut item: usize) -> usize {
    while root[item] != item {
        root[item] = root[root[item]];
        item = root[item];
    }
    item
}

/// Smaller pieces of a union are rounding, m².
const MIN_AREA: f64 = 0.1;

/// The area of each intersection, as one or more polygons.
pub(crate) fn intersections(
    edges: &[Trace],
    clusters: &[Cluster],
    areas: &[Polygon],
) -> Vec<Polygon> {
    let edges = Segments::from_traces(edges);
    clusters
        .iter()
        .filter(|cluster| cluster.intersection)
        .flat_map(|cluster| {
            let members: Vec<Polygon> = cluster
                .lanes
                .iter()
                .map(|&lane| areas[lane].clone())
                .collect();
            let mut filled = Polygon::union_of(&members);
            filled.retain(|outline| outline.area() > MIN_AREA);
            let island = filled
                .iter()
                .any(|outline| holds_island(outline, &members, &edges));
            if island { members } else { filled }
        })
        .collect()
}

/// True if a road edge runs inside the outline, well off every connector.
fn holds_island(outline: &Polygon, members: &[Polygon], edges: &Segments) -> bool {
    /// A curb nearer than this to the connectors is their border, meters.
    const WELL_OFF: f64 = 1.0;
    let bounds: Bounds = outline.bounds();
    edges.within(&bounds).any(|edge| {
        outline.contains(edge.from)
            && outline.edge_distance(edge.from) > WELL_OFF
            && members
                .iter()
                .all(|member| member.distance_to(edge.from) > WELL_OFF)
    })
}
