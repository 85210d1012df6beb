//! Names and determinism.

use super::super::{DEFAULT, GeneratorError, MAX_DRAWS, Spec, generate, types};
use crate::Scenario;
use planagent_world::LaneMap;
use rayon::prelude::*;

#[test]
fn names_read_back() {
    for &scenario_type in types::ALL {
        let spec = Spec::new(scenario_type, u64::MAX);
        assert_eq!(spec.to_string().parse(), Ok(spec));
        assert_eq!(
            spec.with_traffic_seed(u64::MAX).to_string().parse(),
            Ok(spec.with_traffic_seed(u64::MAX))
        );
    }
    let spec = Spec::new(types::changing_lane::TYPE, 3);
    assert_eq!(
        ("generated/changing_lane/3.0".parse(), spec.to_string()),
        (Ok(spec), "generated/changing_lane/3".into())
    );
    assert_eq!(
        spec.with_traffic_seed(12).to_string(),
        "generated/changing_lane/3.12"
    );
    assert_eq!(types::nuplan14().count(), 14);
}

#[test]
fn wide_scenarios_have_names_of_their_own() {
    let spec = Spec::new(types::changing_lane::TYPE, 3);
    let wide = spec.widened().with_traffic_seed(12);
    assert_eq!(wide.to_string(), "generated/wide/changing_lane/3.12");
    assert_eq!("generated/wide/changing_lane/3.12".parse(), Ok(wide));
    assert_eq!(
        (spec.log_name().as_str(), wide.log_name().as_str()),
        ("generated-3", "generated-wide-3")
    );
    for id in [
        "generated/wide",
        "generated/wide/3",
        "generated/wide/wide/changing_lane/3",
        "wide/changing_lane/3",
    ] {
        assert!(id.parse::<Spec>().is_err(), "{id}");
    }
}

#[test]
fn wide_scenarios_differ_from_the_others_and_repeat() {
    let specs: Vec<Spec> = types::in_suites()
        .map(|kind| Spec::new(kind, 1).widened())
        .collect();
    let scenarios: Vec<Scenario> = specs
        .par_iter()
        .map(|spec| generate(spec).unwrap())
        .collect();
    let lanes = || scenarios.iter().flat_map(|scenario| scenario.map.lanes());
    assert!(
        lanes().any(|lane| !lane.is_connector() && lane.speed_limit.is_none()),
        "all limits are known"
    );
    assert!(scenarios.iter().any(|scenario| {
        scenario
            .map
            .lanes()
            .iter()
            .any(|lane| lane.speed_limit.is_some())
    }));
    for scenario in &scenarios {
        let other: Spec = scenario.id.replace("wide/", "").parse().unwrap();
        assert!(
            !same_map(&scenario.map, &generate(&other).unwrap().map),
            "{}",
            scenario.id
        );
    }
    assert!(same(&scenarios[0], &generate(&specs[0]).unwrap()));
}

/// Two types with overlapping seeds would share draws.
#[test]
fn seeds_of_types_lie_apart() {
    let mut seeds: Vec<u64> = types::ALL
        .iter()
        .map(|kind| kind.definition().seed)
        .collect();
    seeds.sort_unstable();
    assert!(
        seeds
            .windows(2)
            .all(|pair| pair[1] - pair[0] >= MAX_DRAWS as u64),
        "{seeds:?}"
    );
}

#[test]
fn bad_names_say_what_is_wrong() {
    let read = |id: &str| id.parse::<Spec>();
    for id in [
        "",
        "generated",
        "generated/changing_lane",
        "womd/changing_lane/1",
        "generated/changing_lane/1/2",
    ] {
        assert_eq!(read(id), Err(GeneratorError::Form(id.to_owned())));
    }
    assert_eq!(
        read("generated/flying/1"),
        Err(GeneratorError::UnknownType("flying".to_owned()))
    );
    for (seed, which, wrong) in [
        ("-1", "seed", "-1"),
        ("1.x", "traffic seed", "x"),
        ("1.2.3", "traffic seed", "2.3"),
    ] {
        let id = format!("generated/changing_lane/{seed}");
        assert_eq!(
            read(&id),
            Err(GeneratorError::Seed {
                which,
                seed: wrong.to_owned(),
                id
            })
        );
    }
}

/// Every number of a map.
pub(super) fn same_map(a: &LaneMap, b: &LaneMap) -> bool {
    let lanes = a.lanes() == b.lanes() && a.roadblocks() == b.roadblocks();
    let areas = a.intersections() == b.intersections()
        && a.crosswalks() == b.crosswalks()
        && a.generic_drivable() == b.generic_drivable()
        && a.carparks() == b.carparks()
        && a.stop_lines() == b.stop_lines();
    lanes && areas && a.name() == b.name()
}

/// Every number of a scenario: frames, map and route.
fn same(a: &Scenario, b: &Scenario) -> bool {
    same_map(&a.map, &b.map)
        && a.frames == b.frames
        && a.route == b.route
        && a.id == b.id
        && a.start == b.start
}

#[test]
fn a_name_gives_the_same_scenario_at_any_number_of_threads() {
    let specs: Vec<Spec> = types::in_suites()
        .map(|scenario_type| Spec::new(scenario_type, 7))
        .collect();
    let scenarios = |threads: usize| -> Vec<Scenario> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            specs
                .par_iter()
                .map(|spec| generate(spec).unwrap())
                .collect()
        })
    };
    assert!(
        scenarios(1)
            .iter()
            .zip(&scenarios(2))
            .all(|(a, b)| same(a, b))
    );
}

#[test]
fn different_seeds_give_different_scenarios() {
    let corpus = &super::CORPUS;
    for (i, a) in corpus.iter().enumerate() {
        for b in &corpus[i + 1..] {
            assert!(
                a.scenario.frames != b.scenario.frames,
                "{} {}",
                a.scenario.id,
                b.scenario.id
            );
        }
    }
}

#[test]
fn the_default_scenario_has_a_lane_change() {
    let scenario = generate(&DEFAULT).unwrap();
    let lanes: std::collections::BTreeSet<_> = scenario
        .expert()
        .filter_map(|ego| scenario.map.lane_of(ego.center(), 1.0))
        .filter(|&lane| !scenario.map[lane].is_connector())
        .collect();
    assert!(lanes.len() > 1);
}
