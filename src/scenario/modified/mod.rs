//! Modified scenarios: a layer over a scenario of any source, read from a TOML file or one of the
//! built-in kinds.
//!
//! A word `WORD~NAME` or `WORD~FILE.toml` names the scenario of `WORD` with a modification. Places
//! are relative to the ego's lane, and numbers may be bounds between which the seed of the scene
//! draws. A modification is a list of changes; each kind of change is one file of `changes` and one
//! line of its table. The changes apply in the order of that table.

mod change;
mod changes;
mod draft;
mod draws;
mod error;
mod fault;
mod file;
mod finish;
mod kinds;
mod lanes;
mod named;
mod number;
#[cfg(test)]
mod tests;
mod twin;
mod word;

pub use error::ModifyError;
pub use kinds::kind_texts;
pub use twin::{Twin, TwinKind, TwinPart, TwinSide};
pub use word::without_modification;
pub use word::{MARK, ModifiedName, ReadModification};

use super::Scenario;
use draft::Draft;
use draws::Draws;
use file::Modification;
use lanes::EgoLanes;

/// From the ego's center at the start along its lane to the next lane connector, meters; 0 on one.
/// `None` where there is none, or the ego is on no lane.
pub fn to_intersection(scenario: &Scenario) -> Option<f64> {
    let ego = scenario.expert().next()?;
    EgoLanes::from_route(&scenario.map, &scenario.route, ego)?.to_intersection(&scenario.map)
}

/// The scenario with the changes of a modification; `seed` beside that of the file draws other
/// numbers.
///
/// # Errors
/// When a change does not fit the scenario.
fn modified(
    base: Scenario,
    modification: &Modification,
    seed: u64,
) -> Result<Scenario, ModifyError> {
    let id = base.id.clone();
    let unfit = |fault: &str| ModifyError::Unfit {
        place: modification.place.clone(),
        scenario: id.clone(),
        fault: fault.to_owned(),
    };
    let first = base
        .frame(0)
        .ok_or_else(|| unfit("the scenario has no frames"))?;
    let lanes = EgoLanes::from_route(&base.map, &base.route, &first.ego)
        .ok_or_else(|| unfit("the ego starts on no lane, and places are relative to its lane"))?;
    let seeds = [modification.seed, seed];
    let draws = Draws::new(&id, &modification.drawn_by, seeds);
    let mut draft = Draft::new(base, lanes, draws);
    // In the file's order: a change builds on those before it, and all draw from one stream.
    for change in &modification.changes {
        change
            .change
            .apply(&mut draft)
            .map_err(|fault| ModifyError::Misfit {
                place: modification.place.clone(),
                line: change.line,
                change: change.key,
                scenario: id.clone(),
                fault,
            })?;
    }
    finish::finish(draft, modification)
}
