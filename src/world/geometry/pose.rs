//! A position with a heading.

use super::{Point, Vector, wrap_angle};

/// Position (meters) and heading (radians, counter-clockwise from the x axis), in the map frame
/// unless said otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Pose {
    /// East, meters.
    pub x: f64,
    /// North, meters.
    pub y: f64,
    /// Radians, counter-clockwise.
    pub heading: f64,
}

impl Pose {
    /// A pose from its three numbers.
    #[inline]
    pub fn new(x: f64, y: f64, heading: f64) -> Self {
        Self { x, y, heading }
    }

    /// A pose at a point.
    #[inline]
    pub fn at(position: Point, heading: f64) -> Self {
        Self {
            x: position.x,
            y: position.y,
            heading,
        }
    }

    /// The position alone.
    #[inline]
    pub fn position(&self) -> Point {
        Point::new(self.x, self.y)
    }

    /// Unit vector along the heading.
    #[inline]
    pub fn direction(&self) -> Vector {
        Vector::new(self.heading.cos(), self.heading.sin())
    }

    /// Turns a vector of this pose's frame (x forward, y left) into the map frame.
    #[inline]
    pub fn rotate(&self, local: Vector) -> Vector {
        let (sin, cos) = self.heading.sin_cos();
        Vector::new(cos * local.x - sin * local.y, sin * local.x + cos * local.y)
    }

    /// A point of this pose's frame (x forward, y left), in the map frame.
    #[inline]
    pub fn to_map(&self, local: Point) -> Point {
        self.position() + self.rotate(local.coords)
    }

    /// A point of the map frame, in this pose's frame (x forward, y left).
    #[inline]
    pub fn to_local(&self, point: Point) -> Point {
        let (sin, cos) = self.heading.sin_cos();
        let d = point - self.position();
        Point::new(cos * d.x + sin * d.y, -sin * d.x + cos * d.y)
    }

    /// The pose moved along its own axes: `forward` meters ahead, `left` meters to the left; the
    /// heading stays.
    #[inline]
    pub fn translated(&self, forward: f64, left: f64) -> Self {
        Self::at(self.to_map(Point::new(forward, left)), self.heading)
    }

    /// Straight-line distance between two positions, meters.
    #[inline]
    pub fn distance(&self, other: &Self) -> f64 {
        (self.position() - other.position()).norm()
    }

    /// Absolute angle between this heading and the direction to `point`, radians in [0, π].
    #[inline]
    pub fn bearing_to(&self, point: Point) -> f64 {
        let d = point - self.position();
        wrap_angle(d.y.atan2(d.x) - self.heading).abs()
    }

    /// Whether all three numbers are finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.heading.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn to_local_inverts_to_map(x in -1e3..1e3f64, y in -1e3..1e3f64, h in -4.0..4.0f64, px in -1e3..1e3f64, py in -1e3..1e3f64) {
            let pose = Pose::new(x, y, h);
            let back = pose.to_map(pose.to_local(Point::new(px, py)));
            prop_assert!((back.x - px).abs() < 1e-9 && (back.y - py).abs() < 1e-9);
        }
    }

    #[test]
    fn left_is_positive() {
        let moved = Pose::new(0.0, 0.0, std::f64::consts::FRAC_PI_2).translated(2.0, 1.0);
        assert!((moved.x + 1.0).abs() < 1e-12 && (moved.y - 2.0).abs() < 1e-12);
    }
}
