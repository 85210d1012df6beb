//! The line that a driver follows, sampled evenly so that queries are cheap.

use crate::generator::road::Roads;
use planagent_world::geometry::{Point, Polyline, Pose, Vector, unwrap_angles};
use planagent_world::{LaneId, LanePath};

/// Distance between samples, meters.
const SPACING: f64 = 1.0;
/// Maximum lateral acceleration in bends, m/s².
const LATERAL_ACCELERATION: f64 = 1.8;
/// Deceleration toward bends and lower limits, m/s².
const ANTICIPATION: f64 = 0.9;
/// Speed on a connector without limits around it, m/s.
const UNLIMITED: f64 = 13.4;

/// Samples to each side over which headings are averaged.
const SMOOTHED: usize = 2;

/// A lane of the track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    pub(crate) lane: LaneId,
    /// Start, meters along the track.
    pub(crate) from: f64,
    /// End, meters along the track.
    pub(crate) to: f64,
    pub(crate) connector: bool,
}

/// A line along lanes with the allowed speeds.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    /// Even samples; their headings are not wrapped.
    poses: Vec<Pose>,
    /// Unit vectors along the headings.
    directions: Vec<Vector>,
    curvature: Vec<f64>,
    allowed: Vec<f64>,
    /// Lanes in driving order.
    pub(crate) spans: Vec<Span>,
    /// Crosswalks: start and end, meters along the track.
    pub(crate) crosswalks: Vec<[f64; 2]>,
    length: f64,
}

impl Track {
    /// The track along connected lanes; `None` when there are none.
    pub(crate) fn along(roads: &Roads, lanes: Vec<LaneId>) -> Option<Self> {
        let map = &roads.map;
        let path = LanePath::from_lanes(map, lanes)?;
        let length = path.centerline.length();
        let poses = sample(&path.centerline);
        let directions = poses.iter().map(Pose::direction).collect();
        let last = poses.len() - 1;
        let curvature: Vec<f64> = (0..=last)
            .map(|i| {
                let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
                (poses[b].heading - poses[a].heading) / ((b - a) as f64 * SPACING)
            })
            .collect();
        let ends = path.starts.iter().skip(1).copied().chain([length]);
        let spans: Vec<Span> = path
            .lanes
            .iter()
            .zip(path.starts.iter().copied().zip(ends))
            .map(|(&lane, (from, to))| Span {
                lane,
                from,
                to,
                connector: map[lane].is_connector(),
            })
            .collect();
        let limit = |span: &Span| {
            map[span.lane].speed_limit.unwrap_or_else(|| {
                let around = map[span.lane]
                    .incoming
                    .iter()
                    .chain(&map[span.lane].outgoing);
                around
                    .filter_map(|&lane| map[lane].speed_limit)
                    .fold(f64::INFINITY, f64::min)
                    .min(UNLIMITED + 20.0)
            })
        };
        let mut allowed = Vec::with_capacity(poses.len());
        for (i, &bend) in curvature.iter().enumerate() {
            let s = i as f64 * SPACING;
            let span = spans.iter().find(|span| s < span.to).or(spans.last());
            let by_sign = span.map_or(UNLIMITED, limit);
            allowed.push(by_sign.min((LATERAL_ACCELERATION / bend.abs().max(1e-4)).sqrt()));
        }
        // Backward, so that a driver slows down before a bend and not in it.
        for i in (0..last).rev() {
            let onward: f64 = allowed[i + 1];
            allowed[i] = allowed[i].min((onward * onward + 2.0 * ANTICIPATION * SPACING).sqrt());
        }
        let mut track = Self {
            poses,
            directions,
            curvature,
            allowed,
            spans,
            crosswalks: Vec::new(),
            length,
        };
        track.crosswalks = track.find_crosswalks(roads);
        Some(track)
    }

    fn find_crosswalks(&self, roads: &Roads) -> Vec<[f64; 2]> {
        let mut found: Vec<[f64; 2]> = Vec::new();
        for walk in roads.map.crosswalks() {
            let bounds = walk.bounds();
            let on =
                |pose: &Pose| bounds.contains(pose.position()) && walk.contains(pose.position());
            let first = self.poses.iter().position(on);
            let last = self.poses.iter().rposition(on);
            if let (Some(first), Some(last)) = (first, last) {
                found.push([
                    (first as f64 - 0.5) * SPACING,
                    (last as f64 + 0.5) * SPACING,
                ]);
            }
        }
        found.sort_by(|a, b| a[0].total_cmp(&b[0]));
        found
    }

    /// Meters.
    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    /// Index of the sample before `s`, and the share of the distance to the next one.
    fn place(&self, s: f64) -> (usize, f64) {
        let at = (s / SPACING).clamp(0.0, (self.poses.len() - 1) as f64);
        let i = (at as usize).min(self.poses.len() - 2);
        (i, at - i as f64)
    }

    /// Pose at arc length `s` (clamped). The heading is not wrapped.
    pub(crate) fn pose_at(&self, s: f64) -> Pose {
        let (i, share) = self.place(s);
        let (a, b) = (self.poses[i], self.poses[i + 1]);
        Pose::new(
            a.x + (b.x - a.x) * share,
            a.y + (b.y - a.y) * share,
            a.heading + (b.heading - a.heading) * share,
        )
    }

    /// Curvature at arc length `s`, 1/m.
    pub(crate) fn curvature_at(&self, s: f64) -> f64 {
        let (i, share) = self.place(s);
        self.curvature[i] + (self.curvature[i + 1] - self.curvature[i]) * share
    }

    /// Speed that limits and bends at `s` and behind it allow, m/s.
    pub(crate) fn allowed_at(&self, s: f64) -> f64 {
        let (i, share) = self.place(s);
        self.allowed[i] + (self.allowed[i + 1] - self.allowed[i]) * share
    }

    /// Arc length and signed distance of the point of the track nearest to `point`, searched
    /// between two arc lengths.
    pub(crate) fn project(&self, point: Point, from: f64, to: f64) -> (f64, f64) {
        /// Poses from one that is compared to the next; those between are compared around the best.
        const STRIDE: usize = 4;
        let last = self.poses.len() - 1;
        let first = ((from / SPACING).max(0.0) as usize).min(last);
        let end = ((to / SPACING).max(0.0).ceil() as usize).clamp(first, last);
        let squared = |i: usize| {
            let pose = &self.poses[i];
            (pose.x - point.x).powi(2) + (pose.y - point.y).powi(2)
        };
        let mut best = first;
        let mut nearest = f64::INFINITY;
        for i in (first..=end).step_by(STRIDE) {
            let distance = squared(i);
            if distance < nearest {
                (nearest, best) = (distance, i);
            }
        }
        for i in best.saturating_sub(STRIDE - 1).max(first)..=(best + STRIDE - 1).min(end) {
            let distance = squared(i);
            if distance < nearest {
                (nearest, best) = (distance, i);
            }
        }
        let (d, along) = (point - self.poses[best].position(), self.directions[best]);
        (best as f64 * SPACING + along.dot(&d), along.perp(&d))
    }

    /// As [`Self::project`] over the whole track, consistent with [`Self::pose_at`] to less than a
    /// millimeter.
    pub(crate) fn project_exactly(&self, point: Point) -> (f64, f64) {
        /// Steps of the refinement, each of which projects on the tangent.
        const STEPS: usize = 4;
        let (mut s, mut lateral) = self.project(point, 0.0, self.length);
        for _ in 0..STEPS {
            let local = self.pose_at(s).to_local(point);
            s = (s + local.x).clamp(0.0, self.length);
            lateral = local.y;
        }
        (s, lateral)
    }

    /// Unit vector along the track near arc length `s`.
    pub(crate) fn direction_at(&self, s: f64) -> Vector {
        self.directions[((s / SPACING).round().max(0.0) as usize).min(self.directions.len() - 1)]
    }

    pub(crate) fn span_at(&self, s: f64) -> Span {
        let place = self
            .spans
            .partition_point(|span| span.to <= s)
            .min(self.spans.len() - 1);
        self.spans[place]
    }
}

/// Even samples of a line, with the headings of the chords between neighbors.
fn sample(line: &Polyline) -> Vec<Pose> {
    let count = (line.length() / SPACING).floor().max(1.0) as usize;
    let points: Vec<Point> = (0..=count)
        .map(|i| line.point_at(i as f64 * SPACING))
        .collect();
    let chords: Vec<f64> = (0..=count)
        .map(|i| points[(i + 1).min(count)] - points[i.saturating_sub(1)])
        .map(|d| d.y.atan2(d.x))
        .collect();
    let chords = unwrap_angles(&chords);
    // Lines have corners at their vertices. Drivers steer along a smoothed heading.
    let headings = (0..=count).map(|i| {
        // The same number of samples to both sides keeps the average in place.
        let reach = SMOOTHED.min(i).min(count - i);
        chords[i - reach..=i + reach].iter().sum::<f64>() / (2 * reach + 1) as f64
    });
    points
        .into_iter()
        .zip(headings)
        .map(|(point, heading)| Pose::at(point, heading))
        .collect()
}
