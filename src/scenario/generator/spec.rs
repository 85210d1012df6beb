//! Names of generated scenarios.

use super::log::Discard;
use super::ranges::Ranges;
use super::scenario_type::ScenarioType;
use super::types;
use std::fmt;
use std::str::FromStr;

/// First part of the id of every generated scenario.
pub(crate) const SOURCE: &str = "generated";

/// Names a generated scenario and determines its every byte. Written `generated/<scenario
/// type>/<seed>` or `generated/<scenario type>/<seed>.<traffic seed>`, with `wide/` or `wider/` before
/// the type for one that is drawn from wider ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Spec {
    /// Scenario type.
    pub scenario_type: ScenarioType,
    /// Seed of roads, route and situation.
    pub seed: u64,
    /// Seed of all other draws; 0 stands for the own traffic of `seed` and is not written.
    pub traffic_seed: u64,
    /// Ranges of roads and traffic.
    pub ranges: Ranges,
}

/// Why there is no such generated scenario.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum GeneratorError {
    #[error(
        "'{0}' does not name a generated scenario: expected generated/<scenario type>/<seed> or \
        generated/<scenario type>/<seed>.<traffic seed>, both also with wide/ or wider/ before \
        the type"
    )]
    Form(String),
    #[error("'{0}' is not a scenario type of the generator; `planagent scenarios list` names them")]
    UnknownType(String),
    #[error("the {which} '{seed}' of '{id}' is not an integer from 0 to 2^64 - 1")]
    Seed {
        which: &'static str,
        seed: String,
        id: String,
    },
    #[error(
        "'{modification}' in '{id}' is no modification; name a kind of docs/modified.md, or a file whose name ends in .toml"
    )]
    Modification { modification: String, id: String },
    #[error("cannot generate {id}: all {draws} draws were discarded, the last one because {last}")]
    Exhausted {
        id: String,
        draws: usize,
        last: Discard,
    },
}

impl Spec {
    /// The scenario of a seed with its own traffic.
    pub const fn new(scenario_type: ScenarioType, seed: u64) -> Self {
        Self {
            scenario_type,
            seed,
            traffic_seed: 0,
            ranges: Ranges::First,
        }
    }

    /// The same situation with other traffic.
    #[must_use]
    pub const fn with_traffic_seed(self, traffic_seed: u64) -> Self {
        Self {
            traffic_seed,
            ..self
        }
    }

    /// The scenario of the same type and seed that is drawn from other ranges: another scenario.
    #[must_use]
    pub const fn drawn_from(self, ranges: Ranges) -> Self {
        Self { ranges, ..self }
    }

    /// Name of the log that the scenario counts as cut from; it depends on the seed alone.
    pub fn log_name(&self) -> String {
        match self.ranges.name() {
            Some(ranges) => format!("{SOURCE}-{ranges}-{}", self.seed),
            None => format!("{SOURCE}-{}", self.seed),
        }
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SOURCE}/")?;
        if let Some(ranges) = self.ranges.name() {
            write!(f, "{ranges}/")?;
        }
        write!(f, "{}/{}", self.scenario_type, self.seed)?;
        if self.traffic_seed == 0 {
            Ok(())
        } else {
            write!(f, ".{}", self.traffic_seed)
        }
    }
}

impl FromStr for Spec {
    type Err = GeneratorError;

    fn from_str(id: &str) -> Result<Self, Self::Err> {
        let named = id
            .strip_prefix(SOURCE)
            .and_then(|rest| rest.strip_prefix('/'));
        let wide = Ranges::NAMED.into_iter().find_map(|ranges| {
            let rest = named?.strip_prefix(ranges.name()?)?.strip_prefix('/')?;
            Some((ranges, rest))
        });
        let rest = wide.map(|(_, rest)| rest);
        // Where the prefix is missing, the first part fails the match below, so one error covers
        // all forms.
        let mut parts = std::iter::once(SOURCE)
            .filter(|_| named.is_some())
            .chain(rest.or(named).unwrap_or(id).split('/'));
        let (Some(SOURCE), Some(kind), Some(seed), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(GeneratorError::Form(id.to_owned()));
        };
        let scenario_type =
            types::named(kind).ok_or_else(|| GeneratorError::UnknownType(kind.to_owned()))?;
        let number = |which, seed: &str| {
            seed.parse().map_err(|_| GeneratorError::Seed {
                which,
                seed: seed.to_owned(),
                id: id.to_owned(),
            })
        };
        if let Some((_, modification)) = seed.split_once('~') {
            return Err(GeneratorError::Modification {
                modification: modification.to_owned(),
                id: id.to_owned(),
            });
        }
        let (seed, traffic) = seed.split_once('.').unwrap_or((seed, "0"));
        let (seed, traffic_seed) = (number("seed", seed)?, number("traffic seed", traffic)?);
        Ok(Self {
            scenario_type,
            seed,
            traffic_seed,
            ranges: wide.map_or(Ranges::First, |(ranges, _)| ranges),
        })
    }
}
