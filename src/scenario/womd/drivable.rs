//! The drivable area beside lanes and connectors.
//!
//! Waymo records road edges, not areas. A ray from every station of a lane to each side finds the
//! first road edge on the same level. If the edge is at most [`MAX_EDGE_DISTANCE`] away, the area
//! between is road: shoulders, parking strips, bike lanes, turning bays. Without an edge in reach,
//! the road ends at the last lane in reach, or else at the border of the lane itself. Rays from a
//! connector that crosses, leaves or meets others extend to a road edge or to the convex hull of
//! them all, which closes the gaps between them. Driveways are drivable as recorded.

use super::features::MapFeatures;
use super::outline::{DEFAULT_HALF, Strip};
use crate::recording::junctions::Cluster;
use crate::recording::lanes::{RecordedLane, Side};
use crate::recording::trace::{Ray, Segments};
use planagent_world::geometry::{Point, Polygon};
use std::collections::BTreeMap;

/// Maximum distance of a road edge from a centerline, meters: half a lane, a bike lane, a parking
/// strip and a bay of the same width.
const MAX_EDGE_DISTANCE: f64 = 12.0;

/// The drivable area beside the lanes: a strip per lane, then the driveways.
pub(super) fn beside_lanes(
    map: &MapFeatures,
    clusters: &[Cluster],
    areas: &[Polygon],
) -> Vec<Polygon> {
    let edges = Segments::from_traces(&map.edges);
    let centerlines = Segments::from_traces(map.lanes.iter().map(|lane| &lane.trace));
    let hulls: Vec<Option<Polygon>> = clusters
        .iter()
        .map(|cluster| hull(&cluster.lanes, areas))
        .collect();
    let hull_of: BTreeMap<usize, &Polygon> = clusters
        .iter()
        .zip(&hulls)
        .flat_map(|(cluster, hull)| {
            cluster
                .lanes
                .iter()
                .filter_map(move |&lane| Some((lane, hull.as_ref()?)))
        })
        .collect();
    let strips = map.lanes.iter().enumerate().flat_map(|(place, lane)| {
        let hull = hull_of.get(&place).copied();
        // The last lane on the ray and not the first: the road goes on to the outermost lane.
        let other_lane = |ray: &Ray| centerlines.last_hit(ray, |other| other.owner != place);
        Strip::measured(lane, |side, s| {
            width_of_road(lane, side, s, &edges, other_lane, hull)
        })
        .pieces(lane)
    });
    strips.chain(map.driveways.iter().cloned()).collect()
}

fn hull(cluster: &[usize], areas: &[Polygon]) -> Option<Polygon> {
    let points: Vec<Point> = cluster
        .iter()
        .flat_map(|&lane| areas[lane].ring())
        .copied()
        .collect();
    Polygon::convex_hull(&points).ok()
}

/// Width of the road from the centerline to one side, meters.
fn width_of_road(
    lane: &RecordedLane,
    side: Side,
    s: f64,
    edges: &Segments,
    other_lane: impl Fn(&Ray) -> Option<f64>,
    hull: Option<&Polygon>,
) -> f64 {
    let from = lane.trace.line.point_at(s);
    let direction = side.normal(lane.trace.direction_at(s));
    let ray = Ray {
        from,
        direction,
        height: lane.trace.height_at(s),
        reach: MAX_EDGE_DISTANCE,
    };
    let edge = |reach: f64| edges.first_hit(&Ray { reach, ..ray }, |_| true);
    if let Some(edge) = edge(MAX_EDGE_DISTANCE) {
        return edge;
    }
    let out_of_hull = hull
        .filter(|hull| hull.contains(from))
        .and_then(|hull| exit_of_hull(hull, &ray));
    let open = [out_of_hull, other_lane(&ray)]
        .into_iter()
        .flatten()
        .fold(DEFAULT_HALF, f64::max);
    edge(open).unwrap_or(open)
}

/// Distance along a ray from inside a convex polygon to its border.
fn exit_of_hull(hull: &Polygon, ray: &Ray) -> Option<f64> {
    let unlimited = Ray {
        reach: f64::MAX,
        ..*ray
    };
    hull.edges()
        .filter_map(|(from, to)| unlimited.meets(from, to))
        .max_by(f64::total_cmp)
}
