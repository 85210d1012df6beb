//! `drivers`: how reactive vehicles treat the ego.

use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use planagent_world::DriverBehavior;
use serde::Deserialize;

/// Behavior of the reactive vehicles that name none of their own.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::modified) struct Drivers {
    /// default, assertive, cautious or mixed.
    behavior: Option<String>,
    /// Whether they change lanes.
    #[serde(default)]
    lane_changes: bool,
}

/// The behavior of a word.
pub(in crate::modified) fn behavior(
    field: &'static str,
    word: &str,
) -> Result<DriverBehavior, Fault> {
    word.parse().map_err(|()| {
        Fault::new(
            field,
            format!("{word:?} is none of default, assertive, cautious, mixed"),
        )
    })
}

impl Change for Drivers {
    fn check(&self) -> Result<(), Fault> {
        self.behavior
            .as_deref()
            .map(|word| behavior("behavior", word))
            .transpose()
            .map(|_| ())
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        if let Some(word) = &self.behavior {
            draft.behavior = behavior("behavior", word)?;
        }
        draft.lane_changes |= self.lane_changes;
        Ok(())
    }
}
