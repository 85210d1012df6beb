//! The strip that a vehicle of some width sweeps along a line.

use super::polyline::{BLOCK, block_bounds};
use super::{Bounds, OrientedBox, Point, Polygon, Polyline, Pose, wrap_angle};

/// A line widened to both sides, with flat ends and round outer bends: `shapely`'s buffer with flat
/// caps.
#[derive(Debug, Clone, PartialEq)]
pub struct Corridor {
    line: Polyline,
    half_width: f64,
    pieces: Vec<OrientedBox>,
    /// Bounds of each run of [`BLOCK`] pieces, widened.
    blocks: Vec<Bounds>,
    /// Centers of the round bends.
    bends: Vec<Point>,
    bounds: Bounds,
}

/// Bends sharper than this are rounded on their outside, radians. Below it the missing wedge is
/// under half a millimeter deep; rounded, a vertex near a flat end would stick out of it.
const ROUNDED_BEND: f64 = 0.05;

impl Corridor {
    /// The strip of `half_width` meters to both sides of `line`.
    pub fn new(line: Polyline, half_width: f64) -> Self {
        let pieces: Vec<OrientedBox> = line
            .vertices()
            .windows(2)
            .map(|w| {
                let along = w[1] - w[0];
                let center = Pose::at(nalgebra::center(&w[0], &w[1]), along.y.atan2(along.x));
                OrientedBox::new(center, along.norm(), 2.0 * half_width)
            })
            .collect();
        // Boxes leave a wedge open outside a bend. Only bends that are sharp enough to show it are
        // closed.
        let turns = |pair: &[OrientedBox]| {
            wrap_angle(pair[1].center.heading - pair[0].center.heading).abs()
        };
        let interior = line.vertices().iter().skip(1).zip(pieces.windows(2));
        let bends = interior
            .filter(|(_, pair)| turns(pair) > ROUNDED_BEND)
            .map(|(&vertex, _)| vertex)
            .collect();
        let blocks: Vec<Bounds> = block_bounds(line.vertices())
            .into_iter()
            .map(|bounds| bounds.grown(half_width))
            .collect();
        let bounds = Bounds::around(line.vertices()).grown(half_width);
        Self {
            line,
            half_width,
            pieces,
            blocks,
            bends,
            bounds,
        }
    }

    /// The strip with square caps: longer at both ends by its half width.
    pub fn with_square_caps(line: &Polyline, half_width: f64) -> Self {
        let (first, last) = (line.pose_at(0.0), line.pose_at(line.length()));
        let before = first.translated(-half_width, 0.0).position();
        let after = last.translated(half_width, 0.0).position();
        let longer = std::iter::once(before)
            .chain(line.vertices().iter().copied())
            .chain(std::iter::once(after));
        Self::new(
            Polyline::new(longer).unwrap_or_else(|_| line.clone()),
            half_width,
        )
    }

    /// The line in the middle.
    #[inline]
    pub fn line(&self) -> &Polyline {
        &self.line
    }

    /// Smallest axis-aligned rectangle around the strip.
    #[inline]
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Whether a point lies in the strip.
    pub fn contains(&self, point: Point) -> bool {
        self.bounds.contains(point)
            && (self.pieces.iter().any(|piece| piece.contains(point))
                || self
                    .bends
                    .iter()
                    .any(|bend| (point - bend).norm() <= self.half_width))
    }

    /// Whether a box and the strip share a point.
    pub fn meets_box(&self, shape: &OrientedBox) -> bool {
        let bounds = shape.bounds();
        if !self.bounds.overlaps(&bounds) {
            return false;
        }
        let frame = shape.frame();
        let meets = |piece: &OrientedBox| {
            let reach = self.half_width.powi(2) + (piece.length / 2.0).powi(2);
            frame.distance_squared(piece.center.position()) <= reach && piece.overlaps(shape)
        };
        let near = self
            .blocks
            .iter()
            .zip(self.pieces.chunks(BLOCK))
            .filter(|(block, _)| block.overlaps(&bounds));
        near.flat_map(|(_, pieces)| pieces).any(meets)
            || self
                .bends
                .iter()
                .any(|&bend| frame.distance_squared(bend) <= self.half_width.powi(2))
    }

    /// Whether a line and the strip share a point.
    pub fn meets_line(&self, line: &Polyline) -> bool {
        let cut = |w: &[Point]| {
            self.pieces
                .iter()
                .any(|piece| piece.meets_segment(w[0], w[1]))
        };
        self.bounds.overlaps(&Bounds::around(line.vertices()))
            && (line.vertices().windows(2).any(cut)
                || self
                    .bends
                    .iter()
                    .any(|&bend| line.distance_to(bend) <= self.half_width))
    }

    /// Distance between a box and the strip, meters; 0 when they overlap.
    pub fn distance_to_box(&self, shape: &OrientedBox) -> f64 {
        let frame = shape.frame();
        let to_bends = self
            .bends
            .iter()
            .map(|&bend| (frame.distance_squared(bend).sqrt() - self.half_width).max(0.0));
        self.pieces
            .iter()
            .map(|piece| piece.distance(shape))
            .chain(to_bends)
            .fold(f64::INFINITY, f64::min)
    }

    /// Whether a polygon and the strip share a point.
    pub fn meets_polygon(&self, polygon: &Polygon) -> bool {
        self.bounds.overlaps(&polygon.bounds())
            && (self.pieces.iter().any(|piece| polygon.meets_box(piece))
                || self
                    .bends
                    .iter()
                    .any(|&bend| polygon.distance_to(bend) <= self.half_width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_flat_or_square_and_bends_are_round() {
        let line =
            Polyline::new([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Point::new(x, y)))
                .unwrap();
        let flat = Corridor::new(line.clone(), 1.0);
        assert!(flat.contains(Point::new(5.0, 0.9)) && !flat.contains(Point::new(-0.5, 0.0)));
        assert!(flat.contains(Point::new(10.6, -0.6)) && !flat.contains(Point::new(10.9, -0.9)));
        assert!(Corridor::with_square_caps(&line, 1.0).contains(Point::new(-0.5, 0.9)));
    }

    #[test]
    fn a_vertex_near_a_flat_end_does_not_stick_out() {
        let line = Polyline::new([0.0, 9.0, 10.0].map(|x| Point::new(x, 0.0))).unwrap();
        let strip = Corridor::new(line, 1.2);
        assert!(strip.contains(Point::new(10.0, 1.1)) && !strip.contains(Point::new(10.1, 0.0)));
        assert!(!strip.meets_box(&OrientedBox::new(Pose::new(12.1, 0.0, 0.0), 4.0, 2.0)));
    }

    #[test]
    fn boxes_beside_the_strip_do_not_meet_it() {
        let line = Polyline::new([Point::new(0.0, 0.0), Point::new(50.0, 0.0)]).unwrap();
        let strip = Corridor::new(line, 1.0);
        assert!(!strip.meets_box(&OrientedBox::new(Pose::new(25.0, 2.2, 0.0), 4.0, 2.0)));
        assert!(strip.meets_box(&OrientedBox::new(Pose::new(25.0, 1.9, 0.0), 4.0, 2.0)));
        let beside = OrientedBox::new(Pose::new(25.0, 4.0, 0.0), 4.0, 2.0);
        assert!((strip.distance_to_box(&beside) - 2.0).abs() < 1e-12);
        let along = |y: f64| Polyline::new([Point::new(-5.0, y), Point::new(55.0, y)]).unwrap();
        assert!(strip.meets_line(&along(0.9)) && !strip.meets_line(&along(1.1)));
        assert!(
            strip
                .meets_polygon(&OrientedBox::new(Pose::new(25.0, 1.9, 0.0), 4.0, 2.0).to_polygon())
        );
    }
}
