//! Agents and obstacles on the nodes, with names that planner code can use.

use super::NodePlace;
use crate::environment::choice::choice;
use planagent_world::{ObjectKind, TrackToken};
use std::fmt;
use std::str::FromStr;

choice! {
    /// Class of an object in its name.
    pub enum AgentClass {
        Vehicle = "vehicle",
        Bicycle = "bicycle",
        Pedestrian = "pedestrian",
        /// A cone, barrier, sign or other static object.
        Obstacle = "obstacle",
    }
}

impl From<ObjectKind> for AgentClass {
    fn from(kind: ObjectKind) -> Self {
        match kind {
            ObjectKind::Vehicle => Self::Vehicle,
            ObjectKind::Bicycle => Self::Bicycle,
            ObjectKind::Pedestrian => Self::Pedestrian,
            ObjectKind::TrafficCone
            | ObjectKind::Barrier
            | ObjectKind::CzoneSign
            | ObjectKind::GenericObject => Self::Obstacle,
        }
    }
}

/// Name of an agent within one scene: its class and a number from 1, written together: `vehicle1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AgentName {
    pub class: AgentClass,
    /// Its number within the class, from 1.
    pub number: u16,
}

/// A text that names no agent.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no agent's name (a name is a kind and a number, like vehicle1)")]
pub struct UnknownAgent(pub String);

impl fmt::Display for AgentName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.class, self.number)
    }
}

impl FromStr for AgentName {
    type Err = UnknownAgent;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let unknown = || UnknownAgent(text.to_owned());
        let digits = text
            .find(|c: char| c.is_ascii_digit())
            .ok_or_else(unknown)?;
        let (class, number) = text.split_at(digits);
        // `007` or `+7` would be a second spelling of `7`.
        if number.starts_with('0') || !number.bytes().all(|b| b.is_ascii_digit()) {
            return Err(unknown());
        }
        let class = class.parse().map_err(|_| unknown())?;
        Ok(Self {
            class,
            number: number.parse().map_err(|_| unknown())?,
        })
    }
}

choice! {
    /// Direction of movement of an agent relative to the lane.
    pub enum Heading {
        /// With the lane, or not at all.
        Along = "along",
        /// Across the lane: by more than [`Heading::CROSSING`].
        Crossing = "crossing",
        /// Against the lane: by more than [`Heading::ONCOMING`].
        Oncoming = "oncoming",
    }
}

impl Heading {
    /// Angle between velocity and lane from which it crosses, radians.
    pub(crate) const CROSSING: f64 = std::f64::consts::FRAC_PI_4;
    /// Angle from which it is oncoming, radians.
    pub(crate) const ONCOMING: f64 = 3.0 * std::f64::consts::FRAC_PI_4;
}

/// An agent or obstacle on one of the nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraphAgent {
    pub name: AgentName,
    pub token: TrackToken,
    pub kind: ObjectKind,
    pub place: NodePlace,
    /// From the ego's center to its center along the lane, meters; negative behind.
    pub offset: f64,
    /// From bumper to bumper along the lane, meters; 0 when side by side.
    pub gap: f64,
    /// Of its center from the centerline, meters, positive to the left.
    pub lateral: f64,
    /// Norm of its velocity, m/s.
    pub speed: f64,
    /// Velocity along the lane, m/s; negative against it.
    pub along_speed: f64,
    pub heading: Heading,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_one_spelling() {
        let name = AgentName {
            class: AgentClass::Pedestrian,
            number: 12,
        };
        assert_eq!(name.to_string(), "pedestrian12");
        assert_eq!("pedestrian12".parse(), Ok(name));
        for wrong in [
            "",
            "vehicle",
            "vehicle0",
            "vehicle01",
            "vehicle+1",
            "vehicle1x",
            "tank1",
            "1",
            "vehicle99999",
        ] {
            assert_eq!(
                wrong.parse::<AgentName>(),
                Err(UnknownAgent(wrong.to_owned()))
            );
        }
    }
}
