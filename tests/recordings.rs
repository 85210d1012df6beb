//! What `docs/recordings.md` says of all recordings.

use crate::outside::{Needy, data};
use planagent_scenario::{DataRoots, Frame, Readers, Scenario};

const FOLDERS: [&str; 4] = [
    "womd",
    "argoverse2",
    "womd_validation",
    "argoverse2_validation",
];

/// Whether the recorded ego never leaves the lanes of the route with its center.
fn route_holds_the_ego(
    Scenario {
        map,
        route,
        frames,
        start,
        ..
    }: &Scenario,
) -> bool {
    let held = |frame: &Frame| {
        let center = frame.ego.center().position();
        route
            .roadblocks
            .iter()
            .any(|&block| map.roadblock_holds(block, center))
    };
    frames[*start..].iter().all(held)
}

#[test]
fn routes_hold_the_recorded_ego() -> Needy {
    let folders = FOLDERS
        .into_iter()
        .map(data)
        .collect::<Result<Vec<_>, _>>()?;
    let readers = Readers::new(&DataRoots::default());
    let found = folders
        .iter()
        .flat_map(|folder| readers.find(folder.to_str().unwrap()).unwrap());
    let held: Vec<bool> = found
        .map(|source| route_holds_the_ego(&source.open().unwrap()))
        .collect();
    let holding = held.iter().filter(|&&held| held).count();
    assert_eq!((holding, held.len()), (37, 46));
    Ok(())
}
