//! The path of the recorded ego in few points, for names and thumbnails.

use super::Replay;
use super::deltas::Points;
use planagent_world::geometry::{Point, simplified};
use serde::Serialize;

/// Simplification removes points that are nearer than this to the remaining path, meters: less than
/// a pixel of a thumbnail.
const DETAIL_M: f64 = 0.5;

/// The recorded ego's path.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(in crate::report) struct Sketch {
    /// Map frame, whole centimeters.
    #[serde(flatten)]
    path: Points,
    /// Its length, whole meters.
    meters: u32,
    /// Its duration, whole milliseconds.
    ms: u32,
}

impl Replay {
    /// The sketch of the recorded ego.
    pub(in crate::report) fn sketch(&self) -> Sketch {
        let points: Vec<Point> = self.expert.points().collect();
        let meters: f64 = points
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).norm())
            .sum();
        Sketch {
            path: Points::from_points(&simplified(&points, DETAIL_M)),
            meters: meters.round() as u32,
            ms: self.times_ms.values(1.0).last().unwrap_or_default() as u32,
        }
    }
}
