//! What is drivable beside lanes and connectors.
//!
//! Waymo gives road edges, not areas. From every station of every lane, to each side, one looks for the first road edge of the
//! same level: what lies between is road (shoulders, parking strips, bike lanes, turning bays), when the edge is at most
//! [`FARTHEST_EDGE`] away. Without an edge in reach the road ends where the lane does. In an intersection the look from a
//! connector ends at a road edge, or where it leaves the convex hull of the intersection's connectors: that closes the gaps
//! between them. Driveways are drivable as they are drawn.

use super::features::{LaneFeature, MapFeatures, Side};
use super::outline::{DEFAULT_HALF, Strip};
use super::trace::{Ray, Segments};
use crate::geometry::{Point, Polygon};
use std::collections::BTreeMap;

/// A road edge farther from a centreline than this bounds something else, metres: a lane's half, a bike lane, a parking strip and
/// a bay of the same width.
const FARTHEST_EDGE: f64 = 12.0;

/// The drivable area beside the lanes: a strip a lane, then the driveways.
pub(super) fn beside_lanes(map: &MapFeatures, clusters: &[Vec<usize>], areas: &[Polygon]) -> Vec<Polygon> {
    let edges = Segments::of(&map.edges);
    let hulls: Vec<Option<Polygon>> = clusters.iter().map(|cluster| hull(cluster, areas)).collect();
    let hull_of: BTreeMap<usize, &Polygon> = clusters
        .iter()
        .zip(&hulls)
        .flat_map(|(cluster, hull)| cluster.iter().filter_map(move |&lane| Some((lane, hull.as_ref()?))))
        .collect();
    let strips = map.lanes.iter().enumerate().flat_map(|(place, lane)| {
        let hull = hull_of.get(&place).copied();
        Strip::measured(lane, |side, s| width_of_road(lane, side, s, &edges, hull)).areas(lane)
    });
    strips.chain(map.driveways.iter().cloned()).collect()
}

fn hull(cluster: &[usize], areas: &[Polygon]) -> Option<Polygon> {
    let points: Vec<Point> = cluster.iter().flat_map(|&lane| areas[lane].ring()).copied().collect();
    Polygon::convex_hull(&points).ok()
}

/// Metres of road from the centreline to one side.
fn width_of_road(lane: &LaneFeature, side: Side, s: f64, edges: &Segments, hull: Option<&Polygon>) -> f64 {
    let from = lane.trace.line.point_at(s);
    let direction = side.of(lane.trace.direction_at(s));
    let ray = Ray { from, direction, height: lane.trace.height_at(s), reach: FARTHEST_EDGE };
    let out_of_hull = hull.filter(|hull| hull.contains(from)).and_then(|hull| way_out(hull, &ray));
    let reach = out_of_hull.unwrap_or(0.0).max(FARTHEST_EDGE);
    let edge = edges.first_hit(&Ray { reach, ..ray }, |_| true);
    match (edge, out_of_hull) {
        (Some(edge), Some(out)) if edge > FARTHEST_EDGE => edge.min(out),
        (Some(edge), _) => edge,
        (None, Some(out)) => out.max(DEFAULT_HALF),
        (None, None) => DEFAULT_HALF,
    }
}

/// Distance along a ray from inside a convex polygon to its border.
fn way_out(hull: &Polygon, ray: &Ray) -> Option<f64> {
    let unlimited = Ray { reach: f64::MAX, ..*ray };
    hull.edges().filter_map(|(from, to)| unlimited.meets(from, to)).max_by(f64::total_cmp)
}
