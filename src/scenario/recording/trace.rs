//! Lines of the map with their height, and rays that look for them.

use crate::geometry::{Bounds, Point, Polyline, SpatialIndex, Vector};

/// A place of a recorded map: east, north, up, metres.
pub(in crate::scenario) type Place = nalgebra::Point3<f64>;

/// Two places nearer in height than this are on one level: less than a bridge is high, more than a road is banked, metres.
pub(in crate::scenario) const SAME_LEVEL: f64 = 3.0;

/// A map ends nearer to the ego than this, metres: recorded maps end after some hundred.
const FARTHEST: f64 = 20_000.0;
/// No line of a map is longer, metres.
const LONGEST: f64 = 100_000.0;

/// Why points are no line or outline of a map.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LineFault {
    /// A map coordinate is NaN, infinite or farther from the ego than any map reaches.
    #[error("map feature {feature}: point {point} is no place near the ego")]
    NoPlace {
        /// Id of the feature.
        feature: i64,
        /// Which of its points.
        point: usize,
    },
    /// A line of the map is longer than any road that fits the map.
    #[error("map feature {feature} is {length} m long")]
    EndlessLine {
        /// Id of the feature.
        feature: i64,
        /// Its length, m.
        length: f64,
    },
}

/// A line of the map in local coordinates.
#[derive(Debug, Clone)]
pub(in crate::scenario) struct Trace {
    pub(in crate::scenario) line: Polyline,
    /// Height of each vertex of the line, metres.
    heights: Vec<f64>,
    /// Arc length of each recorded point; duplicates share one.
    pub(in crate::scenario) point_s: Vec<f64>,
}

impl Trace {
    /// `None` when the points are not two distinct ones: there are such features, and they bound nothing.
    ///
    /// # Errors
    /// When a coordinate is no place, or the line is endless.
    pub(in crate::scenario) fn of(feature: i64, points: &[Place], origin: Vector) -> Result<Option<Self>, LineFault> {
        /// Points nearer than this are one, metres.
        const SAME_POINT: f64 = 1e-6;
        let local = local_points(feature, points, origin)?;
        let (mut vertices, mut heights, mut point_s): (Vec<Point>, Vec<f64>, Vec<f64>) = Default::default();
        let mut s = 0.0;
        for (&point, place) in local.iter().zip(points) {
            let step = vertices.last().map_or(f64::INFINITY, |last| (point - last).norm());
            if step > SAME_POINT {
                s += if step.is_finite() { step } else { 0.0 };
                vertices.push(point);
                heights.push(if place.z.is_finite() { place.z } else { 0.0 });
            }
            point_s.push(s);
        }
        if s > LONGEST {
            return Err(LineFault::EndlessLine { feature, length: s });
        }
        Ok(Polyline::new(vertices).ok().map(|line| Self { line, heights, point_s }))
    }

    /// Arc length of a recorded point, clamped to the line.
    pub(in crate::scenario) fn s_of(&self, point: i32) -> f64 {
        let last = self.point_s.len().saturating_sub(1);
        self.point_s.get((point.max(0) as usize).min(last)).copied().unwrap_or(0.0)
    }

    /// Height at an arc length, metres.
    pub(in crate::scenario) fn height_at(&self, s: f64) -> f64 {
        let arcs = self.line.arc_lengths();
        let after = arcs.partition_point(|&a| a < s).min(arcs.len() - 1);
        let before = after.saturating_sub(1);
        let length = arcs[after] - arcs[before];
        let share = if length > 0.0 { ((s - arcs[before]) / length).clamp(0.0, 1.0) } else { 0.0 };
        self.heights[before] + (self.heights[after] - self.heights[before]) * share
    }

    /// Unit vector along the line at an arc length, smoothed over a lane's sampling distance.
    pub(in crate::scenario) fn direction_at(&self, s: f64) -> Vector {
        /// Half the distance over which the direction is taken, metres.
        const REACH: f64 = 0.75;
        let s = s.clamp(0.0, self.line.length());
        let along = self.line.point_at(s + REACH) - self.line.point_at(s - REACH);
        along.try_normalize(1e-9).unwrap_or_else(|| self.line.pose_at(s).direction())
    }

    /// Arc lengths about `step` metres apart, both ends included.
    pub(in crate::scenario) fn stations(&self, step: f64) -> Vec<f64> {
        let length = self.line.length();
        let count = (length / step).ceil().max(1.0) as usize;
        (0..=count).map(|i| length * i as f64 / count as f64).collect()
    }
}

/// Recorded points in local coordinates.
///
/// # Errors
/// When one is no place.
pub(in crate::scenario) fn local_points(
    feature: i64,
    points: &[Place],
    origin: Vector,
) -> Result<Vec<Point>, LineFault> {
    let local: Vec<Point> = points.iter().map(|p| Point::new(p.x - origin.x, p.y - origin.y)).collect();
    match local.iter().position(|p| !p.coords.norm().is_finite() || p.coords.norm() > FARTHEST) {
        Some(point) => Err(LineFault::NoPlace { feature, point }),
        None => Ok(local),
    }
}

/// A piece of a line with the number of the line that it belongs to.
#[derive(Debug, Clone, Copy)]
pub(in crate::scenario) struct Segment {
    pub(in crate::scenario) from: Point,
    pub(in crate::scenario) to: Point,
    pub(in crate::scenario) height: f64,
    pub(in crate::scenario) owner: usize,
}

/// Many lines, cut into segments and indexed.
#[derive(Debug)]
pub(in crate::scenario) struct Segments {
    list: Vec<Segment>,
    index: SpatialIndex,
}

impl Segments {
    /// The segments of all lines; the n-th line's have owner n.
    pub(in crate::scenario) fn of<'a>(traces: impl IntoIterator<Item = &'a Trace>) -> Self {
        let mut list = Vec::new();
        for (owner, trace) in traces.into_iter().enumerate() {
            for (i, pair) in trace.line.vertices().windows(2).enumerate() {
                let height = f64::midpoint(trace.heights[i], trace.heights[i + 1]);
                list.push(Segment { from: pair[0], to: pair[1], height, owner });
            }
        }
        let index = SpatialIndex::new(list.iter().map(|s| Bounds::around(&[s.from, s.to])));
        Self { list, index }
    }

    pub(in crate::scenario) fn list(&self) -> &[Segment] {
        &self.list
    }

    /// Segments whose bounds meet the given ones.
    pub(in crate::scenario) fn within<'a>(&'a self, bounds: &Bounds) -> impl Iterator<Item = &'a Segment> + use<'a> {
        self.index.within(bounds).into_iter().map(|i| &self.list[i])
    }

    /// Distance along the ray to the first segment on its level that `counts`.
    pub(in crate::scenario) fn first_hit(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> Option<f64> {
        self.hits(ray, counts).min_by(f64::total_cmp)
    }

    /// Distance along the ray to the last segment on its level that `counts`.
    pub(in crate::scenario) fn last_hit(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> Option<f64> {
        self.hits(ray, counts).max_by(f64::total_cmp)
    }

    fn hits(&self, ray: &Ray, counts: impl Fn(&Segment) -> bool) -> impl Iterator<Item = f64> {
        let bounds = Bounds::around(&[ray.from, ray.from + ray.direction * ray.reach]);
        let level = self.within(&bounds).filter(move |s| (s.height - ray.height).abs() < SAME_LEVEL && counts(s));
        level.filter_map(|segment| ray.meets(segment.from, segment.to))
    }
}

/// A look sideways.
#[derive(Debug, Clone, Copy)]
pub(in crate::scenario) struct Ray {
    pub(in crate::scenario) from: Point,
    /// Unit vector.
    pub(in crate::scenario) direction: Vector,
    pub(in crate::scenario) height: f64,
    pub(in crate::scenario) reach: f64,
}

impl Ray {
    /// Distance at which the ray meets a segment, if it does.
    pub(in crate::scenario) fn meets(&self, from: Point, to: Point) -> Option<f64> {
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
        let points: Vec<Place> = points.iter().map(|&(x, y, z)| Place::new(x, y, z)).collect();
        Trace::of(1, &points, Vector::zeros()).unwrap().unwrap()
    }

    #[test]
    fn repeated_points_share_their_arc_length() {
        let line = trace(&[(0.0, 0.0, 0.0), (0.0, 0.0, 5.0), (4.0, 0.0, 2.0), (8.0, 0.0, 2.0)]);
        assert_eq!(line.point_s, vec![0.0, 0.0, 4.0, 8.0]);
        assert!((line.height_at(2.0) - 1.0).abs() < 1e-12);
        assert!((line.s_of(99) - 8.0).abs() < 1e-12 && line.s_of(-3).abs() < 1e-12);
    }

    #[test]
    fn rays_stop_at_the_first_line_of_their_level() {
        let near_bridge = trace(&[(-5.0, 2.0, 8.0), (5.0, 2.0, 8.0)]);
        let far = trace(&[(-5.0, 3.0, 0.0), (5.0, 3.0, 0.0)]);
        let segments = Segments::of([&near_bridge, &far]);
        let ray = Ray { from: Point::origin(), direction: Vector::y(), height: 0.0, reach: 10.0 };
        assert!((segments.first_hit(&ray, |_| true).unwrap() - 3.0).abs() < 1e-12);
        assert!(segments.first_hit(&Ray { reach: 2.9, ..ray }, |_| true).is_none());
        assert!(segments.first_hit(&ray, |s| s.owner == 0).is_none());
    }

    #[test]
    fn no_place_is_refused() {
        let points = [Place::origin(), Place::new(f64::NAN, 0.0, 0.0)];
        let fault = Trace::of(9, &points, Vector::zeros()).unwrap_err();
        assert_eq!(fault, LineFault::NoPlace { feature: 9, point: 1 });
        assert!(Trace::of(9, &points[..1], Vector::zeros()).unwrap().is_none());
    }
}
