//! The map layers of the BEV map: lanes, crosswalks, centerlines.

use super::canvas::Canvas;
use super::{BevElement, Palette};
use planagent_world::geometry::{Bounds, Point, Polyline};
use planagent_world::{Lane, LaneMap};

/// Width of a centerline, meters.
const LINE_WIDTH_M: f64 = 0.2;
/// Minimum width of a line, pixels.
const MIN_LINE_PX: f64 = 1.0;
/// Distance between arrowheads, meters.
const HEAD_SPACING_M: f64 = 10.0;
/// Length and width of such an arrowhead, meters.
const HEAD_M: f64 = 1.5;
/// Minimum length and width of an arrowhead, pixels: enough to tell its point from its base.
const MIN_HEAD_PX: f64 = 4.0;

pub(super) fn draw(canvas: &mut Canvas, map: &LaneMap) {
    let (center, reach) = (canvas.center().position(), canvas.reach());
    let lanes: Vec<&Lane> = map
        .lanes_near(center, reach)
        .into_iter()
        .map(|id| &map[id])
        .collect();
    canvas.areas(
        lanes.iter().map(|lane| &lane.polygon),
        Palette::color(BevElement::Lanes),
    );
    canvas.areas(
        map.crosswalks_near(center, reach),
        Palette::color(BevElement::Crosswalks),
    );
    let width = (LINE_WIDTH_M * canvas.view().scale()).max(MIN_LINE_PX);
    let lines = lanes.iter().map(|lane| lane.centerline.vertices());
    canvas.lines(lines, width, Palette::color(BevElement::Centerlines));
    let size = HEAD_M.max(MIN_HEAD_PX / canvas.view().scale());
    // Connectors cross each other; heads there would hide each other.
    let heads: Vec<[Point; 3]> = lanes
        .iter()
        .filter(|lane| !lane.is_connector())
        .flat_map(|lane| heads(&lane.centerline, size, Bounds::square(center, reach)))
        .collect();
    canvas.outlines(heads, Palette::color(BevElement::Centerlines));
}

/// Arrowheads along a line in its direction, as far as they lie within `bounds`.
fn heads(line: &Polyline, size: f64, bounds: Bounds) -> Vec<[Point; 3]> {
    let count = (line.length() / HEAD_SPACING_M).round().max(1.0);
    let spacing = line.length() / count;
    (0..count as usize)
        .map(|i| line.pose_at((i as f64 + 0.5) * spacing))
        .filter(|pose| bounds.contains(pose.position()))
        .map(|pose| {
            [(0.5, 0.0), (-0.5, 0.5), (-0.5, -0.5)]
                .map(|(x, y)| pose.to_map(Point::new(x * size, y * size)))
        })
        .collect()
}
