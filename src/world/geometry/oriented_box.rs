//! Rectangles with a heading: the shape of every agent.

use super::{Bounds, Point, Polygon, Pose};
use parry2d_f64::math::{Pose as Isometry, Vector as GlamVector};
use parry2d_f64::query;
use parry2d_f64::shape::Cuboid;

/// A rectangle, `length` along its heading and `width` across, meters.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OrientedBox {
    /// Center and heading.
    pub center: Pose,
    /// Extent along the heading, meters.
    pub length: f64,
    /// Extent across the heading, meters.
    pub width: f64,
}

impl OrientedBox {
    /// A box around `center`.
    #[inline]
    pub fn new(center: Pose, length: f64, width: f64) -> Self {
        Self {
            center,
            length,
            width,
        }
    }

    /// Corners in nuPlan's order: front left, rear left, rear right, front right.
    #[inline]
    pub fn corners(&self) -> [Point; 4] {
        let (l, w) = (self.length / 2.0, self.width / 2.0);
        [(l, w), (-l, w), (-l, -w), (l, -w)].map(|(x, y)| self.center.to_map(Point::new(x, y)))
    }

    /// The two ends of the front edge: left, right.
    #[inline]
    pub fn front_edge(&self) -> [Point; 2] {
        let [front_left, _, _, front_right] = self.corners();
        [front_left, front_right]
    }

    /// Length of the diagonal, meters.
    #[inline]
    pub fn diagonal(&self) -> f64 {
        self.length.hypot(self.width)
    }

    /// The box as a polygon.
    pub fn to_polygon(&self) -> Polygon {
        Polygon::from_convex(self.corners().to_vec())
    }

    /// Smallest axis-aligned rectangle around the box.
    #[inline]
    pub fn bounds(&self) -> Bounds {
        Bounds::around(&self.corners())
    }

    /// Whether a point lies in the box or on its edge.
    #[inline]
    pub fn contains(&self, point: Point) -> bool {
        let local = self.center.to_local(point);
        local.x.abs() <= self.length / 2.0 && local.y.abs() <= self.width / 2.0
    }

    /// The same box at another center pose.
    #[inline]
    pub fn moved_to(&self, center: Pose) -> Self {
        Self { center, ..*self }
    }

    fn shape(&self) -> (Isometry, Cuboid) {
        let at = Isometry::new(
            GlamVector::new(self.center.x, self.center.y),
            self.center.heading,
        );
        (
            at,
            Cuboid::new(GlamVector::new(self.length / 2.0, self.width / 2.0)),
        )
    }

    /// Whether the circles around two boxes are so near that the boxes may share a point.
    #[inline]
    pub fn may_overlap(&self, other: &Self) -> bool {
        // (a + b)² ≤ 2·(a² + b²) spares the square roots of the diagonals.
        let squared = |shape: &Self| shape.length * shape.length + shape.width * shape.width;
        let most = f64::midpoint(squared(self), squared(other));
        (self.center.position() - other.center.position()).norm_squared() <= most
    }

    /// Whether two boxes share a point; touching counts.
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        if !self.may_overlap(other) {
            return false;
        }
        let ((a_at, a), (b_at, b)) = (self.shape(), other.shape());
        query::details::intersection_test_cuboid_cuboid(&a_at.inv_mul(&b_at), &a, &b)
    }

    /// Distance between two boxes, meters; 0 when they overlap. Of boxes apart, a corner of one is
    /// nearest to the other.
    pub fn distance(&self, other: &Self) -> f64 {
        if self.overlaps(other) {
            return 0.0;
        }
        let (a, b) = (self.frame(), other.frame());
        let to_other = a
            .corners()
            .into_iter()
            .map(|corner| b.distance_squared(corner));
        let to_self = b
            .corners()
            .into_iter()
            .map(|corner| a.distance_squared(corner));
        to_other.chain(to_self).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// The box with the sine and cosine of its heading, for many queries.
    #[inline]
    pub(super) fn frame(&self) -> BoxFrame {
        let (sin, cos) = self.center.heading.sin_cos();
        let half = (self.length / 2.0, self.width / 2.0);
        BoxFrame {
            center: self.center.position(),
            sin,
            cos,
            half,
        }
    }

    /// Whether the segment between two points meets the box; touching counts.
    pub fn meets_segment(&self, from: Point, to: Point) -> bool {
        // Clip the segment against the slab of each axis of the box.
        let (a, b) = (self.center.to_local(from), self.center.to_local(to));
        let (mut enter, mut leave) = (0.0f64, 1.0f64);
        for (start, end, half) in [(a.x, b.x, self.length / 2.0), (a.y, b.y, self.width / 2.0)] {
            let step = end - start;
            if step.abs() < f64::EPSILON {
                if start.abs() > half {
                    return false;
                }
                continue;
            }
            let (t1, t2) = ((-half - start) / step, (half - start) / step);
            enter = enter.max(t1.min(t2));
            leave = leave.min(t1.max(t2));
        }
        enter <= leave
    }
}

/// An [`OrientedBox`] with the sine and cosine of its heading.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoxFrame {
    center: Point,
    sin: f64,
    cos: f64,
    /// Half length and half width, meters.
    half: (f64, f64),
}

impl BoxFrame {
    fn corners(&self) -> [Point; 4] {
        let (l, w) = self.half;
        [(l, w), (-l, w), (-l, -w), (l, -w)].map(|(x, y)| {
            Point::new(
                self.center.x + self.cos * x - self.sin * y,
                self.center.y + self.sin * x + self.cos * y,
            )
        })
    }

    /// Squared distance from a point to the box, m²; 0 inside.
    #[inline]
    pub(super) fn distance_squared(&self, point: Point) -> f64 {
        let d = point - self.center;
        let x = ((self.cos * d.x + self.sin * d.y).abs() - self.half.0).max(0.0);
        let y = ((self.cos * d.y - self.sin * d.x).abs() - self.half.1).max(0.0);
        x * x + y * y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, heading: f64) -> OrientedBox {
        OrientedBox::new(Pose::new(x, 0.0, heading), 2.0, 2.0)
    }

    #[test]
    fn corners_come_in_nuplan_order() {
        let corners = OrientedBox::new(Pose::new(0.0, 0.0, 0.0), 4.0, 2.0).corners();
        assert_eq!(corners[0], Point::new(2.0, 1.0));
        assert_eq!(corners[1], Point::new(-2.0, 1.0));
        assert_eq!(corners[2], Point::new(-2.0, -1.0));
        assert_eq!(corners[3], Point::new(2.0, -1.0));
    }

    #[test]
    fn touching_boxes_overlap_and_apart_ones_have_distance() {
        assert!(square(0.0, 0.0).overlaps(&square(2.0, 0.0)));
        assert!(!square(0.0, 0.0).overlaps(&square(2.01, 0.0)));
        assert!((square(0.0, 0.0).distance(&square(5.0, 0.0)) - 3.0).abs() < 1e-9);
        assert!(square(0.0, 0.0).distance(&square(1.0, 0.3)).abs() < 1e-12);
    }

    proptest::proptest! {
        #[test]
        fn the_distance_is_that_of_the_general_algorithm(
            x in -15.0..15.0f64, y in -15.0..15.0f64, heading in -3.2..3.2f64, l in 0.3..8.0f64, w in 0.3..4.0f64,
        ) {
            let (a, b) = (OrientedBox::new(Pose::new(x, y, heading), l, w), square(1.0, 0.7));
            let ((a_at, a_shape), (b_at, b_shape)) = (a.shape(), b.shape());
            let general = query::details::distance_support_map_support_map(&a_at.inv_mul(&b_at), &a_shape, &b_shape);
            proptest::prop_assert!((a.distance(&b) - general).abs() < 1e-6, "{} {general}", a.distance(&b));
        }
    }

    #[test]
    fn a_turned_box_reaches_further() {
        let turned = square(2.3, std::f64::consts::FRAC_PI_4);
        assert!(square(0.0, 0.0).overlaps(&turned));
    }

    #[test]
    fn segments_meet_the_box() {
        let b = square(0.0, 0.3);
        assert!(b.meets_segment(Point::new(-5.0, 0.1), Point::new(5.0, 0.1)));
        assert!(b.meets_segment(Point::new(0.0, 0.0), Point::new(0.1, 0.0)));
        assert!(!b.meets_segment(Point::new(-5.0, 2.0), Point::new(5.0, 2.0)));
    }
}
