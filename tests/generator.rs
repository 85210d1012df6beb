//! Generated scenarios under log replay: how well the tracker follows the expert. And a scenario
//! type from outside the crate.

use planagent_agent::planner::LogReplay;
use planagent_agent::simulation::{Challenge, simulate};
use planagent_scenario::Scenario;
use planagent_scenario::generator::prelude::*;
use planagent_scenario::generator::{Spec, generate, types};
use proptest::prelude::*;
use rayon::prelude::*;

/// Seeds of each type; `docs/generator.md` has the figures for 50.
const SEEDS: u64 = 10;
/// Multipliers that log replay should not fail.
const MULTIPLIERS: [&str; 3] = [
    "no_ego_at_fault_collisions",
    "drivable_area_compliance",
    "driving_direction_compliance",
];

/// The multipliers that log replay fails with non-reactive agents.
fn failed(scenario: &Scenario) -> Vec<&'static str> {
    let expert: Vec<_> = scenario.expert().copied().collect();
    let mut planner = LogReplay::new(expert.clone());
    let log = simulate(scenario, &mut planner, Challenge::NonReactive)
        .unwrap_or_else(|error| panic!("{error}"));
    let evaluation = log
        .evaluate(scenario)
        .unwrap_or_else(|error| panic!("{}: {error}", scenario.id));
    let passes = |name: &str| {
        evaluation
            .metric(name)
            .and_then(|metric| metric.score)
            .is_some_and(|s| s >= 1.0)
    };
    MULTIPLIERS
        .into_iter()
        .filter(|name| !passes(name))
        .collect()
}

#[test]
fn log_replay_follows_the_expert_and_the_documentation_lists_where_it_cannot() {
    let listed = include_str!("../docs/generator.md");
    let specs: Vec<Spec> = types::in_suites()
        .flat_map(|scenario_type| (0..SEEDS).map(move |seed| Spec::new(scenario_type, seed)))
        .collect();
    let failures: Vec<(Spec, Vec<&str>)> = specs
        .par_iter()
        .map(|spec| (*spec, failed(&generate(spec).unwrap())))
        .filter(|(_, names)| !names.is_empty())
        .collect();
    assert!(
        failures.len() * 20 <= specs.len(),
        "more than one in twenty: {failures:?}"
    );
    for (spec, names) in failures {
        assert!(
            listed.contains(&format!("`{spec}`")),
            "docs/generator.md does not list {spec}: {names:?}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any name gives a scenario that can be simulated and scored.
    #[test]
    fn any_name_gives_a_scenario_that_can_be_simulated(kind in 0..types::in_suites().count(), seed in any::<u64>()) {
        let spec = Spec::new(types::ALL[kind], seed);
        let scenario = generate(&spec).unwrap();
        prop_assert_eq!(&scenario.id, &spec.to_string());
        failed(&scenario);
    }
}

/// A type of this test: a country road behind a car.
const COUNTRY_ROAD: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "country_road",
    seed: 1_000_000,
    group: TypeGroup::Case,
    setting: |rng| {
        let style = setting::style(rng, [1, 1], [1, 1], &LIMITS[4..]);
        Ok(Setting::new(
            setting::corridor(rng, &style, 0.5)?,
            BEHIND,
            0.9,
        ))
    },
    populate: |builder| {
        let speed = builder.ego_speed();
        builder.put_ahead(VehicleKind::Car, 30.0, 0.9 * speed);
        builder.add_clutter();
    },
    shows: |log| log.fast(9.0),
});

#[test]
fn a_scenario_type_from_outside_the_crate_makes_scenarios() {
    let spec = Spec::new(COUNTRY_ROAD, 3);
    let [own, other] = [spec, spec.with_traffic_seed(1)].map(|spec| generate(&spec).unwrap());
    assert_eq!(
        (own.id.as_str(), own.scenario_type.as_str()),
        ("generated/country_road/3", "country_road")
    );
    assert!(own.route.roadblocks == other.route.roadblocks && own.frames != other.frames);
    assert_eq!(own.iterations(), 151);
}
