//! Lists of scenarios that have a name.

use super::source::ScenarioSource;
use crate::scenario::generator::{ScenarioType, Spec};

/// Name of the list of generated scenes.
pub const GENERATED: &str = "generated";
/// Seeds of each type in it, from 0 on.
const GENERATED_SEEDS: u64 = 10;

/// A name that is no list.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown split '{0}'; known is {GENERATED}")]
pub struct UnknownSplit(String);

/// The scenarios of a split. `generated`: every type of the generator with the seeds 0 to 9.
///
/// # Errors
/// When there is no such split.
pub fn split(name: &str) -> Result<Vec<ScenarioSource>, UnknownSplit> {
    if name != GENERATED {
        return Err(UnknownSplit(name.to_owned()));
    }
    let specs = ScenarioType::ALL
        .into_iter()
        .flat_map(|scenario_type| (0..GENERATED_SEEDS).map(move |seed| Spec { scenario_type, seed }));
    Ok(specs.map(ScenarioSource::Generated).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generated_split_has_ten_seeds_of_each_type() {
        let sources = split(GENERATED).unwrap();
        assert_eq!(sources.len(), 160);
        assert_eq!(sources[0].to_string(), "generated/starting_left_turn/0");
        assert_eq!(sources[159].to_string(), "generated/traversing_roundabout/9");
        assert!(split("val15").unwrap_err().to_string().contains("val15"));
    }
}
