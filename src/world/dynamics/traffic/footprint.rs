//! The area that an agent claims: its box and the strip of road ahead of it.

use crate::geometry::{Bounds, OrientedBox, Point, Polygon, Pose, Vector, wrap_angle};

/// Bends sharper than this are rounded on their outside, radians. Below it the missing wedge is
/// under half a millimeter deep.
const ROUNDED_BEND: f64 = 0.05;
/// A line that deviates less than this from the direction of its first segment is straight, meters.
const STRAIGHT: f64 = 1e-3;

/// A convex or simple part of a footprint.
#[derive(Debug, Clone)]
enum Shape {
    Box(OrientedBox),
    Disc,
    Polygon(Polygon),
}

/// A part with the circle around it, for pruning.
#[derive(Debug, Clone)]
struct Piece {
    shape: Shape,
    center: Point,
    reach: f64,
}

impl Piece {
    fn from_box(shape: OrientedBox) -> Self {
        Self {
            shape: Shape::Box(shape),
            center: shape.center.position(),
            reach: shape.diagonal() / 2.0,
        }
    }

    fn disc(center: Point, radius: f64) -> Self {
        Self {
            shape: Shape::Disc,
            center,
            reach: radius,
        }
    }

    /// Distance at least, meters; may be negative.
    fn distance_at_least(&self, other: &Self) -> f64 {
        (self.center - other.center).norm() - self.reach - other.reach
    }

    fn distance(&self, other: &Self) -> f64 {
        match (&self.shape, &other.shape) {
            (Shape::Disc, Shape::Disc) => self.distance_at_least(other).max(0.0),
            (Shape::Box(a), Shape::Box(b)) => a.distance(b),
            (Shape::Box(a), Shape::Disc) => (box_distance(a, other.center) - other.reach).max(0.0),
            (Shape::Disc, Shape::Box(b)) => (box_distance(b, self.center) - self.reach).max(0.0),
            (Shape::Box(a), Shape::Polygon(b)) => b.distance_to_box(a),
            (Shape::Polygon(a), Shape::Box(b)) => a.distance_to_box(b),
            (Shape::Disc, Shape::Polygon(b)) => (b.distance_to(self.center) - self.reach).max(0.0),
            (Shape::Polygon(a), Shape::Disc) => {
                (a.distance_to(other.center) - other.reach).max(0.0)
            }
            (Shape::Polygon(a), Shape::Polygon(b)) => polygon_distance(a, b),
        }
    }

    fn meets(&self, other: &Self) -> bool {
        self.distance_at_least(other) <= 0.0
            && match (&self.shape, &other.shape) {
                (Shape::Box(a), Shape::Box(b)) => a.overlaps(b),
                _ => self.distance(other) <= 0.0,
            }
    }

    fn may_meet(&self, bounds: &Bounds) -> bool {
        let nearest = Point::new(
            self.center.x.clamp(bounds.min.x, bounds.max.x),
            self.center.y.clamp(bounds.min.y, bounds.max.y),
        );
        (self.center - nearest).norm_squared() <= self.reach * self.reach
    }
}

fn box_distance(shape: &OrientedBox, point: Point) -> f64 {
    let local = shape.center.to_local(point);
    let (dx, dy) = (
        local.x.abs() - shape.length / 2.0,
        local.y.abs() - shape.width / 2.0,
    );
    dx.max(0.0).hypot(dy.max(0.0))
}

fn polygon_distance(a: &Polygon, b: &Polygon) -> f64 {
    if a.overlaps(b) {
        return 0.0;
    }
    let one_way = |from: &Polygon, to: &Polygon| {
        from.ring()
            .iter()
            .map(|&vertex| to.edge_distance(vertex))
            .fold(f64::INFINITY, f64::min)
    };
    one_way(a, b).min(one_way(b, a))
}

/// The line of poses as segments; straight runs are joined.
fn straight_runs(poses: &[Pose]) -> Vec<(Point, Point)> {
    let mut runs: Vec<(Point, Point)> = Vec::new();
    let mut direction = Vector::zeros();
    for pair in poses.windows(2) {
        let (a, b) = (pair[0].position(), pair[1].position());
        let along = b - a;
        let length = along.norm();
        if length <= f64::EPSILON {
            continue;
        }
        if let Some((start, end)) = runs.last_mut()
            && direction.dot(&along) > 0.0
            && direction.perp(&(b - *start)).abs() <= STRAIGHT
        {
            *end = b;
            continue;
        }
        direction = along / length;
        runs.push((a, b));
    }
    runs
}

/// A union of boxes, round bends and polygons.
#[derive(Debug, Clone)]
pub(super) struct Footprint {
    pieces: Vec<Piece>,
    bounds: Bounds,
}

impl Footprint {
    /// A box alone.
    pub(super) fn of_box(shape: OrientedBox) -> Self {
        Self {
            pieces: vec![Piece::from_box(shape)],
            bounds: shape.bounds(),
        }
    }

    /// A polygon alone.
    pub(super) fn of_polygon(polygon: &Polygon) -> Self {
        let bounds = polygon.bounds();
        let center = nalgebra::center(&bounds.min, &bounds.max);
        let piece = Piece {
            shape: Shape::Polygon(polygon.clone()),
            center,
            reach: (bounds.max - center).norm(),
        };
        Self {
            pieces: vec![piece],
            bounds,
        }
    }

    /// The strip of `half_width` meters to both sides of a line of poses, its ends flat; `None`
    /// when the line has no length.
    pub(super) fn of_strip(poses: &[Pose], half_width: f64) -> Option<Self> {
        let mut pieces = Vec::new();
        let mut last_heading = None;
        for (a, b) in straight_runs(poses) {
            let along = b - a;
            let heading = along.y.atan2(along.x);
            if last_heading.is_some_and(|last: f64| wrap_angle(heading - last).abs() > ROUNDED_BEND)
            {
                pieces.push(Piece::disc(a, half_width));
            }
            last_heading = Some(heading);
            let center = Pose::at(nalgebra::center(&a, &b), heading);
            pieces.push(Piece::from_box(OrientedBox::new(
                center,
                along.norm(),
                2.0 * half_width,
            )));
        }
        let corners: Vec<Point> = poses.iter().map(Pose::position).collect();
        (!pieces.is_empty()).then(|| Self {
            pieces,
            bounds: Bounds::around(&corners).grown(half_width),
        })
    }

    /// Both areas together.
    pub(super) fn united(mut self, other: Self) -> Self {
        self.bounds = self.bounds.joined(other.bounds);
        self.pieces.extend(other.pieces);
        self
    }

    /// Smallest axis-aligned rectangle around it, or a little more.
    pub(super) fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Whether two areas share a point.
    pub(super) fn meets(&self, other: &Self) -> bool {
        self.bounds.overlaps(&other.bounds)
            && self
                .pieces
                .iter()
                .filter(|piece| piece.may_meet(&other.bounds))
                .any(|piece| other.pieces.iter().any(|theirs| piece.meets(theirs)))
    }

    /// Distance between two areas, meters; 0 when they share a point.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        let pairs = || {
            self.pieces
                .iter()
                .flat_map(|a| other.pieces.iter().map(move |b| (a, b)))
        };
        let likely = pairs()
            .min_by(|(a, b), (c, d)| a.distance_at_least(b).total_cmp(&c.distance_at_least(d)));
        let mut best = likely.map_or(f64::INFINITY, |(a, b)| a.distance(b));
        for (a, b) in pairs() {
            if best > 0.0 && a.distance_at_least(b) < best {
                best = best.min(a.distance(b));
            }
        }
        best
    }

    /// Distance between the rectangles around two areas, meters: never more than
    /// [`Self::distance`].
    pub(super) fn distance_at_least(&self, other: &Self) -> f64 {
        let (a, b) = (&self.bounds, &other.bounds);
        let dx = (b.min.x - a.max.x).max(a.min.x - b.max.x).max(0.0);
        let dy = (b.min.y - a.max.y).max(a.min.y - b.max.y).max(0.0);
        dx.hypot(dy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses(points: &[(f64, f64)]) -> Vec<Pose> {
        points.iter().map(|&(x, y)| Pose::new(x, y, 0.0)).collect()
    }

    fn square(x: f64, y: f64) -> Footprint {
        Footprint::of_box(OrientedBox::new(Pose::new(x, y, 0.0), 2.0, 2.0))
    }

    #[test]
    fn a_strip_has_flat_ends_and_round_bends() {
        let strip =
            Footprint::of_strip(&poses(&[(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]), 1.0).unwrap();
        assert!(
            (strip.distance(&square(-3.0, 0.0)) - 2.0).abs() < 1e-9,
            "flat at the start"
        );
        let corner = 2.0f64.sqrt() * 2.0 - 1.0;
        assert!(
            (strip.distance(&square(13.0, -3.0)) - corner).abs() < 1e-9,
            "round at the bend"
        );
        assert!(strip.meets(&square(5.0, 1.9)) && !strip.meets(&square(5.0, 2.1)));
        assert!(Footprint::of_strip(&poses(&[(1.0, 1.0), (1.0, 1.0)]), 1.0).is_none());
    }

    #[test]
    fn polygons_take_part() {
        let line = Footprint::of_polygon(
            &OrientedBox::new(Pose::new(20.0, 0.0, 0.0), 0.5, 4.0).to_polygon(),
        );
        assert!((line.distance(&square(0.0, 0.0)) - 18.75).abs() < 1e-9);
        let strip = Footprint::of_strip(&poses(&[(0.0, 0.0), (30.0, 0.0)]), 1.0).unwrap();
        assert!(strip.meets(&line) && line.meets(&strip));
        let both = square(0.0, 0.0).united(square(15.0, 0.0));
        assert!((both.distance(&line) - 3.75).abs() < 1e-9);
        let other = Footprint::of_polygon(
            &OrientedBox::new(Pose::new(25.0, 0.0, 0.0), 0.5, 4.0).to_polygon(),
        );
        assert!((line.distance(&other) - 4.5).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn bounds_never_overstate_the_distance(x in -30.0..30.0f64, y in -30.0..30.0f64, bend in -8.0..8.0f64) {
            let strip = Footprint::of_strip(&poses(&[(0.0, 0.0), (6.0, 0.0), (12.0, bend)]), 1.2).unwrap();
            let exact = strip.distance(&square(x, y));
            prop_assert!(strip.distance_at_least(&square(x, y)) <= exact + 1e-9);
            prop_assert_eq!(strip.meets(&square(x, y)), exact <= 1e-9);
        }
    }
}
