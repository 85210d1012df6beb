//! The path along which proposals progress (`tuplan_garage` `pdm_path.py`).

use planagent_world::geometry::{GeometryError, Point, Polyline, Pose, unwrap_angles, wrap_angle};

/// Queries never lie nearer to the start than this, meters.
const MIN_PROGRESS: f64 = 1e-5;

/// Rear-axle poses with their progress: cumulated chord length, meters from the first. Repeated
/// poses are kept, so that the heading may jump where two baselines meet.
#[derive(Debug, Clone, PartialEq)]
pub struct PdmPath {
    line: Polyline,
    progress: Vec<f64>,
    /// Headings unwrapped along the path.
    poses: Vec<Pose>,
}

impl PdmPath {
    /// A path through `poses`, map frame.
    ///
    /// # Errors
    /// When a position is not finite or fewer than two are distinct.
    pub fn new(poses: &[Pose]) -> Result<Self, GeometryError> {
        let line = Polyline::new(poses.iter().map(Pose::position))?;
        let headings = unwrap_angles(&poses.iter().map(|pose| pose.heading).collect::<Vec<_>>());
        let mut travelled = 0.0;
        let steps = poses.windows(2).map(|w| {
            travelled += w[0].distance(&w[1]);
            travelled
        });
        let progress = std::iter::once(0.0).chain(steps).collect();
        let poses = poses
            .iter()
            .zip(headings)
            .map(|(pose, heading)| Pose { heading, ..*pose })
            .collect();
        Ok(Self {
            line,
            progress,
            poses,
        })
    }

    /// The same path moved sideways: each pose along its own normal, positive to the left; headings
    /// stay.
    ///
    /// # Errors
    /// When the move folds all poses into one.
    pub fn offset(&self, lateral: f64) -> Result<Self, GeometryError> {
        let moved: Vec<Pose> = self
            .poses
            .iter()
            .map(|pose| pose.translated(0.0, lateral))
            .collect();
        Self::new(&moved)
    }

    /// The line through the poses.
    pub fn line(&self) -> &Polyline {
        &self.line
    }

    /// Progress of the last pose, meters.
    pub fn length(&self) -> f64 {
        self.progress[self.progress.len() - 1]
    }

    /// Progress of the point of the path that is nearest to `point`, meters.
    pub fn project(&self, point: Point) -> f64 {
        self.line.project(point).s
    }

    /// Pose at a progress, clamped to [1e-5 m, length]: position and unwrapped heading linear
    /// between the neighbors.
    pub fn pose_at(&self, progress: f64) -> Pose {
        let progress = self.clamped(progress);
        let after = self
            .progress
            .partition_point(|&p| p < progress)
            .clamp(1, self.progress.len() - 1);
        let (a, b) = (&self.poses[after - 1], &self.poses[after]);
        let (past, step) = (
            progress - self.progress[after - 1],
            self.progress[after] - self.progress[after - 1],
        );
        let mix = |from: f64, to: f64| (to - from) / step * past + from;
        Pose::new(
            mix(a.x, b.x),
            mix(a.y, b.y),
            wrap_angle(mix(a.heading, b.heading)),
        )
    }

    /// The part between two progresses (clamped as in [`Self::pose_at`]). Upstream's shortcut is
    /// kept: with two vertices or more inside, the part runs from the first to the last of them and
    /// its ends are not interpolated. Past the end the last bit of the path stands for a part
    /// without length.
    pub(crate) fn substring(&self, from: f64, to: f64) -> Polyline {
        let (from, to) = (self.clamped(from), self.clamped(to));
        let first = self.progress.partition_point(|&p| p < from);
        let behind = self.progress.partition_point(|&p| p <= to).max(first);
        let inside = Polyline::new(self.poses[first..behind].iter().map(Pose::position));
        let exact = || {
            self.line
                .slice(from, to)
                .or_else(|| self.line.slice(self.length() - MIN_PROGRESS, to))
        };
        inside
            .ok()
            .or_else(exact)
            .unwrap_or_else(|| self.line.clone())
    }

    fn clamped(&self, progress: f64) -> f64 {
        progress.min(self.length()).max(MIN_PROGRESS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn straight(count: usize) -> Vec<Pose> {
        (0..count).map(|i| Pose::new(i as f64, 0.0, 0.0)).collect()
    }

    #[test]
    fn queries_are_clipped_to_the_path() {
        let path = PdmPath::new(&straight(11)).unwrap();
        assert!((path.pose_at(-3.0).x - 1e-5).abs() < 1e-15);
        assert!((path.pose_at(3.25).x - 3.25).abs() < 1e-12);
        assert!((path.pose_at(99.0).x - 10.0).abs() < 1e-12);
        assert!((path.project(Point::new(4.0, 7.0)) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_repeated_joint_lets_the_heading_jump() {
        let mut poses = straight(3);
        poses.extend([
            Pose::new(2.0, 0.0, FRAC_PI_2),
            Pose::new(2.0, 2.0, FRAC_PI_2),
        ]);
        let path = PdmPath::new(&poses).unwrap();
        assert!((path.length() - 4.0).abs() < 1e-12);
        assert!(path.pose_at(1.9).heading.abs() < 1e-12);
        assert!(
            path.pose_at(2.0).heading.abs() < 1e-12,
            "the first of the two"
        );
        assert!((path.pose_at(2.1).heading - FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn headings_turn_the_short_way() {
        let path = PdmPath::new(&[Pose::new(0.0, 0.0, 3.1), Pose::new(-2.0, 0.0, -3.1)]).unwrap();
        assert!((path.pose_at(1.0).heading.abs() - PI).abs() < 1e-9);
    }

    #[test]
    fn a_part_keeps_vertices_only_unless_there_are_too_few() {
        let path = PdmPath::new(&straight(11)).unwrap();
        let ends = |line: Polyline| (line.start().x, line.end().x);
        assert_eq!(ends(path.substring(1.5, 4.5)), (2.0, 4.0));
        let (from, to) = ends(path.substring(1.25, 2.5));
        assert!(
            (from - 1.25).abs() < 1e-12 && (to - 2.5).abs() < 1e-12,
            "one vertex: the exact part"
        );
        let (from, to) = ends(path.substring(20.0, 30.0));
        assert!((from - 9.99999).abs() < 1e-9 && (to - 10.0).abs() < 1e-12);
    }

    #[test]
    fn offsets_keep_headings_and_go_left() {
        let poses = [
            Pose::new(0.0, 0.0, FRAC_PI_2),
            Pose::new(0.0, 5.0, FRAC_PI_2),
        ];
        let left = PdmPath::new(&poses)
            .unwrap()
            .offset(1.0)
            .unwrap()
            .pose_at(2.0);
        assert!((left.x + 1.0).abs() < 1e-12 && (left.heading - FRAC_PI_2).abs() < 1e-12);
    }
}
