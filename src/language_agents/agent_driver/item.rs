//! What is remembered: motions.

use crate::memory::Remembered;
use planagent_agent::reasoning::{SeenPlace, WaypointList};
use serde::{Deserialize, Serialize};

/// Largest number of a remembered motion: meters, or meters per half second.
const MAX_NUMBER: f64 = 1_000.0;

/// A remembered motion of Agent-Driver, with what followed; x is to the right, y ahead.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExperienceItem {
    /// Motion, past and goal in words.
    pub(crate) text: String,
    /// The numbers of the motion, in the order of the words.
    pub(crate) motion: [f64; 9],
    /// The goal.
    pub(crate) goal: String,
    /// The places in the last two seconds, the oldest first, meters.
    pub(crate) past: [[f64; 2]; 4],
    /// The places in the next three seconds, meters.
    pub(crate) future: [[f64; 2]; 6],
    /// The scenario.
    pub(crate) source: String,
}

impl ExperienceItem {
    /// What followed, as a list of waypoints.
    pub(crate) fn list(&self) -> WaypointList {
        let places = self.future.map(|[right, ahead]| SeenPlace { right, ahead });
        WaypointList(places)
    }
}

impl Remembered for ExperienceItem {
    fn texts(&self) -> [(&'static str, &str); 3] {
        [
            ("text", &self.text),
            ("goal", &self.goal),
            ("source", &self.source),
        ]
    }

    const READ: usize = 2;

    fn fault(&self) -> Option<String> {
        let places = self.past.iter().chain(&self.future).flatten();
        let far = self.motion.iter().chain(places);
        far.copied()
            .find(|number| number.abs() > MAX_NUMBER)
            .map(|number| format!("{number:e} is larger than {MAX_NUMBER}"))
    }
}
