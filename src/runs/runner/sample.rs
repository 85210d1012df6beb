//! Which of the scenarios that words and splits name are simulated: types, order, number.

use planagent_scenario::{ScenarioRef, UNKNOWN_TYPE};
use std::collections::BTreeSet;

/// What to take of the scenarios that are found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Sample {
    /// Only these types; without any, all.
    pub(super) types: Vec<String>,
    /// The seed of their order; without one, the order in which they are found.
    pub(super) shuffle: Option<u64>,
    /// Maximum number of scenarios, taken evenly from the types.
    pub(super) limit: Option<usize>,
}

/// A type that no scenario has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no scenario is of type '{name}'; there are {}", known.join(", "))]
pub struct NoSuchType {
    /// The type.
    pub name: String,
    /// The types of the scenarios.
    pub known: Vec<String>,
}

impl Sample {
    /// At most so many scenarios, evenly from their types.
    pub fn limited(limit: usize) -> Self {
        Self {
            limit: Some(limit),
            ..Self::default()
        }
    }

    /// The scenarios that it takes of `found`.
    pub(super) fn draw(&self, found: Vec<ScenarioRef>) -> Result<Vec<ScenarioRef>, NoSuchType> {
        let mut scenarios = self.of_types(found)?;
        if let Some(seed) = self.shuffle {
            // The order of two scenarios depends on nothing but the seed and their names.
            scenarios.sort_by_cached_key(|scenario| hash(&seed.to_le_bytes(), &key(scenario)));
        }
        Ok(match self.limit {
            Some(limit) => evenly(scenarios, limit),
            None => scenarios,
        })
    }

    fn of_types(&self, found: Vec<ScenarioRef>) -> Result<Vec<ScenarioRef>, NoSuchType> {
        if self.types.is_empty() {
            return Ok(found);
        }
        let known: BTreeSet<&str> = found.iter().flat_map(types_of).collect();
        if let Some(name) = self
            .types
            .iter()
            .find(|name| !known.contains(name.as_str()))
        {
            return Err(NoSuchType {
                name: name.clone(),
                known: known.into_iter().map(str::to_owned).collect(),
            });
        }
        let is_wanted = |scenario: &ScenarioRef| {
            types_of(scenario).any(|own| self.types.iter().any(|name| name == own))
        };
        Ok(found.into_iter().filter(is_wanted).collect())
    }
}

/// At most `limit` scenarios: of each type the first, then of each the second, and so on. Modified
/// scenarios of one type are taken in the same way from the types that they had before. They stay
/// in their order.
fn evenly(scenarios: Vec<ScenarioRef>, limit: usize) -> Vec<ScenarioRef> {
    let by_type = groups(scenarios.iter().enumerate(), |(_, scenario)| {
        type_of(scenario)
    });
    let by_type = by_type
        .into_iter()
        .map(|group| in_turn(&groups(group, |(_, scenario)| scenario.unmodified_type())));
    let taken: BTreeSet<usize> = in_turn(&by_type.collect::<Vec<_>>())
        .into_iter()
        .take(limit)
        .map(|(place, _)| place)
        .collect();
    let kept = scenarios
        .into_iter()
        .enumerate()
        .filter(|(place, _)| taken.contains(place));
    kept.map(|(_, scenario)| scenario).collect()
}

/// The items of each key, in the order in which the keys come.
fn groups<T, K: PartialEq>(
    items: impl IntoIterator<Item = T>,
    key: impl Fn(&T) -> K,
) -> Vec<Vec<T>> {
    let mut groups: Vec<(K, Vec<T>)> = Vec::new();
    for item in items {
        let own = key(&item);
        match groups.iter_mut().find(|(key, _)| *key == own) {
            Some((_, items)) => items.push(item),
            None => groups.push((own, vec![item])),
        }
    }
    groups.into_iter().map(|(_, items)| items).collect()
}

/// The first of each group, then the second of each, and so on.
fn in_turn<T: Copy>(groups: &[Vec<T>]) -> Vec<T> {
    let longest = groups.iter().map(Vec::len).max().unwrap_or(0);
    (0..longest)
        .flat_map(|turn| {
            groups
                .iter()
                .filter_map(move |items| items.get(turn).copied())
        })
        .collect()
}

fn type_of(scenario: &ScenarioRef) -> &str {
    scenario.scenario_type().unwrap_or(UNKNOWN_TYPE)
}

/// Its type, and the one that it had before a modification.
fn types_of(scenario: &ScenarioRef) -> impl Iterator<Item = &str> {
    std::iter::once(type_of(scenario)).chain(scenario.unmodified_type())
}

/// A name of the scenario that does not depend on where its file lies.
pub(super) fn key(scenario: &ScenarioRef) -> String {
    let file = || {
        scenario
            .path()?
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
    };
    scenario
        .id()
        .map(str::to_owned)
        .or_else(file)
        .unwrap_or_else(|| scenario.to_string())
}

/// A number that stays the same on every machine and in every version.
pub(super) fn hash(salt: &[u8], text: &str) -> u64 {
    let digest = blake3::Hasher::new()
        .update(salt)
        .update(b"\n")
        .update(text.as_bytes())
        .finalize();
    digest
        .as_bytes()
        .iter()
        .take(8)
        .fold(0, |number, &byte| number << 8 | u64::from(byte))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::ReaderError;
    use planagent_scenario::modified::ModifiedName;
    use planagent_world::InteractionKind;

    fn scenario(kind: &str, seed: usize) -> ScenarioRef {
        let word = format!("generated/{kind}/{seed}");
        let unopened = || Err(ReaderError::Unreadable(String::new()));
        ScenarioRef::new(word.clone(), unopened)
            .with_id(word)
            .with_type(kind)
    }

    fn scenarios() -> Vec<ScenarioRef> {
        [("a", 5), ("b", 1), ("c", 3)]
            .into_iter()
            .flat_map(|(kind, n)| (0..n).map(move |i| scenario(kind, i)))
            .collect()
    }

    fn names(scenarios: &[ScenarioRef]) -> Vec<String> {
        scenarios
            .iter()
            .map(|one| one.to_string().replace("generated/", ""))
            .collect()
    }

    #[test]
    fn a_limit_takes_evenly_and_keeps_the_order() {
        let taken = |limit| {
            names(
                &Sample {
                    limit: Some(limit),
                    ..Sample::default()
                }
                .draw(scenarios())
                .unwrap(),
            )
        };
        assert_eq!(taken(2), ["a/0", "b/0"]);
        assert_eq!(taken(4), ["a/0", "a/1", "b/0", "c/0"]);
        assert_eq!(taken(7), ["a/0", "a/1", "a/2", "b/0", "c/0", "c/1", "c/2"]);
        assert_eq!(taken(100), names(&scenarios()));
    }

    #[test]
    fn types_are_kept_and_unknown_ones_refused() {
        let of = |kind: &str| {
            Sample {
                types: vec![kind.to_owned()],
                ..Sample::default()
            }
            .draw(scenarios())
        };
        assert_eq!(names(&of("c").unwrap()), ["c/0", "c/1", "c/2"]);
        let error = of("d").unwrap_err();
        assert_eq!(
            error.to_string(),
            "no scenario is of type 'd'; there are a, b, c"
        );
    }

    #[test]
    fn modified_scenarios_are_found_by_both_types_and_taken_evenly_from_both() {
        let modification = ModifiedName::for_kind(InteractionKind::JaywalkingPedestrian)
            .read()
            .unwrap();
        let modified: Vec<ScenarioRef> = scenarios()
            .into_iter()
            .map(|one| modification.modify(one))
            .collect();
        let taken = |sample: Sample| {
            names(&sample.draw(modified.clone()).unwrap())
                .join(" ")
                .replace("~jaywalking_pedestrian", "")
        };
        assert_eq!(
            taken(Sample {
                limit: Some(3),
                ..Sample::default()
            }),
            "a/0 b/0 c/0"
        );
        let of = |kind: &str| Sample {
            types: vec![kind.to_owned()],
            limit: Some(2),
            ..Sample::default()
        };
        assert_eq!(taken(of("c")), "c/0 c/1");
        assert_eq!(taken(of("jaywalking_pedestrian")), "a/0 b/0");
    }

    #[test]
    fn a_seed_draws_an_order_that_other_scenarios_do_not_change() {
        let order = |seed, found| {
            names(
                &Sample {
                    shuffle: Some(seed),
                    ..Sample::default()
                }
                .draw(found)
                .unwrap(),
            )
        };
        let all = order(0, scenarios());
        assert_ne!(all, names(&scenarios()));
        assert_ne!(all, order(1, scenarios()));
        let mut sorted = all.clone();
        sorted.sort();
        assert_eq!(sorted, names(&scenarios()));
        let some = order(
            0,
            scenarios()
                .into_iter()
                .filter(|one| type_of(one) != "b")
                .collect(),
        );
        assert_eq!(
            some,
            all.into_iter()
                .filter(|name| !name.starts_with('b'))
                .collect::<Vec<_>>()
        );
    }
}
