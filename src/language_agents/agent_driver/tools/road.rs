//! The map as the tools see it. The original looks them up in rasters of half a meter; here the lane
//! map itself gives the same answers.

use super::REACH;
use planagent_world::geometry::Point;
use planagent_world::{LaneId, SceneView};
use std::fmt::Write;

/// Steps in which the edge of the road is looked for, meters: the original's cells.
const CELL: f64 = 0.5;
/// The edge of the road is looked for so far, meters.
const EDGE_REACH: f64 = 25.0;
/// A line within this distance is at a place, meters.
const ON_LINE: f64 = 0.5;

/// The place in the map of one to the right and ahead of the ego.
fn in_map(scene: &SceneView<'_>, (x, y): (f64, f64)) -> Point {
    scene.ego.center().to_map(Point::new(y, -x))
}

/// A line of text for each place.
fn lines(locations: &[(f64, f64)], line: impl Fn((f64, f64)) -> String) -> String {
    let mut text = String::new();
    for &(x, y) in locations {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "({x:.2},{y:.2}): {}", line((x, y)));
    }
    if text.is_empty() {
        "no place was asked about".to_owned()
    } else {
        text.trim_end().to_owned()
    }
}

pub(super) fn drivable_at(scene: &SceneView<'_>, locations: &[(f64, f64)]) -> String {
    lines(locations, |place| {
        let drivable = scene.map.is_drivable(in_map(scene, place));
        if drivable { "drivable" } else { "not drivable" }.to_owned()
    })
}

pub(super) fn line_at(scene: &SceneView<'_>, locations: &[(f64, f64)]) -> String {
    lines(locations, |place| {
        let point = in_map(scene, place);
        let beside = [-ON_LINE, ON_LINE].map(|aside| (place.0 + aside, place.1));
        let [left, right] = beside.map(|place| scene.map.is_drivable(in_map(scene, place)));
        let dividers = dividers(scene, place);
        let on_divider = dividers
            .into_iter()
            .flatten()
            .any(|distance| distance <= ON_LINE);
        if scene.map.on_crosswalk(point) {
            "crosswalk"
        } else if left != right {
            "boundary"
        } else if on_divider {
            "divider"
        } else {
            "none"
        }
        .to_owned()
    })
}

pub(super) fn shoulder_at(scene: &SceneView<'_>, locations: &[(f64, f64)]) -> String {
    lines(locations, |place| {
        if !scene.map.is_drivable(in_map(scene, place)) {
            return "not on the road".to_owned();
        }
        let [left, right] = [-1.0, 1.0].map(|side| edge(scene, place, side));
        format!("left edge {}, right edge {}", meters(left), meters(right))
    })
}

pub(super) fn divider_at(scene: &SceneView<'_>, locations: &[(f64, f64)]) -> String {
    lines(locations, |place| {
        let [left, right] = dividers(scene, place);
        format!(
            "left divider {}, right divider {}",
            meters(left),
            meters(right)
        )
    })
}

fn meters(distance: Option<f64>) -> String {
    distance.map_or_else(|| "none".to_owned(), |meters| format!("in {meters:.2} m"))
}

/// Meters to where the road ends to a side (−1 is the left) in the ego's frame.
fn edge(scene: &SceneView<'_>, (x, y): (f64, f64), side: f64) -> Option<f64> {
    let steps = (EDGE_REACH / CELL) as usize;
    (1..=steps)
        .map(|step| step as f64 * CELL)
        .find(|meters| !scene.map.is_drivable(in_map(scene, (x + side * meters, y))))
}

/// Meters to the dividers to the left and right of a place: halfway to the centerlines of the lanes
/// beside.
fn dividers(scene: &SceneView<'_>, place: (f64, f64)) -> [Option<f64>; 2] {
    let point = in_map(scene, place);
    let lanes = scene.map.lanes_at(point);
    let mut pose = scene.ego.center();
    (pose.x, pose.y) = (point.x, point.y);
    let Some(lane) = scene.map.best_fit(&lanes, pose) else {
        return [None, None];
    };
    let lateral = |lane: LaneId| scene.map[lane].centerline.project(point).lateral;
    let own = scene.map[lane].centerline.project(point);
    let to = |beside: Option<LaneId>| {
        let width = own.lateral - lateral(beside?);
        Some((width / 2.0 - own.lateral).abs())
    };
    let on = &scene.map[lane];
    [to(on.left_at(own.s)), to(on.right_at(own.s))]
}

pub(super) fn nearest_crosswalk(scene: &SceneView<'_>) -> String {
    let center = scene.ego.center();
    let ahead = scene
        .map
        .crosswalks_near(center.position(), REACH)
        .map(|crosswalk| center.to_local(crosswalk.centroid()))
        .filter(|local| local.x >= 0.0);
    let nearest = ahead.min_by(|a, b| a.coords.norm().total_cmp(&b.coords.norm()));
    nearest.map_or_else(
        || "no crosswalk is ahead".to_owned(),
        |local| {
            format!(
                "the nearest crosswalk is at ({:.2},{:.2})",
                -local.y, local.x
            )
        },
    )
}
