//! Names of files and folders that are made of words of a run: planners, metrics, scenarios.

use super::limits::MAX_SIMULATIONS;
use serde::{Deserialize, Deserializer, de};
use std::fmt;

/// Digits of the number in the name of a simulation's folder.
const DIGITS: usize = 6;
/// Maximum length of the scenario in the folder's name; file systems allow 255 bytes for all of it.
const MAX_SCENARIO_CHARS: usize = 80;
/// Longest part of a name, bytes.
const MAX_PART_BYTES: usize = 200;
/// Characters that some file system does not allow in a name, or gives a meaning.
const SPECIAL: &str = "/\\:*?\"<>|";

/// A word that can stand in the name of a file on every system.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct NamePart(String);

/// A word that cannot be part of a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{}' cannot be part of a file name: a name has no slash, colon or control character, does not begin with a dot, and \
     has at most {MAX_PART_BYTES} bytes", .0.escape_debug()
)]
pub struct NoNamePart(String);

impl NamePart {
    pub(super) fn parse(word: &str) -> Result<Self, NoNamePart> {
        let fits = |c: char| !c.is_control() && !SPECIAL.contains(c);
        if word.is_empty()
            || word.len() > MAX_PART_BYTES
            || word.starts_with('.')
            || word.ends_with(['.', ' '])
            || !word.chars().all(fits)
        {
            return Err(NoNamePart(planagent_files::shortened(word).into_owned()));
        }
        Ok(Self(word.to_owned()))
    }
}

impl fmt::Display for NamePart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Reads a word that can be part of a name, for serde.
pub(super) fn name_part<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let word = String::deserialize(deserializer)?;
    NamePart::parse(&word).map_err(de::Error::custom)?;
    Ok(word)
}

/// Reads a list of such words, for serde.
pub(super) fn name_parts<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<String>, D::Error> {
    let words = Vec::<String>::deserialize(deserializer)?;
    for word in &words {
        NamePart::parse(word).map_err(de::Error::custom)?;
    }
    Ok(words)
}

/// The name of a simulation's folder: `NNNNNN-SCENARIO-PLANNER-CHALLENGE`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SimulationName {
    pub(super) number: usize,
    name: String,
}

impl SimulationName {
    /// The name for a simulation, in characters that every file system allows.
    pub(super) fn new(number: usize, scenario: &str, planner: &NamePart, challenge: &str) -> Self {
        let safe = |c: char| {
            if c.is_ascii_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '_'
            }
        };
        let scenario: String = scenario
            .chars()
            .map(safe)
            .take(MAX_SCENARIO_CHARS)
            .collect();
        // A folder that begins with a dot is hidden, and none of a run.
        let scenario = match scenario.strip_prefix('.') {
            Some(rest) => format!("_{rest}"),
            None => scenario,
        };
        Self {
            number,
            name: format!("{number:0DIGITS$}-{scenario}-{planner}-{challenge}"),
        }
    }

    /// The simulation of a folder's name; none for the name of something else.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let (digits, rest) = name.split_once('-')?;
        if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let number = digits.parse().ok().filter(|n| *n < MAX_SIMULATIONS)?;
        NamePart::parse(rest).ok()?;
        Some(Self {
            number,
            name: name.to_owned(),
        })
    }

    pub(super) fn as_str(&self) -> &str {
        &self.name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_any_scenario_is_found_again() {
        let planner = NamePart::parse("idm").unwrap();
        for scenario in ["..", ".hidden", "", "a/b", "\u{1b}[2J", &"x".repeat(9_000)] {
            let name = SimulationName::new(3, scenario, &planner, "reactive");
            assert_eq!(
                SimulationName::parse(name.as_str()),
                Some(name),
                "{scenario}"
            );
        }
    }

    #[test]
    fn what_leads_elsewhere_is_no_part_of_a_name() {
        for word in [
            "idm",
            "no_ego_at_fault_collisions",
            "exec-mine",
            "Mein Planer",
            "ä",
        ] {
            assert_eq!(NamePart::parse(word).unwrap().to_string(), word);
        }
        for word in [
            "",
            ".",
            "..",
            ".ssh",
            "a/b",
            "../x",
            "a\\b",
            "C:x",
            "a\0",
            "a\nb",
            "x.",
            "nul\u{1b}",
        ] {
            assert!(NamePart::parse(word).is_err(), "{word:?}");
        }
        assert!(NamePart::parse(&"a".repeat(MAX_PART_BYTES + 1)).is_err());
    }

    #[test]
    fn folders_are_known_by_their_number() {
        let planner = NamePart::parse("idm").unwrap();
        let name = SimulationName::new(7, "a/../b\u{202e}", &planner, "reactive");
        assert_eq!(name.as_str(), "000007-a_.._b_-idm-reactive");
        assert_eq!(SimulationName::parse(name.as_str()), Some(name));
        assert_eq!(SimulationName::parse("000000-a").unwrap().number, 0);
        for other in [
            "",
            "readme",
            "-a",
            "+1-a",
            "1-",
            "1-../a",
            "99999999999-a",
            "0x1-a",
        ] {
            assert_eq!(SimulationName::parse(other), None, "{other}");
        }
    }
}
