//! `remove`: logged objects that are left out.

use crate::modified::change::Change;
use crate::modified::draft::Draft;
use crate::modified::fault::Fault;
use planagent_world::{ObjectKind, TrackedObject};
use serde::Deserialize;

/// Leaves out logged objects of these classes, everywhere or around a place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "each is a field of the file")]
pub(in crate::modified) struct Remove {
    #[serde(default)]
    vehicles: bool,
    #[serde(default)]
    people: bool,
    #[serde(default)]
    bicycles: bool,
    /// Cones, barriers, signs and other things.
    #[serde(default)]
    things: bool,
    /// Only those within this distance of the ego at the start, meters.
    within_m: Option<f64>,
}

impl Change for Remove {
    fn check(&self) -> Result<(), Fault> {
        if !(self.vehicles || self.people || self.bicycles || self.things) {
            return Err(Fault::new(
                "vehicles",
                "nothing is removed; set vehicles, people, bicycles or things to true",
            ));
        }
        match self.within_m {
            Some(reach) if !(reach.is_finite() && reach > 0.0) => {
                Err(Fault::new("within_m", format!("{reach} must be above 0")))
            }
            _ => Ok(()),
        }
    }

    fn apply(&self, draft: &mut Draft) -> Result<(), Fault> {
        let ego = draft.ego().center();
        let is_meant = |object: &&TrackedObject| {
            let of_class = match object.kind {
                ObjectKind::Vehicle => self.vehicles,
                ObjectKind::Pedestrian => self.people,
                ObjectKind::Bicycle => self.bicycles,
                _ => self.things,
            };
            of_class
                && self
                    .within_m
                    .is_none_or(|reach| object.shape.center.distance(&ego) <= reach)
        };
        // A track with a place counts where it is at the start.
        let start = draft.scenario.start;
        let frames = if self.within_m.is_some() {
            start..start + 1
        } else {
            0..draft.scenario.frames.len()
        };
        let objects = draft.scenario.frames[frames]
            .iter()
            .flat_map(|frame| frame.objects.iter());
        let tokens: Vec<_> = objects
            .filter(is_meant)
            .map(|object| object.token)
            .collect();
        draft.removed.extend(tokens);
        Ok(())
    }
}
