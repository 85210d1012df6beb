//! Names and determinism.

use super::super::{DEFAULT, GeneratorError, ScenarioType, Spec, generate};
use crate::scenario::Scenario;
use rayon::prelude::*;

#[test]
fn names_read_back() {
    for scenario_type in ScenarioType::ALL {
        let spec = Spec { scenario_type, seed: u64::MAX };
        assert_eq!(spec.to_string().parse(), Ok(spec));
    }
    assert_eq!(ScenarioType::nuplan14().count(), 14);
}

#[test]
fn bad_names_say_what_is_wrong() {
    let read = |id: &str| id.parse::<Spec>();
    for id in ["", "generated", "generated/changing_lane", "womd/changing_lane/1", "generated/changing_lane/1/2"] {
        assert_eq!(read(id), Err(GeneratorError::Form(id.to_owned())));
    }
    assert_eq!(read("generated/flying/1"), Err(GeneratorError::UnknownType("flying".to_owned())));
    let id = "generated/changing_lane/-1".to_owned();
    assert_eq!(read(&id), Err(GeneratorError::Seed { seed: "-1".to_owned(), id }));
}

/// Every number of a drive: frames, map and route.
fn same(a: &Scenario, b: &Scenario) -> bool {
    let lanes = a.map.lanes() == b.map.lanes() && a.map.roadblocks() == b.map.roadblocks();
    let areas = a.map.intersections() == b.map.intersections()
        && a.map.crosswalks() == b.map.crosswalks()
        && a.map.generic_drivable() == b.map.generic_drivable()
        && a.map.carparks() == b.map.carparks()
        && a.map.stop_lines() == b.map.stop_lines();
    lanes && areas && a.frames == b.frames && a.route == b.route && a.id == b.id && a.start == b.start
}

#[test]
fn a_name_gives_the_same_drive_at_any_number_of_threads() {
    let specs: Vec<Spec> = ScenarioType::ALL.into_iter().map(|scenario_type| Spec { scenario_type, seed: 7 }).collect();
    let drives = |threads: usize| -> Vec<Scenario> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| specs.par_iter().map(|spec| generate(spec).unwrap()).collect())
    };
    assert!(drives(1).iter().zip(&drives(2)).all(|(a, b)| same(a, b)));
}

#[test]
fn different_seeds_give_different_drives() {
    let corpus = &super::CORPUS;
    for (i, a) in corpus.iter().enumerate() {
        for b in &corpus[i + 1..] {
            assert!(a.scenario.frames != b.scenario.frames, "{} {}", a.scenario.id, b.scenario.id);
        }
    }
}

#[test]
fn the_default_drive_goes_round_something() {
    let scenario = generate(&DEFAULT).unwrap();
    let lanes: std::collections::BTreeSet<_> = scenario
        .expert()
        .filter_map(|ego| scenario.map.lane_of(ego.center(), 1.0))
        .filter(|&lane| !scenario.map[lane].is_connector())
        .collect();
    assert!(lanes.len() > 1);
}
