//! The versions of a plan between which monitoring chooses.

use super::ride::Ride;
use planagent_score::pdm::SPEED_FRACTIONS;

/// A version of a plan: slower, or to the side within its lane, by the fractions and offsets of
/// PDM-Closed's proposals, or a hard stop. The first is the plan itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Version {
    /// Index of its path in [`LATERAL_OFFSETS`].
    ///
    /// [`LATERAL_OFFSETS`]: planagent_score::pdm::LATERAL_OFFSETS
    pub(super) path: usize,
    /// Its share of the desired speed.
    pub(super) fraction: f64,
    /// Whether it comes to that speed as fast as the code allows, whatever the ride.
    pub(super) is_brisk: bool,
}

impl Version {
    /// The plan itself.
    pub const PLAN: Self = Self {
        path: 0,
        fraction: 1.0,
        is_brisk: false,
    };
    /// A stop on the plan's own path, at the highest deceleration that a code may contain.
    pub const STOP: Self = Self {
        path: 0,
        fraction: 0.0,
        is_brisk: true,
    };

    /// The versions along a path, the fastest first. On the plan's own path, those that slow down
    /// gently come before those that brake; to the side the ego evades something.
    pub(super) fn along(path: usize, ride: Ride) -> Vec<Self> {
        let fractions = || SPEED_FRACTIONS.into_iter().rev();
        let version = |is_brisk| {
            move |fraction| Self {
                path,
                fraction,
                is_brisk,
            }
        };
        let slower = fractions().skip(1);
        match (ride, path) {
            (Ride::Idm, _) => fractions().map(version(false)).collect(),
            (Ride::Comfortable, 0) => fractions()
                .map(version(false))
                .chain(slower.map(version(true)))
                .collect(),
            (Ride::Comfortable, _) => fractions()
                .take(1)
                .map(version(false))
                .chain(slower.map(version(true)))
                .collect(),
        }
    }

    /// Whether it moves along the path of the plan itself.
    pub fn is_on_own_path(self) -> bool {
        self.path == 0 && self != Self::STOP
    }
}
