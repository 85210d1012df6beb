//! Lanes share no ground: at most one lane holds a point, as nuPlan's metrics assume.

use crate::geometry::{Point, Polygon};
use geo::{BooleanOps, Simplify};

/// Takes from every lane what an earlier one holds; a lane that would be left with nothing keeps its area. Connectors keep
/// theirs: they overlap each other and lanes.
pub(in crate::scenario) fn separate(areas: &mut [Polygon], connector: &[bool]) {
    /// Overlaps under this are rounding, m².
    const NOTHING: f64 = 1e-6;
    for later in (0..areas.len()).filter(|&i| !connector[i]) {
        for earlier in (0..later).filter(|&i| !connector[i]) {
            let (a, b) = (&areas[earlier], &areas[later]);
            if a.overlaps(b)
                && a.shared_area(b) > NOTHING
                && let Some(rest) = without(b, a)
            {
                areas[later] = rest;
            }
        }
    }
}

/// The largest piece of what a polygon does not share with another.
fn without(polygon: &Polygon, other: &Polygon) -> Option<Polygon> {
    let rest = to_geo(polygon).difference(&to_geo(other));
    let pieces = rest.into_iter().filter_map(|piece| from_geo(&piece));
    pieces.max_by(|a, b| a.area().total_cmp(&b.area()))
}

/// The polygon without the vertices that move its outline by less than `by` metres.
pub(in crate::scenario) fn simplified(polygon: &Polygon, by: f64) -> Polygon {
    from_geo(&to_geo(polygon).simplify(by)).unwrap_or_else(|| polygon.clone())
}

fn to_geo(polygon: &Polygon) -> geo::Polygon<f64> {
    let ring: Vec<(f64, f64)> = polygon.ring().iter().map(|p| (p.x, p.y)).collect();
    geo::Polygon::new(geo::LineString::from(ring), vec![])
}

fn from_geo(polygon: &geo::Polygon<f64>) -> Option<Polygon> {
    Polygon::new(polygon.exterior().coords().map(|c| Point::new(c.x, c.y))).ok()
}
