//! A path of poses by progress, as nuPlan's IDM agents and IDM planner have it (devkit
//! `path/utils.py`, `interpolated_path.py`).

use crate::geometry::{Pose, unwrap_angles, wrap_angle};

/// A pose nearer than this to its successor is dropped, meters (numpy's `isclose`).
const COINCIDENT: f64 = 1e-8;

/// Poses with their progress: cumulative chord length, meters from the first. At least two poses.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgressPath {
    progress: Vec<f64>,
    /// Headings unwrapped along the path.
    poses: Vec<Pose>,
}

impl ProgressPath {
    /// A path through `poses`; `None` when fewer than two distinct ones remain.
    ///
    /// As in nuPlan, the last pose is dropped (its filter for coincident poses is one element
    /// short), unless only one would be left.
    pub fn new(poses: &[Pose]) -> Option<Self> {
        let mut kept: Vec<Pose> = poses
            .windows(2)
            .filter(|w| w[0].distance(&w[1]) > COINCIDENT)
            .map(|w| w[0])
            .collect();
        if kept.len() < 2 {
            kept.extend(poses.last());
        }
        let [first, .., last] = kept.as_slice() else {
            return None;
        };
        if kept.len() == 2 && first.distance(last) <= COINCIDENT {
            return None;
        }
        // Poses between two are interpolated linearly, which only continuous headings allow.
        let headings = unwrap_angles(&kept.iter().map(|pose| pose.heading).collect::<Vec<_>>());
        let mut travelled = 0.0;
        let steps = kept.windows(2).map(|w| w[0].distance(&w[1]));
        let progress = std::iter::once(0.0).chain(steps.map(|step| {
            travelled += step;
            travelled
        }));
        Some(Self {
            progress: progress.collect(),
            poses: kept
                .iter()
                .zip(headings)
                .map(|(pose, heading)| Pose { heading, ..*pose })
                .collect(),
        })
    }

    /// Progress of the last pose, meters.
    #[inline]
    pub fn length(&self) -> f64 {
        self.progress[self.progress.len() - 1]
    }

    /// Pose at a progress (clamped): position and heading linear between the neighbors.
    #[inline]
    pub fn pose_at(&self, progress: f64) -> Pose {
        let progress = progress.clamp(0.0, self.length());
        let before = self.pose_before(progress);
        let (a, b) = (&self.poses[before], &self.poses[before + 1]);
        let share = (progress - self.progress[before])
            / (self.progress[before + 1] - self.progress[before]);
        let mix = |from: f64, to: f64| from + (to - from) * share;
        Pose::new(
            mix(a.x, b.x),
            mix(a.y, b.y),
            wrap_angle(mix(a.heading, b.heading)),
        )
    }

    /// The poses from `from` to `to` (clamped), both ends interpolated. As in nuPlan, a part that
    /// begins at the very end has the last two poses of the path, and one that ends at the very
    /// start the first two (devkit `trim_path`, `trim_path_up_to_progress`).
    pub fn between(&self, from: f64, to: f64) -> Vec<Pose> {
        let (from, to) = (from.clamp(0.0, self.length()), to.clamp(0.0, self.length()));
        if from >= self.length() {
            return self.poses[self.poses.len() - 2..].to_vec();
        }
        if to <= 0.0 {
            return self.poses[..2].to_vec();
        }
        let first = self.progress.partition_point(|&p| p <= from);
        let after = self.progress.partition_point(|&p| p < to).max(first);
        let inner = self.poses[first..after].iter().copied();
        std::iter::once(self.pose_at(from))
            .chain(inner)
            .chain(std::iter::once(self.pose_at(to)))
            .collect()
    }

    /// Index of the last pose at or before a progress, the final one excepted.
    fn pose_before(&self, progress: f64) -> usize {
        let after = self.progress.partition_point(|&p| p <= progress);
        after.saturating_sub(1).min(self.progress.len() - 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(count: usize) -> Vec<Pose> {
        (0..count).map(|i| Pose::new(i as f64, 0.0, 0.0)).collect()
    }

    #[test]
    fn the_last_pose_is_dropped_and_repeated_ones_merge() {
        let path = ProgressPath::new(&straight(11)).unwrap();
        assert!((path.length() - 9.0).abs() < 1e-12);
        let mut repeated = straight(6);
        repeated.insert(3, repeated[3]);
        assert!((ProgressPath::new(&repeated).unwrap().length() - 4.0).abs() < 1e-12);
    }

    #[test]
    fn two_poses_are_kept_and_one_is_no_path() {
        assert!((ProgressPath::new(&straight(2)).unwrap().length() - 1.0).abs() < 1e-12);
        assert_eq!(ProgressPath::new(&straight(1)), None);
        assert_eq!(ProgressPath::new(&[Pose::default(); 4]), None);
        assert_eq!(ProgressPath::new(&[]), None);
    }

    #[test]
    fn headings_turn_the_short_way_between_poses() {
        let path = ProgressPath::new(&[
            Pose::new(0.0, 0.0, 3.1),
            Pose::new(-2.0, 0.0, -3.1),
            Pose::new(-4.0, 0.0, -3.1),
        ])
        .unwrap();
        let middle = path.pose_at(1.0);
        assert!((middle.heading.abs() - std::f64::consts::PI).abs() < 1e-9);
        assert!(
            (path.pose_at(99.0).x + 2.0).abs() < 1e-12,
            "clamped to the end"
        );
    }

    #[test]
    fn a_part_has_interpolated_ends() {
        let part = ProgressPath::new(&straight(11)).unwrap().between(1.5, 4.0);
        let xs: Vec<f64> = part.iter().map(|pose| pose.x).collect();
        assert_eq!(xs, [1.5, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn at_its_ends_a_path_gives_its_outermost_poses() {
        let path = ProgressPath::new(&straight(11)).unwrap();
        let xs = |from: f64, to: f64| {
            path.between(from, to)
                .iter()
                .map(|pose| pose.x)
                .collect::<Vec<_>>()
        };
        assert_eq!(xs(9.0, 9.0), [8.0, 9.0]);
        assert_eq!(xs(12.0, 15.0), [8.0, 9.0]);
        assert_eq!(xs(-4.0, 0.0), [0.0, 1.0]);
        assert_eq!(xs(8.5, 20.0), [8.5, 9.0]);
    }
}
