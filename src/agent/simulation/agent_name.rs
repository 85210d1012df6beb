//! Names of agent policies that are no challenge of nuPlan's.

use crate::planner::interned;
use std::fmt;

/// What the names of challenges with own agents begin with.
const OWN: &str = "closed_loop_own_agents_";
/// Words that mean something else in the place of a challenge.
const RESERVED: [&str; 5] = [
    "nonreactive",
    "reactive",
    "both",
    "open-loop",
    "open_loop_boxes",
];

/// Name of a policy of the other agents that a user brings. It stands where the challenges of
/// nuPlan stand: in tables, records and file names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AgentPolicyName {
    name: &'static str,
    challenge: &'static str,
}

impl AgentPolicyName {
    /// The name of lowercase letters, digits, minuses and underscores; `None` for other texts, and
    /// for the names of challenges.
    pub fn new(name: &str) -> Option<Self> {
        let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        let is_name = !name.is_empty() && name.chars().all(fits) && !RESERVED.contains(&name);
        is_name.then(|| Self {
            name: interned(name.to_owned()),
            challenge: interned(format!("{OWN}{name}")),
        })
    }

    /// The name in [`Self::challenge`].
    pub(super) fn of_challenge(challenge: &str) -> Option<Self> {
        challenge.strip_prefix(OWN).and_then(Self::new)
    }

    /// The name as text.
    pub fn as_str(self) -> &'static str {
        self.name
    }

    /// The name where those of nuPlan's challenges stand.
    pub fn challenge(self) -> &'static str {
        self.challenge
    }
}

impl fmt::Display for AgentPolicyName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
