//! One of several parts of a run, which processes simulate independently.

use super::sample::{hash, key};
use crate::report::ShardList;
use planagent_scenario::ScenarioRef;
use std::fmt;
use std::str::FromStr;

/// One of several parts of a run, which processes simulate independently: `2/8`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    of: usize,
}

/// A text that names no shard.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a shard is I/N with I from 1 to N, for example 2/8")]
pub struct NoShard;

/// Environment variables that name no shard.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ShardEnvironmentError {
    #[error("{name} is '{value}'; it must be a whole number")]
    NoNumber { name: &'static str, value: String },
    #[error("{set} is set, {missing} is not; name the shard as I/N")]
    Missing {
        set: &'static str,
        missing: &'static str,
    },
    #[error("{name} is {value}, which names none of {of} parts; name the shard as I/N")]
    Outside {
        name: &'static str,
        value: i64,
        of: i64,
    },
    #[error(
        "the task ids of the array are not evenly spaced, so {TASK} does not tell the part; name the shard as I/N"
    )]
    Uneven,
}

const TASK: &str = "SLURM_ARRAY_TASK_ID";
const TASK_MIN: &str = "SLURM_ARRAY_TASK_MIN";
const TASK_MAX: &str = "SLURM_ARRAY_TASK_MAX";
const TASK_STEP: &str = "SLURM_ARRAY_TASK_STEP";
const TASK_COUNT: &str = "SLURM_ARRAY_TASK_COUNT";
/// nuplan-devkit's names for the nodes of a run.
const NODE: &str = "NODE_RANK";
const NODE_COUNT: &str = "NUM_NODES";

impl FromStr for Shard {
    type Err = NoShard;

    fn from_str(text: &str) -> Result<Self, NoShard> {
        let (index, of) = text.split_once('/').ok_or(NoShard)?;
        let [index, of] =
            [index, of].map(|number| number.trim().parse::<usize>().map_err(|_| NoShard));
        let (index, of) = (index?, of?);
        if (1..=of).contains(&index) {
            Ok(Self { index, of })
        } else {
            Err(NoShard)
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl From<ShardList> for Shard {
    fn from(list: ShardList) -> Self {
        Self {
            index: list.index,
            of: list.of,
        }
    }
}

impl Shard {
    /// The shard of this process in a SLURM array, else on one of several nodes (`NODE_RANK`,
    /// `NUM_NODES`); none elsewhere. `variable` gives the value of an environment variable.
    ///
    /// # Errors
    /// When the variables contradict each other, or one is missing.
    pub fn of_environment(
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<Self>, ShardEnvironmentError> {
        let number = |name: &'static str| {
            let Some(value) = variable(name) else {
                return Ok(None);
            };
            let parsed = value.trim().parse::<i64>();
            parsed
                .map(Some)
                .map_err(|_| ShardEnvironmentError::NoNumber { name, value })
        };
        if let Some(task) = number(TASK)? {
            let of = number(TASK_COUNT)?.ok_or(ShardEnvironmentError::Missing {
                set: TASK,
                missing: TASK_COUNT,
            })?;
            let (first, step) = (
                number(TASK_MIN)?.unwrap_or(1),
                number(TASK_STEP)?.unwrap_or(1).max(1),
            );
            // An array with gaps would leave simulations out.
            let last = first.saturating_add(step.saturating_mul(of.saturating_sub(1)));
            let place = task.saturating_sub(first);
            if number(TASK_MAX)?.is_some_and(|found| found != last) || place % step != 0 {
                return Err(ShardEnvironmentError::Uneven);
            }
            return Self::at(place / step, of)
                .map(Some)
                .ok_or(ShardEnvironmentError::Outside {
                    name: TASK,
                    value: task,
                    of,
                });
        }
        let Some(node) = number(NODE)? else {
            return Ok(None);
        };
        let of = number(NODE_COUNT)?.ok_or(ShardEnvironmentError::Missing {
            set: NODE,
            missing: NODE_COUNT,
        })?;
        Self::at(node, of)
            .map(Some)
            .ok_or(ShardEnvironmentError::Outside {
                name: NODE,
                value: node,
                of,
            })
    }

    /// The shard at a place from 0.
    fn at(place: i64, of: i64) -> Option<Self> {
        let (place, of) = (usize::try_from(place).ok()?, usize::try_from(of).ok()?);
        (place < of).then_some(Self {
            index: place + 1,
            of,
        })
    }

    /// Whether it has a scenario. That depends on the name of the scenario alone, so that a
    /// scenario stays in its shard whatever else is simulated.
    pub(super) fn has(self, scenario: &ScenarioRef) -> bool {
        let place = hash(b"shard", &key(scenario)) % (self.of as u64);
        place == self.index as u64 - 1
    }

    /// What the manifest says of it, with the number of its scenarios.
    pub(super) fn list(self, scenarios: &[ScenarioRef]) -> ShardList {
        let count = scenarios
            .iter()
            .filter(|scenario| self.has(scenario))
            .count();
        ShardList {
            index: self.index,
            of: self.of,
            count,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::ReaderError;

    fn scenario(seed: usize) -> ScenarioRef {
        let word = format!("generated/a/{seed}");
        let unopened = || Err(ReaderError::Unreadable(String::new()));
        ScenarioRef::new(word.clone(), unopened).with_id(word)
    }

    #[test]
    fn shards_of_any_number_share_every_scenario_once() {
        let all: Vec<ScenarioRef> = (0..200).map(scenario).collect();
        for of in [1, 2, 3, 7, 300] {
            let mut counts = vec![0; all.len()];
            for index in 1..=of {
                let shard: Shard = format!("{index}/{of}").parse().unwrap();
                let has: Vec<bool> = all.iter().map(|one| shard.has(one)).collect();
                assert_eq!(
                    shard.list(&all).count,
                    has.iter().filter(|has| **has).count()
                );
                counts
                    .iter_mut()
                    .zip(has)
                    .for_each(|(count, has)| *count += usize::from(has));
            }
            assert!(counts.iter().all(|count| *count == 1), "{of}: {counts:?}");
        }
        // Pinned: another assignment would tear apart shards that were simulated before.
        let first: Vec<usize> = all
            .iter()
            .take(8)
            .map(|one| 1 + (hash(b"shard", &key(one)) % 3) as usize)
            .collect();
        assert_eq!(first, PINNED);
    }

    /// Shards of three of the first scenarios.
    const PINNED: [usize; 8] = [3, 3, 3, 1, 1, 1, 1, 3];

    #[test]
    fn what_names_no_shard_is_refused() {
        assert_eq!("2/8".parse::<Shard>().unwrap().to_string(), "2/8");
        for wrong in ["", "2", "0/2", "3/2", "1/0", "a/b", "1/2/3", "-1/2"] {
            assert_eq!(wrong.parse::<Shard>(), Err(NoShard), "{wrong}");
        }
    }

    #[test]
    fn the_environment_names_a_shard() {
        let of = |variables: &[(&str, &str)]| {
            let found = |name: &str| {
                variables
                    .iter()
                    .find(|(key, _)| *key == name)
                    .map(|(_, value)| (*value).to_owned())
            };
            Shard::of_environment(found).map(|shard| shard.map(|shard| shard.to_string()))
        };
        let array = |id, min, max, step, count| {
            of(&[
                (TASK, id),
                (TASK_MIN, min),
                (TASK_MAX, max),
                (TASK_STEP, step),
                (TASK_COUNT, count),
            ])
        };
        assert_eq!(of(&[]), Ok(None));
        assert_eq!(array("0", "0", "7", "1", "8").unwrap().unwrap(), "1/8");
        assert_eq!(array("8", "1", "8", "1", "8").unwrap().unwrap(), "8/8");
        assert_eq!(array("13", "5", "17", "4", "4").unwrap().unwrap(), "3/4");
        assert_eq!(
            of(&[(TASK, "2"), (TASK_COUNT, "3")]).unwrap().unwrap(),
            "2/3"
        );
        // --array=1,3,7 does not say which of the three 3 is.
        assert_eq!(
            array("3", "1", "7", "1", "3"),
            Err(ShardEnvironmentError::Uneven)
        );
        assert!(matches!(
            of(&[(TASK, "4"), (TASK_COUNT, "3")]),
            Err(ShardEnvironmentError::Outside { .. })
        ));
        assert!(matches!(
            of(&[(TASK, "4")]),
            Err(ShardEnvironmentError::Missing { .. })
        ));
        assert!(matches!(
            of(&[(TASK, "x"), (TASK_COUNT, "3")]),
            Err(ShardEnvironmentError::NoNumber { .. })
        ));
        // A job of several nodes may set both; the array comes first.
        assert_eq!(
            of(&[
                (TASK, "2"),
                (TASK_COUNT, "3"),
                (NODE, "0"),
                (NODE_COUNT, "2")
            ])
            .unwrap()
            .unwrap(),
            "2/3"
        );
        assert_eq!(
            of(&[(NODE, "1"), (NODE_COUNT, "2")]).unwrap().unwrap(),
            "2/2"
        );
        assert!(matches!(
            of(&[(NODE, "2"), (NODE_COUNT, "2")]),
            Err(ShardEnvironmentError::Outside { .. })
        ));
        assert!(matches!(
            of(&[(NODE, "2")]),
            Err(ShardEnvironmentError::Missing { .. })
        ));
    }
}
