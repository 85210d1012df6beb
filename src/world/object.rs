//! Objects around the ego.

use crate::geometry::{OrientedBox, Vector};
use std::fmt;

/// nuPlan's tracked object types, the ego apart.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum ObjectKind {
    /// Car, truck, bus.
    Vehicle,
    /// Person on foot.
    Pedestrian,
    /// Bicycle with its rider.
    Bicycle,
    /// Traffic cone.
    TrafficCone,
    /// Barrier.
    Barrier,
    /// Construction-zone sign.
    CzoneSign,
    /// Any other static thing.
    GenericObject,
}

impl ObjectKind {
    /// Whether nuPlan calls it an agent: it has a velocity.
    #[inline]
    pub fn is_agent(self) -> bool {
        matches!(self, Self::Vehicle | Self::Pedestrian | Self::Bicycle)
    }

    /// A typical length and width, meters.
    #[inline]
    pub fn default_size(self) -> (f64, f64) {
        match self {
            Self::Vehicle => (4.6, 1.9),
            Self::Bicycle => (1.8, 0.7),
            Self::Pedestrian => (0.7, 0.7),
            Self::TrafficCone => (0.4, 0.4),
            Self::Barrier | Self::CzoneSign | Self::GenericObject => (2.0, 0.6),
        }
    }

    /// Whether it is a vulnerable road user.
    #[inline]
    pub fn is_vulnerable(self) -> bool {
        matches!(self, Self::Pedestrian | Self::Bicycle)
    }
}

impl fmt::Display for ObjectKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vehicle => "vehicle",
            Self::Pedestrian => "pedestrian",
            Self::Bicycle => "bicycle",
            Self::TrafficCone => "traffic_cone",
            Self::Barrier => "barrier",
            Self::CzoneSign => "czone_sign",
            Self::GenericObject => "generic_object",
        })
    }
}

/// Identity of a track within its scenario.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(transparent)]
pub struct TrackToken(pub u32);

impl fmt::Display for TrackToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// One object at one instant.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrackedObject {
    /// Which track it is.
    pub token: TrackToken,
    /// What it is.
    pub kind: ObjectKind,
    /// Its box, map frame.
    pub shape: OrientedBox,
    /// Its velocity in the map frame, m/s; zero for static objects.
    pub velocity: Vector,
}

impl TrackedObject {
    /// Norm of the velocity, m/s.
    #[inline]
    pub fn speed(&self) -> f64 {
        self.velocity.norm()
    }
}
