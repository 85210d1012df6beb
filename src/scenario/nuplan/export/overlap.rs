//! Areas of inserted lanes, cut so that at most one lane holds a point, as the devkit's metrics
//! assume.
//!
//! A lane that closes the open end of a connector often lies on a lane of the map: sources do not
//! join every turn to its lane. Lanes of the map keep their areas. Connectors may overlap lanes and
//! each other, as in nuPlan's maps.

use super::graph::{GroupRow, LaneRow};
use planagent_world::geometry::{OrientedBox, Polygon, Polyline};

/// Smaller overlaps are rounding, m².
const MIN_OVERLAP: f64 = 1e-6;
/// An inserted lane with less area of its own becomes a [`SPECK`], m².
const MIN_AREA: f64 = 0.01;
/// Side of the square that stands for a lane without an area of its own, m. nuPlan's formats need
/// an area.
const SPECK: f64 = 0.01;

/// Cuts the areas of inserted lanes, and of their roadblocks, clear of the lanes of the map and of
/// earlier inserted ones.
pub(super) fn cut_inserted(lanes: &mut [LaneRow], groups: &mut [GroupRow]) {
    for place in 0..lanes.len() {
        if lanes[place].source.is_some() {
            continue;
        }
        let others =
            (0..lanes.len()).filter(|&other| other < place || lanes[other].source.is_some());
        let area = clear_of(
            &lanes[place].polygon,
            others.map(|other| &lanes[other].polygon),
        );
        let area = area.unwrap_or_else(|| speck(&lanes[place].centerline));
        let group = lanes[place].group;
        if let Some(group) = groups.iter_mut().find(|row| row.fid == group) {
            group.areas = vec![area.clone()];
        }
        lanes[place].polygon = area;
    }
}

/// The largest part of an area outside all others; `None` if it is small.
fn clear_of<'a>(area: &Polygon, others: impl Iterator<Item = &'a Polygon>) -> Option<Polygon> {
    let mut rest = area.clone();
    for other in others {
        if rest.shared_area(other) > MIN_OVERLAP {
            rest = rest.without(other).filter(|rest| rest.area() >= MIN_AREA)?;
        }
    }
    Some(rest)
}

/// A square on the middle of a centerline.
fn speck(line: &Polyline) -> Polygon {
    OrientedBox::new(line.pose_at(line.length() / 2.0), SPECK, SPECK).to_polygon()
}
