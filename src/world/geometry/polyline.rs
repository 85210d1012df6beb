//! Lines of vertices with arc length: projection, interpolation, cutting.

use super::polygon::segments_cross;
use super::{Bounds, GeometryError, Point, Pose, Vector, check_finite, wrap_angle};

/// Two vertices nearer than this are one, meters.
const SAME_VERTEX: f64 = 1e-9;
/// Segments of a long line that share one bounding rectangle in the search for the nearest point.
pub(super) const BLOCK: usize = 16;
/// Look-ahead of nuPlan's nearest-pose heading, meters (devkit `polyline_map_object`).
const HEADING_LOOKAHEAD: f64 = 0.5;

/// A line through at least two distinct vertices, with the arc length of each.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Polyline {
    vertices: Vec<Point>,
    arc_lengths: Vec<f64>,
    /// Bounds of each run of [`BLOCK`] segments; none for a short line.
    blocks: Vec<Bounds>,
}

/// Projection of a point on a [`Polyline`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point, meters from the start, clamped to the line.
    pub s: f64,
    /// Signed distance to the line, meters, positive to the left of its direction.
    pub lateral: f64,
    /// Distance to the nearest point, meters.
    pub distance: f64,
    /// The nearest point itself.
    pub point: Point,
    /// Heading of the segment on which it lies, radians.
    pub heading: f64,
}

impl Polyline {
    /// A line through `points`; consecutive duplicates are merged.
    ///
    /// # Errors
    /// When a coordinate is not finite or fewer than two distinct vertices remain.
    pub fn new(points: impl IntoIterator<Item = Point>) -> Result<Self, GeometryError> {
        let mut vertices: Vec<Point> = points.into_iter().collect();
        check_finite(&vertices)?;
        vertices.dedup_by(|b, a| (*b - *a).norm() < SAME_VERTEX);
        if vertices.len() < 2 {
            return Err(GeometryError::TooFewVertices {
                shape: "polyline",
                needed: 2,
                got: vertices.len(),
            });
        }
        let mut arc_lengths = Vec::with_capacity(vertices.len());
        let mut s = 0.0;
        arc_lengths.push(s);
        for pair in vertices.windows(2) {
            s += (pair[1] - pair[0]).norm();
            arc_lengths.push(s);
        }
        let blocks = if vertices.len() > 2 * BLOCK {
            block_bounds(&vertices)
        } else {
            Vec::new()
        };
        Ok(Self {
            vertices,
            arc_lengths,
            blocks,
        })
    }

    /// The vertices, in order.
    #[inline]
    pub fn vertices(&self) -> &[Point] {
        &self.vertices
    }

    /// Arc length at each vertex, meters; the first is 0.
    #[inline]
    pub fn arc_lengths(&self) -> &[f64] {
        &self.arc_lengths
    }

    /// Total length, meters.
    #[inline]
    pub fn length(&self) -> f64 {
        self.arc_lengths[self.arc_lengths.len() - 1]
    }

    /// First vertex.
    #[inline]
    pub fn start(&self) -> Point {
        self.vertices[0]
    }

    /// Last vertex.
    #[inline]
    pub fn end(&self) -> Point {
        self.vertices[self.vertices.len() - 1]
    }

    /// Index of the segment that holds arc length `s` (clamped).
    fn segment_at(&self, s: f64) -> usize {
        let after = self.arc_lengths.partition_point(|&a| a <= s);
        after.saturating_sub(1).min(self.vertices.len() - 2)
    }

    fn segment_direction(&self, segment: usize) -> Vector {
        (self.vertices[segment + 1] - self.vertices[segment])
            / (self.arc_lengths[segment + 1] - self.arc_lengths[segment])
    }

    fn segment_heading(&self, segment: usize) -> f64 {
        let d = self.vertices[segment + 1] - self.vertices[segment];
        d.y.atan2(d.x)
    }

    /// Heading of each vertex: towards the next one; the last repeats its predecessor's (nuPlan
    /// `discrete_path`).
    pub fn vertex_headings(&self) -> Vec<f64> {
        let mut headings: Vec<f64> = (0..self.vertices.len() - 1)
            .map(|i| self.segment_heading(i))
            .collect();
        headings.push(headings[headings.len() - 1]);
        headings
    }

    /// The vertices with their headings.
    pub fn vertex_poses(&self) -> Vec<Pose> {
        self.vertices
            .iter()
            .zip(self.vertex_headings())
            .map(|(&p, h)| Pose::at(p, h))
            .collect()
    }

    /// The point at arc length `s`, clamped to the line.
    #[inline]
    pub fn point_at(&self, s: f64) -> Point {
        let s = s.clamp(0.0, self.length());
        let segment = self.segment_at(s);
        self.vertices[segment] + self.segment_direction(segment) * (s - self.arc_lengths[segment])
    }

    /// Heading of the segment at arc length `s` (clamped), radians.
    #[inline]
    pub fn heading_at(&self, s: f64) -> f64 {
        self.segment_heading(self.segment_at(s))
    }

    /// Point and segment heading at arc length `s` (clamped).
    #[inline]
    pub fn pose_at(&self, s: f64) -> Pose {
        Pose::at(self.point_at(s), self.heading_at(s))
    }

    /// Pose at arc length `s` (clamped) whose heading turns steadily from vertex to vertex.
    pub fn smooth_pose_at(&self, s: f64) -> Pose {
        let s = s.clamp(0.0, self.length());
        let segment = self.segment_at(s);
        let length = self.arc_lengths[segment + 1] - self.arc_lengths[segment];
        let from = self.segment_heading(segment);
        let to = self.segment_heading((segment + 1).min(self.vertices.len() - 2));
        let share = (s - self.arc_lengths[segment]) / length;
        Pose::at(
            self.point_at(s),
            wrap_angle(from + wrap_angle(to - from) * share),
        )
    }

    /// The point `lateral` meters to the left of the line at arc length `s`.
    #[inline]
    pub fn frenet_to_map(&self, s: f64, lateral: f64) -> Point {
        self.pose_at(s).to_map(Point::new(0.0, lateral))
    }

    /// Nearest point of the line; of several the first.
    pub fn project(&self, point: Point) -> Projection {
        let Nearest {
            squared,
            segment,
            share,
        } = self.nearest(point);
        let length = self.arc_lengths[segment + 1] - self.arc_lengths[segment];
        let direction = self.segment_direction(segment);
        let foot = self.vertices[segment] + direction * (share * length);
        let offset = point - foot;
        let distance = squared.sqrt();
        let side = direction.x * offset.y - direction.y * offset.x;
        Projection {
            s: self.arc_lengths[segment] + share * length,
            lateral: if side < 0.0 { -distance } else { distance },
            distance,
            point: foot,
            heading: self.segment_heading(segment),
        }
    }

    /// The nearest point by segment. Blocks farther than the best so far are skipped.
    fn nearest(&self, point: Point) -> Nearest {
        /// Rounding that the distance to bounds is allowed to be off by, as a share.
        const MARGIN: f64 = 1e-9;
        let mut nearest = Nearest {
            squared: f64::INFINITY,
            segment: 0,
            share: 0.0,
        };
        let last = self.vertices.len() - 1;
        let to_bounds = |block: usize| self.blocks[block].distance_squared(point);
        let promising =
            (0..self.blocks.len()).min_by(|&a, &b| to_bounds(a).total_cmp(&to_bounds(b)));
        let Some(promising) = promising else {
            nearest.look(&self.vertices, point, 0..last);
            return nearest;
        };
        let segments = |block: usize| block * BLOCK..((block + 1) * BLOCK).min(last);
        nearest.look(&self.vertices, point, segments(promising));
        for block in (0..self.blocks.len()).filter(|&block| block != promising) {
            if to_bounds(block) * (1.0 - MARGIN) <= nearest.squared {
                nearest.look(&self.vertices, point, segments(block));
            }
        }
        nearest
    }

    /// nuPlan's nearest pose: the projected point with the heading towards the point 0.5 m further
    /// on.
    pub fn nearest_pose(&self, point: Point) -> Pose {
        let s = self.project(point).s;
        let at = self.point_at(s);
        let length = self.length();
        let d = if s >= length {
            self.end() - self.point_at(length - HEADING_LOOKAHEAD)
        } else {
            self.point_at(s + HEADING_LOOKAHEAD) - at
        };
        Pose::at(at, d.y.atan2(d.x))
    }

    /// Distance from a point to the line, meters.
    pub fn distance_to(&self, point: Point) -> f64 {
        self.project(point).distance
    }

    /// Distance between two lines, meters; 0 when they share a point.
    pub fn distance_to_line(&self, other: &Self) -> f64 {
        let edges = |line: &Self| {
            line.vertices
                .windows(2)
                .map(|w| (w[0], w[1]))
                .collect::<Vec<_>>()
        };
        let (own, theirs) = (edges(self), edges(other));
        if own
            .iter()
            .any(|&(a, b)| theirs.iter().any(|&(c, d)| segments_cross(a, b, c, d)))
        {
            return 0.0;
        }
        let nearest = |from: &Self, to: &Self| {
            from.vertices
                .iter()
                .map(|&vertex| to.distance_to(vertex))
                .fold(f64::INFINITY, f64::min)
        };
        nearest(self, other).min(nearest(other, self))
    }

    /// Signed curvature (1/m, positive when turning left) of the circle through three points around
    /// `s`, 2 m apart where the line is long enough (nuPlan `get_curvature_at_arc_length`).
    pub fn curvature_at(&self, s: f64) -> f64 {
        /// Meters.
        const SPACING: f64 = 2.0;
        let length = self.length();
        let (a, b, c) = if length < 2.0 * SPACING {
            (0.0, length / 2.0, length)
        } else if s - SPACING < 0.0 {
            (0.0, SPACING, 2.0 * SPACING)
        } else if s + SPACING > length {
            (length - 2.0 * SPACING, length - SPACING, length)
        } else {
            (s - SPACING, s, s + SPACING)
        };
        circle_curvature(self.point_at(a), self.point_at(b), self.point_at(c))
    }

    /// The part between two arc lengths (clamped), ends interpolated; `None` when it has no length.
    pub fn slice(&self, from: f64, to: f64) -> Option<Self> {
        let (from, to) = (from.clamp(0.0, self.length()), to.clamp(0.0, self.length()));
        if to - from < SAME_VERTEX {
            return None;
        }
        let inner = self
            .vertices
            .iter()
            .zip(&self.arc_lengths)
            .filter(|&(_, &s)| s > from && s < to)
            .map(|(&p, _)| p);
        let points = std::iter::once(self.point_at(from))
            .chain(inner)
            .chain(std::iter::once(self.point_at(to)));
        Self::new(points).ok()
    }

    /// The line moved sideways, each vertex along its normal, positive to the left.
    pub fn offset(&self, lateral: f64) -> Self {
        let moved: Vec<Point> = self
            .vertex_poses()
            .iter()
            .map(|p| p.to_map(Point::new(0.0, lateral)))
            .collect();
        Self::new(moved).unwrap_or_else(|_| self.clone())
    }

    /// The same line with vertices every `step` meters (the last piece may be shorter).
    pub fn resampled(&self, step: f64) -> Self {
        let count = (self.length() / step).floor() as usize;
        let points = (0..=count)
            .map(|i| self.point_at(i as f64 * step))
            .chain(std::iter::once(self.end()));
        Self::new(points).unwrap_or_else(|_| self.clone())
    }

    /// The same line with vertices added so that none is farther than `spacing` meters from the
    /// next. All vertices stay.
    pub fn densified(&self, spacing: f64) -> Self {
        /// A piece longer than the spacing by this share is not split: maps round coordinates, by
        /// nanometers.
        const ROUNDING: f64 = 1e-6;
        let mut vertices =
            Vec::with_capacity(self.vertices.len() + (self.length() / spacing) as usize);
        for pair in self.vertices.windows(2) {
            let along = pair[1] - pair[0];
            let pieces = (along.norm() / spacing - ROUNDING).ceil().max(1.0);
            vertices.extend((0..pieces as usize).map(|i| pair[0] + along * (i as f64 / pieces)));
        }
        vertices.push(self.end());
        Self::new(vertices).unwrap_or_else(|_| self.clone())
    }

    /// This line followed by another; a shared joint is merged.
    pub fn joined(&self, next: &Self) -> Self {
        let points = self.vertices.iter().chain(&next.vertices).copied();
        Self::new(points).unwrap_or_else(|_| self.clone())
    }
}

/// The nearest point so far.
struct Nearest {
    squared: f64,
    segment: usize,
    share: f64,
}

impl Nearest {
    fn look(&mut self, vertices: &[Point], point: Point, segments: std::ops::Range<usize>) {
        for segment in segments {
            let from = vertices[segment];
            let along = vertices[segment + 1] - from;
            let share = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            let squared = (point - (from + along * share)).norm_squared();
            if squared
                .total_cmp(&self.squared)
                .then(segment.cmp(&self.segment))
                .is_lt()
            {
                *self = Self {
                    squared,
                    segment,
                    share,
                };
            }
        }
    }
}

/// Bounds of each run of [`BLOCK`] segments.
pub(super) fn block_bounds(vertices: &[Point]) -> Vec<Bounds> {
    let last = vertices.len() - 1;
    (0..last)
        .step_by(BLOCK)
        .map(|first| Bounds::around(&vertices[first..=(first + BLOCK).min(last)]))
        .collect()
}

/// Signed curvature of the circle through three points; 0 when they are (nearly) in line.
fn circle_curvature(p: Point, q: Point, r: Point) -> f64 {
    /// nuPlan treats a 16-fold squared area under this as a straight line, m⁴.
    const FLAT: f64 = 1e-6;
    let (a, b, c) = ((q - p).norm(), (r - q).norm(), (r - p).norm());
    let sixteen_area_squared = (a + b + c) * (-a + b + c) * (a - b + c) * (a + b - c);
    if sixteen_area_squared < FLAT {
        return 0.0;
    }
    let turn = (q - p).perp(&(r - q));
    sixteen_area_squared.sqrt() / (a * b * c) * turn.signum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn corner() -> Polyline {
        Polyline::new([
            Point::new(0.0, 0.0),
            Point::new(10.0, 0.0),
            Point::new(10.0, 10.0),
        ])
        .unwrap()
    }

    #[test]
    fn projection_has_arc_length_and_side() {
        let left = corner().project(Point::new(4.0, 2.0));
        assert!((left.s - 4.0).abs() < 1e-12 && (left.lateral - 2.0).abs() < 1e-12);
        let right = corner().project(Point::new(12.0, 5.0));
        assert!((right.s - 15.0).abs() < 1e-12 && (right.lateral + 2.0).abs() < 1e-12);
    }

    #[test]
    fn duplicates_merge_and_too_few_fail() {
        let p = Point::new(1.0, 1.0);
        assert!(matches!(
            Polyline::new([p, p]),
            Err(GeometryError::TooFewVertices { got: 1, .. })
        ));
        assert!(matches!(
            Polyline::new([p, Point::new(f64::NAN, 0.0)]),
            Err(GeometryError::NotFinite { index: 1, .. })
        ));
    }

    #[test]
    fn curvature_of_a_circle_is_one_over_radius() {
        let circle = Polyline::new((0..200).map(|i| {
            let a = f64::from(i) * 0.01;
            Point::new(20.0 * a.cos(), 20.0 * a.sin())
        }))
        .unwrap();
        assert!((circle.curvature_at(10.0) - 0.05).abs() < 1e-4);
    }

    #[test]
    fn slice_interpolates_both_ends() {
        let part = corner().slice(8.0, 13.0).unwrap();
        assert!((part.length() - 5.0).abs() < 1e-12);
        assert_eq!(part.vertices().len(), 3);
        assert!(corner().slice(3.0, 3.0).is_none());
    }

    #[test]
    fn a_dense_line_keeps_its_vertices() {
        let line = corner()
            .joined(&Polyline::new([Point::new(10.0, 10.0), Point::new(10.0, 10.3)]).unwrap());
        let dense = line.densified(0.5);
        assert_eq!(dense.vertices().len(), 20 + 20 + 1 + 1);
        assert!(
            line.vertices()
                .iter()
                .all(|vertex| dense.vertices().contains(vertex))
        );
        assert!(
            dense
                .vertices()
                .windows(2)
                .all(|pair| (pair[1] - pair[0]).norm() < 0.5 + 1e-6)
        );
        assert!((dense.length() - line.length()).abs() < 1e-9);
        assert_eq!(dense.densified(0.5), dense);
    }

    proptest! {
        #[test]
        fn long_lines_project_like_a_plain_scan(
            turns in prop::collection::vec(-0.9..0.9f64, 40..120), x in -60.0..60.0f64, y in -60.0..60.0f64,
        ) {
            let mut at = Pose::default();
            let points: Vec<Point> = turns.iter().map(|turn| {
                at = Pose { heading: at.heading + turn, ..at }.translated(1.5, 0.0);
                at.position()
            }).collect();
            let line = Polyline::new(points).unwrap();
            let point = Point::new(x, y);
            let mut plain = Nearest { squared: f64::INFINITY, segment: 0, share: 0.0 };
            plain.look(line.vertices(), point, 0..line.vertices().len() - 1);
            let found = line.nearest(point);
            prop_assert!(!line.blocks.is_empty());
            prop_assert_eq!((found.squared, found.segment, found.share), (plain.squared, plain.segment, plain.share));
        }

        #[test]
        fn frenet_round_trip_on_a_straight(s in 0.1..99.9f64, d in -20.0..20.0f64, h in -3.0..3.0f64) {
            let start = Pose::new(5.0, -7.0, h);
            let line = Polyline::new((0..=10).map(|i| start.to_map(Point::new(f64::from(i) * 10.0, 0.0)))).unwrap();
            let back = line.project(line.frenet_to_map(s, d));
            prop_assert!((back.s - s).abs() < 1e-9 && (back.lateral - d).abs() < 1e-9);
        }
    }
}
