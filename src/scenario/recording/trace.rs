//! Lines of the map with heights, and rays that look for them.

use super::error::RecordingFault;
use planagent_world::geometry::{Bounds, Point, Polyline, SpatialIndex, Vector};

/// A point of a recorded map: east, north, up, meters.
pub(crate) type Place = nalgebra::Point3<f64>;

/// Maximum difference in height on one level, meters: less than the height of a bridge, more than
/// the bank of a road.
pub(crate) const SAME_LEVEL: f64 = 3.0;

/// Maximum distance of a map point from the ego, meters; recorded maps end after some hundred.
const MAX_DISTANCE: f64 = 20_000.0;
/// Maximum length of a line, meters.
const MAX_LENGTH: f64 = 100_000.0;

/// A line of the map in local coordinates.
#[derive(Debug, Clone)]
pub(crate) struct Trace {
    pub(crate) line: Polyline,
    /// Height of each vertex, meters.
    heights: Vec<f64>,
    /// Arc length of each recorded point; duplicates share one.
    pub(crate) point_s: Vec<f64>,
}

impl Trace {
    /// `None` without two distinct points; such features exist and bound nothing.
    pub(crate) fn from_points(
        feature: i64,
        points: &[Place],
        origin: Vector,
    ) -> Result<Option<Self>, RecordingFault> {
        /// Points nearer than this are the same, meters.
        const SAME_POINT: f64 = 1e-6;
        let local = local_points(feature, points, origin)?;
        let (mut vertices, mut heights, mut point_s): (Vec<Point>, Vec<f64>, Vec<f64>) =
            Default::default();
        let mut s = 0.0;
        for (&point, place) in local.iter().zip(points) {
            let step = vertices
                .last()
                .map_or(f64::INFINITY, |last| (point - last).norm());
            if step > SAME_POINT {
                s += if step.is_finite() { step } else { 0.0 };
                vertices.push(point);
                heights.push(if place.z.is_finite() { place.z } else { 0.0 });
            }
            // Dropped points have a place too, because other features name points by their number.
            point_s.push(s);
        }
        if s > MAX_LENGTH {
            return Err(RecordingFault::EndlessLine { feature, length: s });
        }
        Ok(Polyline::new(vertices).ok().map(|line| Self {
            line,
            heights,
            point_s,
        }))
    }

    /// Arc length of a recorded point, clamped to the line.
    pub(crate) fn s_of(&self, point: i32) -> f64 {
        let last = self.point_s.len().saturating_sub(1);
        self.point_s
            .get((point.max(0) as usize).min(last))
            .copied()
            .expect("a line has one recorded point at least")
    }

    /// Height at an arc length, meters.
    pub(crate) fn height_at(&self, s: f64) -> f64 {
        let arcs = self.line.arc_lengths();
        let after = arcs.partition_point(|&a| a < s).min(arcs.len() - 1);
        let before = after.saturating_sub(1);
        let length = arcs[after] - arcs[before];
        let share = if length > 0.0 {
            ((s - arcs[before]) / length).clamp(0.0, 1.0)
        } else {
            0.0
        };
        self.heights[before] + (self.heights[after] - self.heights[before]) * share
    }

    /// Unit vector along the line at an arc length, smoothed over the sampling distance of a lane.
    pub(crate) fn direction_at(&self, s: f64) -> Vector {
        /// Half of that distance, meters.
        const REACH: f64 = 0.75;
        let s = s.clamp(0.0, self.line.length());
        let along = self.line.point_at(s + REACH) - self.line.point_at(s - REACH);
        along
            .try_normalize(1e-9)
            .unwrap_or_else(|| self.line.pose_at(s).direction())
    }

    /// Arc lengths about `step` meters apart, both ends included.
    pub(crate) fn stations(&self, step: f64) -> Vec<f64> {
        let length = self.line.length();
        let count = (length / step).ceil().max(1.0) as usize;
        (0..=count)
            .map(|i| length * i as f64 / count as f64)
            .collect()
    }
}

/// Recorded points in local coordinates.
pub(crate) fn local_points(
    feature: i64,
    points: &[Place],
    origin: Vector,
) -> Result<Vec<Point>, RecordingFault> {
    let local: Vec<Point> = points
        .iter()
        .map(|p| Point::new(p.x - origin.x, p.y - origin.y))
        .collect();
    match local
        .iter()
        .position(|p| !p.coords.norm().is_finite() || p.coords.norm() > MAX_DISTANCE)
    {
        Some(point) => Err(RecordingFault::NoPlace { feature, point }),
        None => Ok(local),
    }
}

/// A segment of a line, with the index of the line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Segment {
    pub(crate) from: Point,
    pub(crate) to: Point,
    pub(crate) height: f64,
    pub(crate) owner: usize,
}

/// The segments of many lines in a spatial index.
#[derive(Debug)]
pub(crate) struct Segments {
    list: Vec<Segment>,
    index: SpatialIndex,
}

impl Segments {
    /// The segments of the n-th line have owner n.
    pub(crate) fn from_traces<'a>(traces: impl IntoIterator<Item = &'a Trace>) -> Self {
        let mut list = Vec::new();
        for (owner, trace) in traces.into_iter().enumerate() {
            for (i, pair) in trace.line.vertices().windows(2).enumerate() {
                let height = f64::midpoint(trace.heights[i], trace.heights[i + 1]);
                list.push(Segment {
                    from: pair[0],
                    to: pair[1],
                    height,
                    owner,
                });
            }
        }
        let index = SpatialIndex::new(list.iter().map(|s| Bounds::around(&[s.from, s.to])));
        Self { list, index }
    }

    pub(crate) fn list(&self) -> &[Segment] {
        &self.list
    }

    /// Segments whose bounds meet the given ones.
    pub(crate) fn within<'a>(
        &'a self,
        bounds: &Bounds,
    ) -> impl Iterator<Item = &'a Segment> + use<'a> {
        self.index.within(bounds).into_iter().map(|i| &self.list[i])
    }

    /// Distance along the ray to the first segment on its level that `counts`.
    pub(crate) fn first_hit(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> Option<f64> {
        self.hits(ray, counts).min_by(f64::total_cmp)
    }

    /// Distance along the ray to the last segment on its level that `counts`.
    pub(crate) fn last_hit(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> Option<f64> {
        self.hits(ray, counts).max_by(f64::total_cmp)
    }

    fn hits(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> impl Iterator<Item = f64> {
        let bounds = Bounds::around(&[ray.from, ray.from + ray.direction * ray.reach]);
        let level = self
            .within(&bounds)
            .filter(move |s| (s.height - ray.height).abs() < SAME_LEVEL && counts(s));
        level.filter_map(|segment| ray.meets(segment.from, segment.to))
    }
}

/// A horizontal ray.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) from: Point,
    /// Unit vector.
    pub(crate) direction: Vector,
    pub(crate) height: f64,
    pub(crate) reach: f64,
}

impl Ray {
    /// Distance along the ray to a segment, if they meet.
    pub(crate) fn meets(&self, from: Point, to: Point) -> Option<f64> {
        let along = to - from;
        let turn = self.direction.perp(&along);
        if turn.abs() < 1e-12 {
            return None;
        }
        let gap = from - self.from;
        let (distance, share) = (gap.perp(&along) / turn, gap.perp(&self.direction) / turn);
        ((0.0..=1.0).contains(&share) && (0.0..=self.reach).contains(&distance)).then_some(distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(points: &[(f64, f64, f64)]) -> Trace {
        let points: Vec<Place> = points
            .iter()
            .map(|&(x, y, z)| Place::new(x, y, z))
            .collect();
        Trace::from_points(1, &points, Vector::zeros())
            .unwrap()
            .unwrap()
    }

    #[test]
    fn repeated_points_share_their_arc_length() {
        let line = trace(&[
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 5.0),
            (4.0, 0.0, 2.0),
            (8.0, 0.0, 2.0),
        ]);
        assert_eq!(line.point_s, vec![0.0, 0.0, 4.0, 8.0]);
        assert!((line.height_at(2.0) - 1.0).abs() < 1e-12);
        assert!((line.s_of(99) - 8.0).abs() < 1e-12 && line.s_of(-3).abs() < 1e-12);
    }

    #[test]
    fn rays_stop_at_the_first_line_of_their_level() {
        let near_bridge = trace(&[(-5.0, 2.0, 8.0), (5.0, 2.0, 8.0)]);
        let far = trace(&[(-5.0, 3.0, 0.0), (5.0, 3.0, 0.0)]);
        let segments = Segments::from_traces([&near_bridge, &far]);
        let ray = Ray {
            from: Point::origin(),
            direction: Vector::y(),
            height: 0.0,
            reach: 10.0,
        };
        assert!((segments.first_hit(&ray, |_| true).unwrap() - 3.0).abs() < 1e-12);
        assert!(
            segments
                .first_hit(&Ray { reach: 2.9, ..ray }, |_| true)
                .is_none()
        );
        assert!(segments.first_hit(&ray, |s| s.owner == 0).is_none());
    }

    #[test]
    fn points_far_away_are_refused() {
        let points = [Place::origin(), Place::new(f64::NAN, 0.0, 0.0)];
        let fault = Trace::from_points(9, &points, Vector::zeros()).unwrap_err();
        assert_eq!(
            fault,
            RecordingFault::NoPlace {
                feature: 9,
                point: 1
            }
        );
        assert!(
            Trace::from_points(9, &points[..1], Vector::zeros())
                .unwrap()
                .is_none()
        );
    }
}
