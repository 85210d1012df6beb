//! Polygons: areas of the map and footprints. Their queries run millions of times in a simulation.

use super::{Bounds, GeometryError, OrientedBox, Point, Polyline, check_finite};
use geo::orient::Direction;
use geo::{Area, BooleanOps, Centroid, ConvexHull, Orient};

/// A polygon: its ring, stored once without repeating the first vertex, and the rings of its holes.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Polygon {
    ring: Vec<Point>,
    holes: Vec<Vec<Point>>,
    bounds: Bounds,
}

impl Polygon {
    /// A polygon with the given ring; a repeated last vertex is dropped.
    ///
    /// # Errors
    /// When a coordinate is not finite or fewer than three distinct vertices remain.
    pub fn new(points: impl IntoIterator<Item = Point>) -> Result<Self, GeometryError> {
        Ok(Self::from_convex(sound_ring(points)?))
    }

    /// The polygon with a hole cut out; the hole must lie inside it and clear of its other holes.
    ///
    /// # Errors
    /// When a coordinate is not finite or fewer than three distinct vertices remain.
    pub fn with_hole(
        mut self,
        points: impl IntoIterator<Item = Point>,
    ) -> Result<Self, GeometryError> {
        self.holes.push(sound_ring(points)?);
        Ok(self)
    }

    /// A ring known to be sound (made from a box).
    pub(super) fn from_convex(ring: Vec<Point>) -> Self {
        let bounds = Bounds::around(&ring);
        Self {
            ring,
            holes: Vec::new(),
            bounds,
        }
    }

    /// The area between two lines that run the same way, left and right.
    ///
    /// # Errors
    /// When the two lines leave no area.
    pub fn between(left: &Polyline, right: &Polyline) -> Result<Self, GeometryError> {
        Self::new(
            left.vertices()
                .iter()
                .chain(right.vertices().iter().rev())
                .copied(),
        )
    }

    /// The vertices of the outer ring in order; the first is not repeated.
    #[inline]
    pub fn ring(&self) -> &[Point] {
        &self.ring
    }

    /// The rings of the holes, as [`Self::ring`] gives the outer one.
    #[inline]
    pub fn holes(&self) -> &[Vec<Point>] {
        &self.holes
    }

    fn rings(&self) -> impl Iterator<Item = &Vec<Point>> {
        std::iter::once(&self.ring).chain(&self.holes)
    }

    /// Smallest axis-aligned rectangle around the polygon.
    #[inline]
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The edges of all rings, the closing ones included.
    #[inline]
    pub fn edges(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        self.rings()
            .flat_map(|ring| (0..ring.len()).map(|i| (ring[i], ring[(i + 1) % ring.len()])))
    }

    /// Whether a point lies inside (even-odd rule); a point exactly on an edge may count either
    /// way.
    #[inline]
    pub fn contains(&self, point: Point) -> bool {
        self.bounds.contains(point)
            && ring_holds(&self.ring, point)
            && !self.holes.iter().any(|hole| ring_holds(hole, point))
    }

    /// Distance from a point to the polygon, meters; 0 inside.
    pub fn distance_to(&self, point: Point) -> f64 {
        if self.contains(point) {
            0.0
        } else {
            self.edge_distance(point)
        }
    }

    /// Distance from a point to the nearest edge, meters, inside or outside.
    pub fn edge_distance(&self, point: Point) -> f64 {
        self.edges()
            .map(|(a, b)| segment_distance(point, a, b))
            .fold(f64::INFINITY, f64::min)
    }

    /// Whether a box and the polygon share a point; touching counts.
    pub fn meets_box(&self, shape: &OrientedBox) -> bool {
        self.bounds.overlaps(&shape.bounds())
            && (self.contains(shape.center.position())
                || shape.contains(self.ring[0])
                || self.edges().any(|(a, b)| shape.meets_segment(a, b)))
    }

    /// Whether the box lies wholly inside the polygon.
    pub fn holds_box(&self, shape: &OrientedBox) -> bool {
        shape.corners().iter().all(|&c| self.contains(c))
            && !self.rings().flatten().any(|&v| shape.contains(v))
    }

    /// Distance between a box and the polygon, meters; 0 when they overlap.
    pub fn distance_to_box(&self, shape: &OrientedBox) -> f64 {
        if self.meets_box(shape) {
            return 0.0;
        }
        let (corners, frame, center) = (shape.corners(), shape.frame(), shape.center.position());
        let reach = shape.diagonal() / 2.0;
        let mut nearest = f64::INFINITY;
        for (from, to) in self.edges() {
            // No point of the edge is nearer than this.
            let least =
                (nalgebra::center(&from, &to) - center).norm() - (to - from).norm() / 2.0 - reach;
            if least <= nearest {
                let from_corners = corners
                    .iter()
                    .map(|&corner| segment_distance(corner, from, to));
                nearest = from_corners
                    .fold(nearest, f64::min)
                    .min(frame.distance_squared(from).sqrt());
            }
        }
        nearest
    }

    /// Whether two polygons share a point.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.bounds.overlaps(&other.bounds)
            && (self.contains(other.ring[0])
                || other.contains(self.ring[0])
                || self
                    .edges()
                    .any(|(a, b)| other.edges().any(|(c, d)| segments_cross(a, b, c, d))))
    }

    /// Whether a line and the polygon share a point.
    pub fn meets_line(&self, line: &Polyline) -> bool {
        line.vertices().iter().any(|&v| self.contains(v))
            || line
                .vertices()
                .windows(2)
                .any(|w| self.edges().any(|(a, b)| segments_cross(w[0], w[1], a, b)))
    }

    /// Area, m².
    pub fn area(&self) -> f64 {
        self.to_geo().unsigned_area()
    }

    /// Area shared with another polygon, m².
    pub fn shared_area(&self, other: &Self) -> f64 {
        if !self.bounds.overlaps(&other.bounds) {
            return 0.0;
        }
        self.to_geo().intersection(&other.to_geo()).unsigned_area()
    }

    /// The largest piece of the polygon outside another, its holes filled; `None` if nothing is
    /// left.
    #[doc(hidden)]
    pub fn without(&self, other: &Self) -> Option<Self> {
        let pieces = self
            .to_geo()
            .difference(&other.to_geo())
            .into_iter()
            .filter_map(|piece| Self::from_geo(&piece));
        pieces.max_by(|a, b| a.area().total_cmp(&b.area()))
    }

    /// The union of several polygons as simple outlines; holes are filled.
    pub fn union_of(polygons: &[Self]) -> Vec<Self> {
        // Rings that run opposite ways would cut each other out.
        let all: Vec<geo::Polygon<f64>> = polygons
            .iter()
            .map(|p| p.to_geo().orient(Direction::Default))
            .collect();
        geo::unary_union(&all)
            .into_iter()
            .filter_map(|p| Self::from_geo(&p))
            .collect()
    }

    /// Smallest convex polygon around the given points.
    ///
    /// # Errors
    /// When the points span no area.
    pub fn convex_hull(points: &[Point]) -> Result<Self, GeometryError> {
        check_finite(points)?;
        let cloud: geo::MultiPoint<f64> =
            points.iter().map(|p| geo::Point::new(p.x, p.y)).collect();
        let hull = cloud.convex_hull();
        Self::new(hull.exterior().coords().map(|c| Point::new(c.x, c.y)))
    }

    /// Center of area.
    pub fn centroid(&self) -> Point {
        self.to_geo()
            .centroid()
            .map_or(self.ring[0], |c| Point::new(c.x(), c.y()))
    }

    fn to_geo(&self) -> geo::Polygon<f64> {
        let line = |ring: &Vec<Point>| {
            geo::LineString::from(ring.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>())
        };
        geo::Polygon::new(line(&self.ring), self.holes.iter().map(line).collect())
    }

    fn from_geo(polygon: &geo::Polygon<f64>) -> Option<Self> {
        Self::new(polygon.exterior().coords().map(|c| Point::new(c.x, c.y))).ok()
    }
}

/// The vertices of a ring without repetitions.
fn sound_ring(points: impl IntoIterator<Item = Point>) -> Result<Vec<Point>, GeometryError> {
    let mut ring: Vec<Point> = points.into_iter().collect();
    check_finite(&ring)?;
    ring.dedup();
    while ring.len() > 1 && ring.first() == ring.last() {
        ring.pop();
    }
    if ring.len() < 3 {
        return Err(GeometryError::TooFewVertices {
            shape: "polygon",
            needed: 3,
            got: ring.len(),
        });
    }
    Ok(ring)
}

/// Whether a point lies inside a ring (even-odd rule).
fn ring_holds(ring: &[Point], point: Point) -> bool {
    let mut inside = false;
    let mut previous = ring[ring.len() - 1];
    for &vertex in ring {
        if (vertex.y > point.y) != (previous.y > point.y) {
            let x =
                vertex.x + (point.y - vertex.y) / (previous.y - vertex.y) * (previous.x - vertex.x);
            if point.x < x {
                inside = !inside;
            }
        }
        previous = vertex;
    }
    inside
}

/// Distance from a point to the segment between two others, meters.
#[inline]
pub(super) fn segment_distance(point: Point, from: Point, to: Point) -> f64 {
    let along = to - from;
    let squared = along.norm_squared();
    let share = if squared > 0.0 {
        ((point - from).dot(&along) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (point - (from + along * share)).norm()
}

/// Whether two closed segments share a point.
#[inline]
pub(super) fn segments_cross(a: Point, b: Point, c: Point, d: Point) -> bool {
    let side = |p: Point, q: Point, r: Point| (q - p).perp(&(r - p));
    let (d1, d2, d3, d4) = (side(c, d, a), side(c, d, b), side(a, b, c), side(a, b, d));
    if d1 * d2 < 0.0 && d3 * d4 < 0.0 {
        return true;
    }
    let on = |p: Point, q: Point, r: Point, turn: f64| {
        turn == 0.0
            && r.x >= p.x.min(q.x)
            && r.x <= p.x.max(q.x)
            && r.y >= p.y.min(q.y)
            && r.y <= p.y.max(q.y)
    };
    on(c, d, a, d1) || on(c, d, b, d2) || on(a, b, c, d3) || on(a, b, d, d4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    fn ell() -> Polygon {
        let ring = [
            (0.0, 0.0),
            (10.0, 0.0),
            (10.0, 4.0),
            (4.0, 4.0),
            (4.0, 10.0),
            (0.0, 10.0),
        ];
        Polygon::new(ring.map(|(x, y)| Point::new(x, y))).unwrap()
    }

    #[test]
    fn concave_containment_and_distance() {
        assert!(ell().contains(Point::new(1.0, 9.0)));
        assert!(!ell().contains(Point::new(6.0, 6.0)));
        assert!((ell().distance_to(Point::new(6.0, 6.0)) - 2.0).abs() < 1e-12);
        assert!(ell().distance_to(Point::new(1.0, 1.0)).abs() < 1e-12);
    }

    #[test]
    fn a_hole_is_outside() {
        let square = |low: f64, high: f64| [(low, low), (high, low), (high, high), (low, high)];
        let points = |low, high| square(low, high).map(|(x, y)| Point::new(x, y));
        let ring = Polygon::new(points(0.0, 10.0))
            .unwrap()
            .with_hole(points(3.0, 7.0))
            .unwrap();
        assert!(ring.contains(Point::new(1.0, 5.0)) && !ring.contains(Point::new(5.0, 5.0)));
        assert!((ring.distance_to(Point::new(5.0, 4.5)) - 1.5).abs() < 1e-12);
        assert!((ring.area() - 84.0).abs() < 1e-9);
        let inside = OrientedBox::new(Pose::new(5.0, 5.0, 0.0), 2.0, 2.0);
        assert!(!ring.meets_box(&inside) && (ring.distance_to_box(&inside) - 1.0).abs() < 1e-12);
        assert!(ring.meets_box(&OrientedBox::new(Pose::new(5.0, 5.0, 0.0), 5.0, 2.0)));
        assert!(!ring.holds_box(&OrientedBox::new(Pose::new(5.0, 5.0, 0.0), 9.0, 9.0)));
        assert!(ring.with_hole([Point::new(f64::NAN, 0.0); 3]).is_err());
    }

    #[test]
    fn boxes_meet_without_any_vertex_inside_the_other() {
        let across = OrientedBox::new(Pose::new(2.0, 5.0, 0.0), 20.0, 1.0);
        assert!(ell().meets_box(&across));
        let apart = OrientedBox::new(Pose::new(8.0, 8.0, 0.5), 3.0, 2.0);
        assert!(!ell().meets_box(&apart));
        assert!(ell().distance_to_box(&apart) > 0.5);
    }

    #[test]
    fn union_joins_and_area_adds_up() {
        let left = OrientedBox::new(Pose::new(0.0, 0.0, 0.0), 4.0, 2.0).to_polygon();
        let right = OrientedBox::new(Pose::new(3.0, 0.0, 0.0), 4.0, 2.0).to_polygon();
        let union = Polygon::union_of(&[left.clone(), right.clone()]);
        assert_eq!(union.len(), 1);
        assert!((union[0].area() - 14.0).abs() < 1e-9);
        let reversed = Polygon::new(right.ring().iter().rev().copied()).unwrap();
        assert!((Polygon::union_of(&[left.clone(), reversed])[0].area() - 14.0).abs() < 1e-9);
        assert!((left.shared_area(&right) - 2.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn box_and_its_polygon_agree(x in -15.0..15.0f64, y in -15.0..15.0f64, h in -3.2..3.2f64, l in 0.5..8.0f64, w in 0.5..4.0f64) {
            let a = OrientedBox::new(Pose::new(x, y, h), l, w);
            let b = OrientedBox::new(Pose::new(1.0, -2.0, 0.7), 5.0, 2.0);
            let by_polygon = b.to_polygon().distance_to_box(&a);
            let by_box = a.distance(&b);
            prop_assert!((by_polygon - by_box).abs() < 1e-6, "{by_polygon} {by_box}");
            prop_assert_eq!(by_box <= 1e-9, b.to_polygon().overlaps(&a.to_polygon()) || by_box.abs() < 1e-9);
        }
    }
}
