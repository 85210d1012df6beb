//! The built-in modifications: interPlan's eight kinds, each a TOML file of `kinds/`.

use super::error::ModifyError;
use super::file::Modification;
use planagent_world::InteractionKind;
use std::sync::{Arc, OnceLock};

/// The text of each kind's file, in the order of the kinds.
macro_rules! texts {
    ($($name:literal,)*) => { [$(include_str!(concat!("kinds/", $name, ".toml"))),*] };
}

const TEXTS: [&str; 8] = texts![
    "low_traffic_density",
    "medium_traffic_density",
    "high_traffic_density",
    "overtake_parked_vehicle",
    "nudge_around_parked_vehicle",
    "avoid_crashed_cars",
    "approaching_construction_zone",
    "jaywalking_pedestrian",
];

/// The kinds with the texts of their files.
pub fn kind_texts() -> impl Iterator<Item = (InteractionKind, &'static str)> {
    InteractionKind::ALL.into_iter().zip(TEXTS)
}

/// The modification of a kind; each is parsed once.
pub(super) fn modification(kind: InteractionKind) -> Result<Arc<Modification>, ModifyError> {
    static PARSED: [OnceLock<Arc<Modification>>; 8] = [const { OnceLock::new() }; 8];
    let place = InteractionKind::ALL
        .iter()
        .position(|&one| one == kind)
        .expect("ALL lists every kind");
    if let Some(known) = PARSED[place].get() {
        return Ok(Arc::clone(known));
    }
    let parsed = Arc::new(Modification::parse(kind.name(), kind.name(), TEXTS[place])?);
    Ok(Arc::clone(PARSED[place].get_or_init(|| parsed)))
}
