//! nuPlan's challenges: who controls the ego, who controls the other agents, and which metrics apply.

use super::agents::AgentPolicySpec;
use super::controller::EgoController;
use crate::metrics::MetricList;
use std::fmt;
use std::str::FromStr;

/// nuPlan's three challenges.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize, schemars::JsonSchema,
)]
#[non_exhaustive]
pub enum Challenge {
    /// Closed loop with non-reactive agents: they replay the log.
    #[serde(rename = "closed_loop_nonreactive_agents")]
    NonReactive,
    /// Closed loop with reactive agents: vehicles follow their lanes by the intelligent driver model.
    #[serde(rename = "closed_loop_reactive_agents")]
    Reactive,
    /// Open loop: ego and agents replay the log, and the plans are compared with it.
    #[serde(rename = "open_loop_boxes")]
    OpenLoop,
}

/// One row of the table of challenges.
pub(super) struct ChallengeSpec {
    name: &'static str,
    short_name: &'static str,
    pub(super) ego: EgoController,
    pub(super) agents: AgentPolicySpec,
    metrics: MetricList,
}

const NON_REACTIVE: ChallengeSpec = ChallengeSpec {
    name: "closed_loop_nonreactive_agents",
    short_name: "nonreactive",
    ego: EgoController::TwoStage,
    agents: super::agents::LOG_REPLAY,
    metrics: MetricList::ClosedLoop,
};
const REACTIVE: ChallengeSpec = ChallengeSpec {
    name: "closed_loop_reactive_agents",
    short_name: "reactive",
    agents: super::agents::IDM,
    ..NON_REACTIVE
};
const OPEN_LOOP: ChallengeSpec = ChallengeSpec {
    name: "open_loop_boxes",
    short_name: "open-loop",
    ego: EgoController::LogPlayback,
    metrics: MetricList::OpenLoop,
    ..NON_REACTIVE
};

impl Challenge {
    /// All challenges.
    pub const ALL: [Self; 3] = [Self::NonReactive, Self::Reactive, Self::OpenLoop];
    /// The two in which the planner controls the ego.
    pub const CLOSED_LOOP: [Self; 2] = [Self::NonReactive, Self::Reactive];

    pub(super) fn spec(self) -> &'static ChallengeSpec {
        match self {
            Self::NonReactive => &NON_REACTIVE,
            Self::Reactive => &REACTIVE,
            Self::OpenLoop => &OPEN_LOOP,
        }
    }

    /// nuPlan's name.
    pub fn name(self) -> &'static str {
        self.spec().name
    }

    /// `nonreactive`, `reactive` or `open-loop`.
    pub fn short_name(self) -> &'static str {
        self.spec().short_name
    }

    /// The metrics of its score.
    pub fn metric_list(self) -> MetricList {
        self.spec().metrics
    }
}

impl fmt::Display for Challenge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that no challenge has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown challenge '{0}'; the challenges are nonreactive, reactive and open-loop")]
pub struct UnknownChallenge(String);

impl FromStr for Challenge {
    type Err = UnknownChallenge;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|c| name == c.short_name() || name == c.name());
        known.ok_or_else(|| UnknownChallenge(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn challenges_have_two_names() {
        for challenge in Challenge::ALL {
            assert_eq!(challenge.to_string().parse(), Ok(challenge));
            assert_eq!(challenge.short_name().parse(), Ok(challenge));
            assert_eq!(serde_json::to_value(challenge).unwrap(), challenge.to_string());
        }
        let unknown = "openloop".parse::<Challenge>().unwrap_err();
        assert!(unknown.to_string().contains("openloop"));
    }
}
