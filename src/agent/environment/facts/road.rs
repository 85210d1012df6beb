//! Facts of the map: kind of place, lanes, crosswalk, the other direction.

use super::{Ahead, LaneCount, LaneIndex, Oncoming, SceneType, VIEW_METERS, View, roundabout};
use crate::environment::lane_graph::{Centerline, GraphedScene};
use planagent_world::geometry::{Bounds, Point, Polygon, Polyline, Pose, wrap_angle};
use planagent_world::{Lane, LaneId, LaneMap, Neighbor, PACIFICA, SceneView};
use std::collections::BTreeSet;

/// A path that turns by more than this within the view is a curve, radians (15 degrees).
pub(crate) const CURVE: f64 = std::f64::consts::PI / 12.0;
/// Lateral reach for lanes of the other direction, meters.
pub const ONCOMING_REACH: f64 = 20.0;
/// Longitudinal reach for lanes of the other direction from the ego's center, meters.
const ABREAST: f64 = 5.0;
/// Lanes whose directions differ by more than this are opposite, radians (135 degrees).
const OPPOSITE: f64 = 3.0 * std::f64::consts::FRAC_PI_4;
/// Connectors cross when their directions differ by more than this, and by less than π minus this,
/// radians (30 degrees).
const ACROSS: f64 = std::f64::consts::FRAC_PI_6;
/// Spacing of the sampled points on the path, meters.
const STEP: f64 = 0.5;

/// The path from the ego's center to where it first leaves the view; `None` when the road ends
/// under the ego.
fn path_in_view(centerline: &Centerline, view: View) -> Option<Polyline> {
    let line = &centerline.path.centerline;
    let most = (line.length() - centerline.ego_s).clamp(0.0, VIEW_METERS);
    let ahead = (0..=(most / STEP) as u32)
        .map(|i| f64::from(i) * STEP)
        .take_while(|d| view.holds(line.point_at(centerline.ego_s + d)))
        .last()?;
    line.slice(centerline.ego_s, centerline.ego_s + ahead)
}

pub(super) fn scene_type(seen: GraphedScene<'_>, view: View) -> SceneType {
    let GraphedScene { scene, graph } = seen;
    if roundabout::ahead(scene.map, view) {
        return SceneType::Roundabout;
    }
    let Some(path) = path_in_view(graph.ego_lane(), view) else {
        return SceneType::Straight;
    };
    if meets_intersection(scene.map, graph.ego_lane(), &path) {
        return SceneType::Intersection;
    }
    let turn = turned(&path);
    if turn > CURVE {
        SceneType::CurveLeft
    } else if turn < -CURVE {
        SceneType::CurveRight
    } else {
        SceneType::Straight
    }
}

/// Sum of the heading changes along a line, radians, positive to the left.
fn turned(line: &Polyline) -> f64 {
    line.vertex_headings()
        .windows(2)
        .map(|w| wrap_angle(w[1] - w[0]))
        .sum()
}

/// Whether the path enters an intersection in which a connector leads elsewhere (an area around a
/// crosswalk alone does not look like one), or another connector crosses one of the path's.
fn meets_intersection(map: &LaneMap, centerline: &Centerline, path: &Polyline) -> bool {
    let places = path.resampled(STEP);
    let poses = places.vertex_poses();
    let bounds = Bounds::around(places.vertices());
    let mut entered = map.intersections_within(&bounds).filter_map(|area| {
        let entry = poses
            .iter()
            .copied()
            .find(|pose| area.contains(pose.position()))?;
        Some((area, entry))
    });
    entered.any(|(area, entry)| leads_elsewhere(map, area, entry))
        || lanes_under(centerline, path)
            .any(|lane| map[lane].is_connector() && crossed(map, &map[lane], path))
}

/// Whether a connector within the area runs across the direction in which the path enters it.
fn leads_elsewhere(map: &LaneMap, area: &Polygon, entry: Pose) -> bool {
    let connectors = map
        .lanes_near(entry.position(), VIEW_METERS / 2.0)
        .into_iter()
        .map(|id| &map[id]);
    connectors.filter(|lane| lane.is_connector()).any(|lane| {
        lane.centerline.vertex_poses().iter().any(|pose| {
            let turn = wrap_angle(pose.heading - entry.heading).abs();
            turn > ACROSS && turn < std::f64::consts::PI - ACROSS && area.contains(pose.position())
        })
    })
}

fn lanes_under<'a>(
    centerline: &'a Centerline,
    path: &Polyline,
) -> impl Iterator<Item = LaneId> + 'a {
    let (from, to) = (centerline.ego_s, centerline.ego_s + path.length());
    let ends = centerline
        .path
        .starts
        .iter()
        .skip(1)
        .copied()
        .chain(std::iter::once(f64::INFINITY));
    let spans = centerline
        .path
        .lanes
        .iter()
        .copied()
        .zip(centerline.path.starts.iter().copied().zip(ends));
    spans
        .filter(move |&(_, (start, end))| start <= to && end > from)
        .map(|(lane, _)| lane)
}

/// Whether a connector that neither starts nor ends with this one crosses the path.
fn crossed(map: &LaneMap, connector: &Lane, path: &Polyline) -> bool {
    let middle = path.point_at(path.length() / 2.0);
    map.lanes_near(middle, path.length())
        .into_iter()
        .map(|id| &map[id])
        .any(|other| {
            let apart =
                |own: &[LaneId], others: &[LaneId]| !own.iter().any(|lane| others.contains(lane));
            other.is_connector()
                && other.id != connector.id
                && apart(&connector.incoming, &other.incoming)
                && apart(&connector.outgoing, &other.outgoing)
                && lines_cross(&other.centerline, path)
        })
}

fn lines_cross(a: &Polyline, b: &Polyline) -> bool {
    let side = |p: Point, q: Point, r: Point| (q - p).perp(&(r - p));
    a.vertices().windows(2).any(|v| {
        b.vertices().windows(2).any(|w| {
            side(v[0], v[1], w[0]) * side(v[0], v[1], w[1]) < 0.0
                && side(w[0], w[1], v[0]) * side(w[0], w[1], v[1]) < 0.0
        })
    })
}

/// Lanes of the ego's direction at its place, and which of them is the ego's: neighbors of
/// neighbors.
pub(super) fn lanes_abreast(seen: GraphedScene<'_>) -> (LaneCount, LaneIndex) {
    let GraphedScene { scene, graph } = seen;
    let ego = graph.ego_lane();
    let lane = ego.path.lane_at(ego.ego_s);
    let left = count_beside(scene, lane, |lane| &lane.left);
    let right = count_beside(scene, lane, |lane| &lane.right);
    (
        LaneCount::from_count(left + 1 + right),
        LaneIndex::from_lanes_to_left(left),
    )
}

fn count_beside(scene: &SceneView<'_>, from: LaneId, side: impl Fn(&Lane) -> &[Neighbor]) -> usize {
    let ego = scene.ego.center().position();
    let mut seen = BTreeSet::from([from]);
    let mut lane = &scene.map[from];
    loop {
        let s = lane.centerline.project(ego).s;
        let beside = side(lane)
            .iter()
            .find(|neighbor| neighbor.from_s <= s && s <= neighbor.to_s);
        match beside {
            Some(neighbor) if seen.insert(neighbor.lane) => lane = &scene.map[neighbor.lane],
            _ => return seen.len() - 1,
        }
    }
}

pub(super) fn crosswalk(seen: GraphedScene<'_>, view: View) -> Ahead {
    let GraphedScene { scene, graph } = seen;
    let ego = graph.ego_lane();
    let line = &ego.path.centerline;
    let front = ego.ego_s + PACIFICA.length() / 2.0;
    let distance = (0..=(Ahead::FAR / STEP) as u32)
        .map(|i| f64::from(i) * STEP)
        .take_while(|d| front + d <= line.length())
        .map(|d| (d, line.point_at(front + d)))
        .find(|&(_, point)| view.holds(point) && scene.map.on_crosswalk(point))
        .map(|(d, _)| d);
    Ahead::from_distance(distance)
}

pub(super) fn oncoming(seen: GraphedScene<'_>) -> Oncoming {
    let GraphedScene { scene, graph } = seen;
    let center = scene.ego.center();
    let heading = graph
        .ego_lane()
        .path
        .centerline
        .heading_at(graph.ego_lane().ego_s);
    let found = scene
        .map
        .lanes_near(center.position(), ONCOMING_REACH.min(VIEW_METERS / 2.0))
        .into_iter()
        .any(|id| {
            let lane = &scene.map[id];
            let foot = lane.centerline.project(center.position());
            let local = center.to_local(foot.point);
            !lane.is_connector()
                && wrap_angle(foot.heading - heading).abs() > OPPOSITE
                && local.x.abs() <= ABREAST
                && local.y.abs() <= ONCOMING_REACH
        });
    if found { Oncoming::Yes } else { Oncoming::No }
}
