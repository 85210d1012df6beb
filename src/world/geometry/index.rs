//! Axis-aligned bounds and an R-tree over them.

use super::Point;
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

/// An axis-aligned rectangle in the map frame, meters.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Bounds {
    /// South-west corner.
    pub min: Point,
    /// North-east corner.
    pub max: Point,
}

impl Bounds {
    /// Smallest rectangle around the points; empty (inverted) for none.
    pub fn around(points: &[Point]) -> Self {
        let mut bounds = Self {
            min: Point::new(f64::INFINITY, f64::INFINITY),
            max: Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        };
        for p in points {
            bounds.min = bounds.min.inf(p);
            bounds.max = bounds.max.sup(p);
        }
        bounds
    }

    /// A square patch: all points within `half_size` of `center` on both axes (nuPlan's proximity
    /// query).
    #[inline]
    pub fn square(center: Point, half_size: f64) -> Self {
        Self {
            min: center,
            max: center,
        }
        .grown(half_size)
    }

    /// Moved outwards on every side.
    #[inline]
    pub fn grown(self, by: f64) -> Self {
        let margin = nalgebra::Vector2::new(by, by);
        Self {
            min: self.min - margin,
            max: self.max + margin,
        }
    }

    /// Smallest rectangle around both.
    #[inline]
    pub fn joined(self, other: Self) -> Self {
        Self {
            min: self.min.inf(&other.min),
            max: self.max.sup(&other.max),
        }
    }

    /// Whether a point lies inside or on the edge.
    #[inline]
    pub fn contains(&self, p: Point) -> bool {
        p.x >= self.min.x && p.x <= self.max.x && p.y >= self.min.y && p.y <= self.max.y
    }

    /// Squared distance from a point, m²; 0 inside.
    #[inline]
    pub fn distance_squared(&self, p: Point) -> f64 {
        let x = (self.min.x - p.x).max(p.x - self.max.x).max(0.0);
        let y = (self.min.y - p.y).max(p.y - self.max.y).max(0.0);
        x * x + y * y
    }

    /// Whether two rectangles share a point.
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.x <= other.max.x
            && other.min.x <= self.max.x
            && self.min.y <= other.max.y
            && other.min.y <= self.max.y
    }

    /// Distance from a point to the rectangle, meters; 0 inside.
    #[inline]
    pub fn distance_to(&self, p: Point) -> f64 {
        let outside = |low: f64, at: f64, high: f64| (low - at).max(at - high).max(0.0);
        outside(self.min.x, p.x, self.max.x).hypot(outside(self.min.y, p.y, self.max.y))
    }

    fn envelope(&self) -> AABB<[f64; 2]> {
        AABB::from_corners([self.min.x, self.min.y], [self.max.x, self.max.y])
    }
}

/// Finds which of many shapes, known by their index, may touch a place. Answers come in ascending
/// index order.
#[derive(Debug, Clone)]
pub struct SpatialIndex {
    tree: RTree<GeomWithData<Rectangle<[f64; 2]>, usize>>,
}

impl SpatialIndex {
    /// An index over shapes with these bounds; the n-th has index n.
    pub fn new(bounds: impl IntoIterator<Item = Bounds>) -> Self {
        let entries = bounds
            .into_iter()
            .enumerate()
            .map(|(i, b)| GeomWithData::new(Rectangle::from_aabb(b.envelope()), i))
            .collect();
        Self {
            tree: RTree::bulk_load(entries),
        }
    }

    /// Indices of the shapes whose bounds hold the point.
    pub fn at(&self, point: Point) -> Vec<usize> {
        self.within(&Bounds {
            min: point,
            max: point,
        })
    }

    /// Indices of the shapes whose bounds meet the given ones.
    pub fn within(&self, bounds: &Bounds) -> Vec<usize> {
        let mut found: Vec<usize> = self
            .tree
            .locate_in_envelope_intersecting(&bounds.envelope())
            .map(|entry| entry.data)
            .collect();
        found.sort_unstable();
        found
    }

    /// Indices of all shapes by growing distance of their bounds from the point.
    pub fn nearest(&self, point: Point) -> impl Iterator<Item = usize> + '_ {
        self.tree
            .nearest_neighbor_iter(&[point.x, point.y])
            .map(|entry| entry.data)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn index_answers_like_a_plain_scan(
            shapes in prop::collection::vec((-50.0..50.0f64, -50.0..50.0f64, 0.1..20.0f64), 0..40),
            x in -60.0..60.0f64, y in -60.0..60.0f64, r in 0.0..30.0f64,
        ) {
            let bounds: Vec<Bounds> = shapes.iter().map(|&(x, y, r)| Bounds::square(Point::new(x, y), r)).collect();
            let index = SpatialIndex::new(bounds.iter().copied());
            let patch = Bounds::square(Point::new(x, y), r);
            let plain: Vec<usize> = (0..bounds.len()).filter(|&i| bounds[i].overlaps(&patch)).collect();
            prop_assert_eq!(index.within(&patch), plain);
        }
    }
}
