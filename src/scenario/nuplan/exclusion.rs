//! Why a row of a log is no scenario of a filter.

use std::collections::BTreeMap;
use std::fmt;

/// Why a row of a log is not among the scenarios of a filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exclusion {
    /// Its scene is one of the first two or last two of the log, or none.
    SceneAtEdge,
    /// It has no tag of the wanted types.
    OtherType,
    OtherMap,
    OtherLog,
    /// Its scene has no mission goal.
    NoGoal,
    /// A filter read its rows and found it too short, or without a route.
    NotDrivable,
    /// A field of the filter excludes it, by nuPlan's name.
    Filtered(&'static str),
}

impl Exclusion {
    /// The deciding field of the filter, else the rule in words.
    fn key(self) -> &'static str {
        match self {
            Self::SceneAtEdge => {
                "nuPlan's rule that the first two and last two scenes of a log give none"
            }
            Self::OtherType => "scenario_types",
            Self::OtherMap => "map_names",
            Self::OtherLog => "log_names",
            Self::NoGoal => "remove_invalid_goals",
            Self::NotDrivable => "the rule that a scenario has 3 s and a route",
            Self::Filtered(key) => key,
        }
    }
}

impl fmt::Display for Exclusion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SceneAtEdge => "its scene is among the first two or last two of the log",
            Self::OtherType => "it has no tag of the listed scenario types",
            Self::OtherMap => "its map is not listed",
            Self::OtherLog => "its log is not listed",
            Self::NoGoal => "its scene has no mission goal",
            Self::NotDrivable => "it is too short or has no route",
            Self::Filtered(key) => return write!(f, "{key} excludes it"),
        })
    }
}

/// The number of logs and rows that a search excluded.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Exclusions {
    /// Logs that were searched.
    pub logs: usize,
    /// Logs that `log_names` does not name; they were not opened.
    pub other_logs: usize,
    /// Rows by reason.
    pub rows: BTreeMap<Exclusion, usize>,
}

impl Exclusions {
    /// Rows that a field of the filter excludes.
    pub fn by(&self, key: &'static str) -> usize {
        self.rows
            .get(&Exclusion::Filtered(key))
            .copied()
            .unwrap_or_default()
    }
}

impl fmt::Display for Exclusions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.logs == 0 {
            return write!(f, "log_names names none of the {} logs", self.other_logs);
        }
        let rows: usize = self.rows.values().sum();
        if rows == 0 {
            write!(
                f,
                "{} logs were searched, and no row has a scenario tag",
                self.logs
            )?;
        } else {
            write!(f, "{} logs were searched; of {rows} rows", self.logs)?;
        }
        for (place, (refusal, count)) in self.rows.iter().enumerate() {
            let comma = if place > 0 { "," } else { "" };
            write!(f, "{comma} {count} were excluded by {}", refusal.key())?;
        }
        if self.other_logs > 0 {
            write!(
                f,
                "; log_names does not name {} other logs",
                self.other_logs
            )?;
        }
        Ok(())
    }
}
