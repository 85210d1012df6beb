//! Forms of answers of language agents beside code: a list of waypoints, and one of five actions.

use crate::environment::choice::choice;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Waypoints of a list.
pub const LISTED_WAYPOINTS: usize = 6;

/// A place as seen from the ego's center at the time of the call, meters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeenPlace {
    /// To the right; negative to the left.
    pub right: f64,
    /// Along the heading.
    pub ahead: f64,
}

/// Where the ego's center is to be after 0.5, 1.0, … 3.0 seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct WaypointList(pub [SeenPlace; LISTED_WAYPOINTS]);

impl fmt::Display for WaypointList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let places = self
            .0
            .iter()
            .map(|place| format!("({:.2},{:.2})", place.right, place.ahead));
        write!(f, "[{}]", places.collect::<Vec<_>>().join(", "))
    }
}

choice! {
    /// An action that moves the set-points of a lane and speed controller.
    pub enum DrivingAction {
        /// The target lane becomes the next one to the left.
        Left = "left",
        /// The set-points are kept.
        Idle = "idle",
        /// The target lane becomes the next one to the right.
        Right = "right",
        /// The next higher speed.
        Faster = "faster",
        /// The next lower speed.
        Slower = "slower",
    }
}

impl DrivingAction {
    /// Its number in prompts and answers.
    pub fn id(self) -> usize {
        self as usize
    }

    /// The action of a number.
    pub fn from_id(id: usize) -> Option<Self> {
        Self::ALL.get(id).copied()
    }
}
