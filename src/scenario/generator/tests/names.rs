//! Names and determinism.

use super::super::{DEFAULT, GeneratorError, MAX_DRAWS, Ranges, Spec, generate, types};
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
    for (ranges, id, log_name) in [
        (Ranges::First, "generated/changing_lane/3.12", "generated-3"),
        (
            Ranges::Wide,
            "generated/wide/changing_lane/3.12",
            "generated-wide-3",
        ),
        (
            Ranges::Wider,
            "generated/wider/changing_lane/3.12",
            "generated-wider-3",
        ),
    ] {
        let of_ranges = spec.drawn_from(ranges).with_traffic_seed(12);
        assert_eq!(of_ranges.to_string(), id);
        assert_eq!(id.parse(), Ok(of_ranges));
        assert_eq!(of_ranges.log_name(), log_name);
    }
    for id in [
        "generated/wide",
        "generated/wide/3",
        "generated/wide/wide/changing_lane/3",
        "generated/wide/wider/changing_lane/3",
        "generated/widest/changing_lane/3",
        "wide/changing_lane/3",
        "wider/changing_lane/3",
    ] {
        assert!(id.parse::<Spec>().is_err(), "{id}");
    }
}

/// One scenario of each type in the suites.
fn of_each_type(ranges: Ranges) -> Vec<Scenario> {
    let specs: Vec<Spec> = types::in_suites()
        .map(|kind| Spec::new(kind, 1).drawn_from(ranges))
        .collect();
    specs
        .par_iter()
        .map(|spec| generate(spec).unwrap())
        .collect()
}

#[test]
fn wide_scenarios_differ_from_the_others_and_repeat() {
    let [first, wide, wider] = [Ranges::First, Ranges::Wide, Ranges::Wider].map(of_each_type);
    for scenarios in [&wide, &wider] {
        let lanes = || scenarios.iter().flat_map(|scenario| scenario.map.lanes());
        let limits = || lanes().filter(|lane| !lane.is_connector());
        assert!(limits().any(|lane| lane.speed_limit.is_none()));
        let again: Spec = scenarios[0].id.parse().unwrap();
        assert!(same(&scenarios[0], &generate(&again).unwrap()));
    }
    assert!(
        wide.iter()
            .flat_map(|scenario| scenario.map.lanes())
            .any(|lane| lane.speed_limit.is_some())
    );
    for ((first, wide), wider) in first.iter().zip(&wide).zip(&wider) {
        for (one, other) in [(first, wide), (first, wider), (wide, wider)] {
            assert!(!same_map(&one.map, &other.map), "{} {}", one.id, other.id);
        }
    }
}

#[test]
fn lanes_of_wider_scenarios_still_meet() {
    for scenario in of_each_type(Ranges::Wider) {
        for lane in scenario.map.lanes() {
            for next in lane.outgoing.iter().map(|&next| &scenario.map[next]) {
                let gap = (lane.centerline.end() - next.centerline.start()).norm();
                assert!(gap < 1e-6, "{}: {gap} m", scenario.id);
            }
            let (polygon, line) = (&lane.polygon, &lane.centerline);
            let inside = |share: f64| polygon.contains(line.point_at(share * line.length()));
            let places = [0.25, 0.5, 0.75];
            assert!(places.into_iter().all(inside), "{}", scenario.id);
        }
    }
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
