//! Traffic lights, per lane connector.

use super::LaneId;
use std::collections::BTreeMap;
use std::fmt;

/// State of a light.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum SignalStatus {
    /// Go.
    Green,
    /// About to be red.
    Yellow,
    /// Stop.
    Red,
    /// Not observed.
    Unknown,
}

impl fmt::Display for SignalStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Green => "green",
            Self::Yellow => "yellow",
            Self::Red => "red",
            Self::Unknown => "unknown",
        })
    }
}

/// The lights of one instant, by the lane connector that they govern.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct TrafficLights {
    by_connector: BTreeMap<LaneId, SignalStatus>,
}

impl TrafficLights {
    /// The state of the light of this connector; `None` without a recorded light.
    #[inline]
    pub fn status(&self, connector: LaneId) -> Option<SignalStatus> {
        self.by_connector.get(&connector).copied()
    }

    /// Sets the light of a connector.
    pub fn set(&mut self, connector: LaneId, status: SignalStatus) {
        self.by_connector.insert(connector, status);
    }

    /// All recorded lights in order of connector.
    pub fn iter(&self) -> impl Iterator<Item = (LaneId, SignalStatus)> + '_ {
        self.by_connector.iter().map(|(&id, &status)| (id, status))
    }

    /// The connectors that show red.
    pub fn red(&self) -> impl Iterator<Item = LaneId> + '_ {
        self.iter()
            .filter(|&(_, status)| status == SignalStatus::Red)
            .map(|(id, _)| id)
    }
}

impl FromIterator<(LaneId, SignalStatus)> for TrafficLights {
    fn from_iter<I: IntoIterator<Item = (LaneId, SignalStatus)>>(lights: I) -> Self {
        Self {
            by_connector: lights.into_iter().collect(),
        }
    }
}
