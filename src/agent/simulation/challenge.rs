//! nuPlan's challenges: who controls the ego, who controls the other agents, and which metrics
//! apply.

use super::agent_name::AgentPolicyName;
use super::agents::AgentPolicySpec;
use super::controller::EgoController;
use planagent_score::metrics::MetricList;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// nuPlan's three challenges, and the closed loop with agents of one's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Challenge {
    /// Closed loop with non-reactive agents: they replay the log.
    NonReactive,
    /// Closed loop with reactive agents: vehicles follow their lanes by the intelligent driver
    /// model.
    Reactive,
    /// Open loop: ego and agents replay the log, and the plans are compared with it.
    OpenLoop,
    /// Closed loop with agents under a policy of the user: no challenge of nuPlan's.
    OwnAgents(AgentPolicyName),
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

const OWN_AGENTS: ChallengeSpec = ChallengeSpec {
    name: "",
    short_name: "",
    agents: super::agents::NOT_GIVEN,
    ..NON_REACTIVE
};

impl Challenge {
    /// nuPlan's challenges.
    pub const ALL: [Self; 3] = [Self::NonReactive, Self::Reactive, Self::OpenLoop];
    /// The two in which the planner controls the ego.
    pub const CLOSED_LOOP: [Self; 2] = [Self::NonReactive, Self::Reactive];

    pub(super) fn spec(self) -> &'static ChallengeSpec {
        match self {
            Self::NonReactive => &NON_REACTIVE,
            Self::Reactive => &REACTIVE,
            Self::OpenLoop => &OPEN_LOOP,
            Self::OwnAgents(_) => &OWN_AGENTS,
        }
    }

    /// nuPlan's name; with own agents, `closed_loop_own_agents_` and the name of their policy.
    pub fn name(self) -> &'static str {
        match self {
            Self::OwnAgents(policy) => policy.challenge(),
            _ => self.spec().name,
        }
    }

    /// `nonreactive`, `reactive` or `open-loop`; with own agents, the name of their policy.
    pub fn short_name(self) -> &'static str {
        match self {
            Self::OwnAgents(policy) => policy.as_str(),
            _ => self.spec().short_name,
        }
    }

    /// The policy of own agents.
    pub fn own_agents(self) -> Option<AgentPolicyName> {
        match self {
            Self::OwnAgents(policy) => Some(policy),
            Self::NonReactive | Self::Reactive | Self::OpenLoop => None,
        }
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
        let known = Self::ALL
            .into_iter()
            .find(|c| name == c.short_name() || name == c.name());
        let own = || AgentPolicyName::of_challenge(name).map(Self::OwnAgents);
        known
            .or_else(own)
            .ok_or_else(|| UnknownChallenge(name.to_owned()))
    }
}

impl Serialize for Challenge {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Challenge {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        name.parse().map_err(de::Error::custom)
    }
}

impl JsonSchema for Challenge {
    fn schema_name() -> Cow<'static, str> {
        "Challenge".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "nuPlan's challenge, or the closed loop with agents under a policy of the user.",
            "anyOf": [
                { "type": "string", "enum": Self::ALL.map(Self::name) },
                { "type": "string", "pattern": "^closed_loop_own_agents_[a-z0-9_-]+$" },
            ],
        })
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
            assert_eq!(
                serde_json::to_value(challenge).unwrap(),
                challenge.to_string()
            );
        }
        let own = Challenge::OwnAgents(AgentPolicyName::new("exec-mine").unwrap());
        assert_eq!(
            (own.name(), own.short_name()),
            ("closed_loop_own_agents_exec-mine", "exec-mine")
        );
        let written = serde_json::to_string(&own).unwrap();
        assert_eq!(serde_json::from_str::<Challenge>(&written).unwrap(), own);
        assert!(
            "exec-mine".parse::<Challenge>().is_err()
                && "closed_loop_own_agents_A".parse::<Challenge>().is_err()
        );
        assert_eq!(AgentPolicyName::new("reactive"), None);
        let unknown = "openloop".parse::<Challenge>().unwrap_err();
        assert!(unknown.to_string().contains("openloop"));
    }
}
