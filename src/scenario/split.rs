//! The scenarios of a list that has a name, and those that the data lacks.

use super::reader::ScenarioRef;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::PathBuf;

/// The scenarios of a list that has a name.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Split {
    /// Those that exist.
    pub scenarios: Vec<ScenarioRef>,
    /// Those that do not: a run of the list is not the whole list.
    pub missing: MissingTokens,
    /// The file that holds the list, if one does.
    pub file: Option<PathBuf>,
    /// What a user should know, for example that a file is not the published one.
    pub notes: Vec<String>,
}

impl Split {
    /// A list of scenarios that all exist.
    #[doc(hidden)]
    pub fn from_scenarios(scenarios: Vec<ScenarioRef>) -> Self {
        Self {
            scenarios,
            ..Self::default()
        }
    }

    /// Other scenarios in the place of those that exist, and another file.
    #[doc(hidden)]
    #[must_use]
    pub fn with(self, scenarios: Vec<ScenarioRef>, file: Option<PathBuf>) -> Self {
        Self {
            scenarios,
            file,
            ..self
        }
    }

    /// Those that are missing, and notes for the user.
    #[doc(hidden)]
    #[must_use]
    pub fn lacking(self, missing: MissingTokens, notes: Vec<String>) -> Self {
        Self {
            missing,
            notes,
            ..self
        }
    }
}

/// Scenarios that a list names and that do not exist.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissingTokens {
    /// The list: its name, or its file.
    pub split: String,
    /// Number of its tokens.
    pub wanted: usize,
    /// Those that no log holds.
    pub absent: Vec<String>,
    /// Those that a log holds but that are no scenario of the list.
    pub excluded: Vec<ExcludedToken>,
}

/// A token that a log holds and that is no scenario of a list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExcludedToken {
    /// The token.
    pub token: String,
    /// Why it is no scenario.
    pub reason: String,
}

impl MissingTokens {
    /// Whether every token gives a scenario.
    pub fn is_empty(&self) -> bool {
        self.absent.is_empty() && self.excluded.is_empty()
    }
}

impl fmt::Display for MissingTokens {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let missing = self.absent.len() + self.excluded.len();
        write!(
            f,
            "split {}: {missing} of {} scenarios are missing",
            self.split, self.wanted
        )?;
        if !self.absent.is_empty() {
            write!(
                f,
                "; {} in no log: {}",
                self.absent.len(),
                first_few(&self.absent, Clone::clone)
            )?;
        }
        if !self.excluded.is_empty() {
            let named = first_few(&self.excluded, |excluded| {
                format!("{} ({})", excluded.token, excluded.reason)
            });
            write!(f, "; {} that are no scenario: {named}", self.excluded.len())?;
        }
        Ok(())
    }
}

fn first_few<T>(list: &[T], word: impl Fn(&T) -> String) -> String {
    /// Entries that a message names.
    const MAX_NAMED: usize = 5;
    let more = if list.len() > MAX_NAMED { ", ..." } else { "" };
    list.iter()
        .take(MAX_NAMED)
        .map(word)
        .collect::<Vec<_>>()
        .join(", ")
        + more
}
