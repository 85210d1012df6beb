//! The strip that a vehicle of some width sweeps along a line.

use super::polyline::{BLOCK, block_bounds};
use super::{Bounds, OrientedBox, Point, Polygon, Polyline, Pose};

/// A line widened to both sides, with flat ends and round outer bends: `shapely`'s buffer with flat caps.
#[derive(Debug, Clone, PartialEq)]
pub struct Corridor {
    line: Polyline,
    half_width: f64,
    pieces: Vec<OrientedBox>,
    /// Bounds of each run of [`BLOCK`] pieces, widened.
    blocks: Vec<Bounds>,
    bounds: Bounds,
}

impl Corridor {
    /// The strip of `half_width` metres to both sides of `line`.
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
        let blocks: Vec<Bounds> =
            block_bounds(line.vertices()).into_iter().map(|bounds| bounds.grown(half_width)).collect();
        let bounds = Bounds::around(line.vertices()).grown(half_width);
        Self { line, half_width, pieces, blocks, bounds }
    }

    /// The same strip lengthened at both ends by its half width: square caps.
    pub fn with_square_caps(line: &Polyline, half_width: f64) -> Self {
        let (first, last) = (line.pose_at(0.0), line.pose_at(line.length()));
        let before = first.translated(-half_width, 0.0).position();
        let after = last.translated(half_width, 0.0).position();
        let longer = std::iter::once(before).chain(line.vertices().iter().copied()).chain(std::iter::once(after));
        Self::new(Polyline::new(longer).unwrap_or_else(|_| line.clone()), half_width)
    }

    /// The line in the middle.
    pub fn line(&self) -> &Polyline {
        &self.line
    }

    /// Smallest axis-aligned rectangle around the strip.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Interior vertices of the line: the centres of the round bends.
    fn bends(&self) -> &[Point] {
        let vertices = self.line.vertices();
        &vertices[1..vertices.len() - 1]
    }

    /// Whether a point lies in the strip.
    pub fn contains(&self, point: Point) -> bool {
        self.bounds.contains(point)
            && (self.pieces.iter().any(|piece| piece.contains(point))
                || self.bends().iter().any(|bend| (point - bend).norm() <= self.half_width))
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
        // The bend at the end of each piece lies in the bounds of the piece.
        let bends_near = |bend: &Point| frame.distance_squared(*bend) <= self.half_width.powi(2);
        self.blocks.iter().enumerate().filter(|(_, block)| block.overlaps(&bounds)).any(|(block, _)| {
            let pieces = block * BLOCK..((block + 1) * BLOCK).min(self.pieces.len());
            let bends = pieces.start..pieces.end.min(self.bends().len());
            self.pieces[pieces].iter().any(meets) || self.bends()[bends].iter().any(bends_near)
        })
    }

    /// Whether a polygon and the strip share a point.
    pub fn meets_polygon(&self, polygon: &Polygon) -> bool {
        self.bounds.overlaps(&polygon.bounds())
            && (self.pieces.iter().any(|piece| polygon.meets_box(piece))
                || self.bends().iter().any(|&bend| polygon.distance_to(bend) <= self.half_width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_flat_or_square_and_bends_are_round() {
        let line = Polyline::new([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Point::new(x, y))).unwrap();
        let flat = Corridor::new(line.clone(), 1.0);
        assert!(flat.contains(Point::new(5.0, 0.9)) && !flat.contains(Point::new(-0.5, 0.0)));
        assert!(flat.contains(Point::new(10.6, -0.6)) && !flat.contains(Point::new(10.9, -0.9)));
        assert!(Corridor::with_square_caps(&line, 1.0).contains(Point::new(-0.5, 0.9)));
    }

    #[test]
    fn boxes_beside_the_strip_do_not_meet_it() {
        let line = Polyline::new([Point::new(0.0, 0.0), Point::new(50.0, 0.0)]).unwrap();
        let strip = Corridor::new(line, 1.0);
        assert!(!strip.meets_box(&OrientedBox::new(Pose::new(25.0, 2.2, 0.0), 4.0, 2.0)));
        assert!(strip.meets_box(&OrientedBox::new(Pose::new(25.0, 1.9, 0.0), 4.0, 2.0)));
        assert!(strip.meets_polygon(&OrientedBox::new(Pose::new(25.0, 1.9, 0.0), 4.0, 2.0).to_polygon()));
    }
}
