//! Point-in-polygon for many points.

use super::{Bounds, Point, Polygon};

/// Mean number of edges per slab.
const EDGES_PER_SLAB: usize = 4;
/// Maximum number of slabs, which bounds the memory of a locator.
const MAX_SLABS: usize = 64;

/// A polygon whose edges are sorted into horizontal slabs, so that a query compares a point only
/// with the edges at its height. Gives the same answers as [`Polygon::contains`].
#[derive(Debug, Clone)]
pub struct PointLocator<'a> {
    polygon: &'a Polygon,
    /// The edges of all slabs, one slab after the other; each as (end, start) of the ring.
    edges: Vec<(Point, Point)>,
    /// Where each slab begins in `edges`, and where the last one ends.
    starts: Vec<usize>,
    slabs_per_meter: f64,
}

impl<'a> PointLocator<'a> {
    /// Sorts the edges of a polygon.
    pub fn new(polygon: &'a Polygon) -> Self {
        let count = (polygon.ring().len() / EDGES_PER_SLAB).clamp(1, MAX_SLABS);
        let bounds = polygon.bounds();
        let height = bounds.max.y - bounds.min.y;
        let slabs_per_meter = if height > 0.0 {
            count as f64 / height
        } else {
            0.0
        };
        let mut locator = Self {
            polygon,
            edges: Vec::new(),
            starts: vec![0; count + 1],
            slabs_per_meter,
        };
        let slabs = |from: Point, to: Point| {
            locator.slab(from.y.min(to.y))..=locator.slab(from.y.max(to.y))
        };
        let outline = || {
            polygon.ring().iter().copied().zip(
                polygon
                    .ring()
                    .iter()
                    .copied()
                    .cycle()
                    .skip(polygon.ring().len() - 1),
            )
        };
        // A counting sort: the edges of a slab lie side by side, in one allocation for all slabs.
        let mut starts = vec![0; count + 1];
        for slab in outline().flat_map(|(end, start)| slabs(start, end)) {
            starts[slab + 1] += 1;
        }
        for slab in 0..count {
            starts[slab + 1] += starts[slab];
        }
        let mut next = starts.clone();
        let mut edges = vec![(Point::origin(), Point::origin()); starts[count]];
        for (end, start) in outline() {
            for slab in slabs(start, end) {
                edges[next[slab]] = (end, start);
                next[slab] += 1;
            }
        }
        (locator.edges, locator.starts) = (edges, starts);
        locator
    }

    /// Smallest axis-aligned rectangle around the polygon.
    #[inline]
    pub fn bounds(&self) -> Bounds {
        self.polygon.bounds()
    }

    /// Whether a point lies inside (even-odd rule); a point exactly on an edge may count either
    /// way.
    pub fn contains(&self, point: Point) -> bool {
        if !self.bounds().contains(point) {
            return false;
        }
        if !self.polygon.holes().is_empty() {
            return self.polygon.contains(point);
        }
        let slab = self.slab(point.y);
        let mut inside = false;
        for &(vertex, previous) in &self.edges[self.starts[slab]..self.starts[slab + 1]] {
            if (vertex.y > point.y) != (previous.y > point.y) {
                let x = vertex.x
                    + (point.y - vertex.y) / (previous.y - vertex.y) * (previous.x - vertex.x);
                inside ^= point.x < x;
            }
        }
        inside
    }

    fn slab(&self, y: f64) -> usize {
        (((y - self.bounds().min.y) * self.slabs_per_meter) as usize).min(self.starts.len() - 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn answers_as_the_polygon_does(
            ring in prop::collection::vec((-9.0..9.0f64, -9.0..9.0f64), 3..80),
            points in prop::collection::vec((-10.0..10.0f64, -10.0..10.0f64), 20),
        ) {
            let ring: Vec<Point> = ring.into_iter().map(|(x, y)| Point::new(x, y)).collect();
            let polygon = Polygon::new(ring.iter().copied()).unwrap();
            let locator = PointLocator::new(&polygon);
            for point in points.into_iter().map(|(x, y)| Point::new(x, y)).chain(ring) {
                prop_assert_eq!(locator.contains(point), polygon.contains(point));
            }
        }
    }

    #[test]
    fn a_hole_is_outside() {
        let square = |r: f64| [(-r, -r), (r, -r), (r, r), (-r, r)].map(|(x, y)| Point::new(x, y));
        let polygon = Polygon::new(square(5.0))
            .unwrap()
            .with_hole(square(2.0))
            .unwrap();
        let locator = PointLocator::new(&polygon);
        assert!(locator.contains(Point::new(3.0, 0.0)) && !locator.contains(Point::new(1.0, 0.0)));
    }
}
