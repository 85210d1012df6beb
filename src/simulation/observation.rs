//! The objects around the ego: replayed from the log or driven by the intelligent driver model.

use crate::dynamics::IdmTraffic;
use crate::metrics::MetricList;
use crate::scenario::{Frame, Scenario};
use crate::world::{EgoState, MICROS_PER_SECOND, TrackedObject};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// nuPlan's three challenges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub enum Challenge {
    /// Everything but the ego does what was recorded.
    #[serde(rename = "closed_loop_nonreactive_agents")]
    ClosedLoopNonreactiveAgents,
    /// Vehicles follow the lanes by the intelligent driver model and react to the ego.
    #[serde(rename = "closed_loop_reactive_agents")]
    ClosedLoopReactiveAgents,
    /// Everything does what was recorded, the ego too; the plans are compared with the log.
    #[serde(rename = "open_loop_boxes")]
    OpenLoopBoxes,
}

impl Challenge {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::ClosedLoopNonreactiveAgents, Self::ClosedLoopReactiveAgents, Self::OpenLoopBoxes];
    /// The two in which the planner drives, the non-reactive one first.
    pub const CLOSED_LOOP: [Self; 2] = [Self::ClosedLoopNonreactiveAgents, Self::ClosedLoopReactiveAgents];

    /// Short name: `nonreactive`, `reactive` or `open-loop`.
    pub fn short_name(self) -> &'static str {
        match self {
            Self::ClosedLoopNonreactiveAgents => "nonreactive",
            Self::ClosedLoopReactiveAgents => "reactive",
            Self::OpenLoopBoxes => "open-loop",
        }
    }

    /// The metrics that it is scored by.
    pub fn metric_list(self) -> MetricList {
        match self {
            Self::ClosedLoopNonreactiveAgents | Self::ClosedLoopReactiveAgents => MetricList::ClosedLoop,
            Self::OpenLoopBoxes => MetricList::OpenLoop,
        }
    }
}

impl fmt::Display for Challenge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ClosedLoopNonreactiveAgents => "closed_loop_nonreactive_agents",
            Self::ClosedLoopReactiveAgents => "closed_loop_reactive_agents",
            Self::OpenLoopBoxes => "open_loop_boxes",
        })
    }
}

/// A name that is no challenge.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown challenge {0:?}; known are nonreactive, reactive and open-loop")]
pub struct UnknownChallenge(String);

impl FromStr for Challenge {
    type Err = UnknownChallenge;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|c| name == c.short_name() || name == c.to_string());
        known.ok_or_else(|| UnknownChallenge(name.to_owned()))
    }
}

/// What moves the objects from one iteration to the next.
#[derive(Debug, Clone)]
pub(super) enum Observation {
    /// nuPlan's `box_observation`.
    LogTracks,
    /// nuPlan's `idm_agents_observation`.
    IdmAgents(Box<IdmTraffic>),
}

impl Observation {
    /// The observation of a challenge at iteration 0, `first` being its frame.
    pub(super) fn new(challenge: Challenge, scenario: &Scenario, first: &Frame) -> Self {
        match challenge {
            Challenge::ClosedLoopNonreactiveAgents | Challenge::OpenLoopBoxes => Self::LogTracks,
            Challenge::ClosedLoopReactiveAgents => {
                Self::IdmAgents(Box::new(IdmTraffic::new(&scenario.map, &first.objects, &first.ego)))
            }
        }
    }

    /// The objects now, `frame` being that of the present iteration.
    pub(super) fn objects(&self, frame: &Frame) -> Arc<[TrackedObject]> {
        match self {
            Self::LogTracks => Arc::clone(&frame.objects),
            Self::IdmAgents(traffic) => traffic.objects(),
        }
    }

    /// Moves on to iteration k+1 with its frame `next`, while the ego is still seen as at k.
    pub(super) fn update(&mut self, ego: &EgoState, next: &Frame, dt_us: i64) {
        if let Self::IdmAgents(traffic) = self {
            traffic.step(ego, &next.objects, &next.lights, dt_us as f64 / MICROS_PER_SECOND);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn challenges_are_known_by_both_names() {
        for challenge in Challenge::ALL {
            assert_eq!(challenge.to_string().parse(), Ok(challenge));
            assert_eq!(challenge.short_name().parse(), Ok(challenge));
            assert_eq!(serde_json::to_value(challenge).unwrap(), challenge.to_string());
        }
        assert!("open_loop".parse::<Challenge>().is_err());
    }
}
