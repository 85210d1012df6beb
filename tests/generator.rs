//! Generated scenes, driven again by log replay: how far the recorded driver can be followed.

use planagent::internals::planner::LogReplay;
use planagent::internals::scenario::Scenario;
use planagent::internals::scenario::generator::{ScenarioType, Spec, generate};
use planagent::internals::simulation::{Challenge, simulate};
use proptest::prelude::*;
use rayon::prelude::*;

/// Seeds of each type that are driven here; `docs/generator.md` gives the figures for 50.
const SEEDS: u64 = 10;
/// The multipliers that a recorded drive should not fail.
const MULTIPLIERS: [&str; 3] =
    ["no_ego_at_fault_collisions", "drivable_area_compliance", "driving_direction_compliance"];

/// Which multipliers log replay fails without reacting traffic.
fn failed(scenario: &Scenario) -> Vec<&'static str> {
    let expert: Vec<_> = scenario.expert().copied().collect();
    let mut planner = LogReplay::new(expert.clone());
    let log = simulate(scenario, &mut planner, Challenge::NonReactive).unwrap_or_else(|error| panic!("{error}"));
    let evaluation = log.evaluate(scenario).unwrap_or_else(|error| panic!("{}: {error}", scenario.id));
    let passes = |name: &str| evaluation.metric(name).and_then(|metric| metric.score).is_some_and(|s| s >= 1.0);
    MULTIPLIERS.into_iter().filter(|name| !passes(name)).collect()
}

#[test]
fn log_replay_follows_the_expert_and_the_documentation_lists_where_it_cannot() {
    let listed = include_str!("../docs/generator.md");
    let specs: Vec<Spec> = ScenarioType::ALL
        .into_iter()
        .flat_map(|scenario_type| (0..SEEDS).map(move |seed| Spec::new(scenario_type, seed)))
        .collect();
    let failures: Vec<(Spec, Vec<&str>)> = specs
        .par_iter()
        .map(|spec| (*spec, failed(&generate(spec).unwrap())))
        .filter(|(_, names)| !names.is_empty())
        .collect();
    assert!(failures.len() * 20 <= specs.len(), "more than one in twenty: {failures:?}");
    for (spec, names) in failures {
        assert!(listed.contains(&format!("`{spec}`")), "docs/generator.md does not list {spec}: {names:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any name gives a drive, and the drive can be replayed and judged.
    #[test]
    fn any_name_gives_a_drive_that_can_be_replayed(kind in 0..ScenarioType::ALL.len(), seed in any::<u64>()) {
        let spec = Spec::new(ScenarioType::ALL[kind], seed);
        let scenario = generate(&spec).unwrap();
        prop_assert_eq!(&scenario.id, &spec.to_string());
        failed(&scenario);
    }
}
