//! Filters take the scenarios that the devkit takes, in its order.

use super::fixture::{DataSet, LOCATION};
use planagent_scenario::nuplan::{Limit, LogScenario, ScenarioFilter, Token, TokenSet};
use std::collections::BTreeSet;

/// Every second row is tagged `behind_bike`, every third `changing_lane`; all rows lie in a valid
/// scene.
fn tagged() -> DataSet {
    DataSet::log_with(
        "DELETE FROM scenario_tag;
         CREATE TEMP TABLE n AS SELECT token, ROW_NUMBER() OVER (ORDER BY timestamp) AS n FROM lidar_pc;
         INSERT INTO scenario_tag SELECT randomblob(8), token, 'behind_bike', NULL FROM n WHERE n % 2 = 0;
         INSERT INTO scenario_tag SELECT randomblob(8), token, 'changing_lane', NULL FROM n WHERE n % 3 = 0;
         UPDATE lidar_pc SET scene_token = (SELECT token FROM scene ORDER BY name LIMIT 1 OFFSET 2);",
    )
}

fn types(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn by_time(mut found: Vec<LogScenario>) -> Vec<LogScenario> {
    found.sort_by_key(|one| one.timestamp_us);
    found
}

#[test]
fn the_alphabetically_last_wanted_tag_is_the_type() {
    let set = tagged();
    let all = set.find(&ScenarioFilter::default()).unwrap().scenarios;
    let count = |name: &str| all.iter().filter(|one| one.scenario_type == name).count();
    let rows = all.len();
    assert_eq!(
        (count("changing_lane"), count("behind_bike")),
        (rows / 3, rows / 2 - rows / 6)
    );
    assert_eq!(count("unknown"), rows - rows / 3 - rows / 2 + rows / 6);
    let bikes = ScenarioFilter {
        scenario_types: Some(types(&["behind_bike"])),
        ..Default::default()
    };
    let bikes = set.find(&bikes).unwrap().scenarios;
    assert_eq!(
        bikes.len(),
        rows / 2,
        "a row with both tags counts for the one that is asked for"
    );
    assert!(bikes.iter().all(|one| one.scenario_type == "behind_bike"));
    assert!(all.is_sorted_by_key(|one| one.token), "in order of token");
    assert!(all.iter().all(|one| one.map_name == LOCATION));
}

#[test]
fn numbers_are_evenly_spaced_and_unknown_ones_go_first() {
    let set = tagged();
    let bikes = ScenarioFilter {
        scenario_types: Some(types(&["behind_bike"])),
        ..Default::default()
    };
    let all = by_time(set.find(&bikes).unwrap().scenarios);
    let seven = ScenarioFilter {
        num_scenarios_per_type: Some(7),
        ..bikes.clone()
    };
    let picked = by_time(set.find(&seven).unwrap().scenarios);
    let step = all.len() / 7;
    let expected: Vec<LogScenario> = all.iter().step_by(step).take(7).cloned().collect();
    assert_eq!(picked, expected);
    let rows = set
        .find(&ScenarioFilter::default())
        .unwrap()
        .scenarios
        .len();
    let tags = rows / 3 + rows / 2 - rows / 6;
    let limited = |limit| {
        let filter = ScenarioFilter {
            limit_total_scenarios: Some(limit),
            ..Default::default()
        };
        set.find(&filter).unwrap().scenarios
    };
    let unknown = |found: &[LogScenario]| {
        found
            .iter()
            .filter(|one| one.scenario_type == "unknown")
            .count()
    };
    let most = limited(Limit::Count(tags + 5));
    assert_eq!((most.len(), unknown(&most)), (tags + 5, 5));
    let few = limited(Limit::Count(10));
    assert_eq!((few.len(), unknown(&few)), (10, 0));
    assert_eq!(limited(Limit::Fraction(0.5)).len(), rows.div_ceil(2));
    assert_eq!(limited(Limit::Count(rows + 1)).len(), rows);
}

#[test]
fn scenarios_of_a_type_lie_apart_in_time() {
    let set = tagged();
    let filter = ScenarioFilter {
        scenario_types: Some(types(&["behind_bike", "changing_lane"])),
        timestamp_threshold_s: Some(2.0),
        ..Default::default()
    };
    let found = by_time(set.find(&filter).unwrap().scenarios);
    for name in ["behind_bike", "changing_lane"] {
        let times: Vec<i64> = found
            .iter()
            .filter(|one| one.scenario_type == name)
            .map(|one| one.timestamp_us)
            .collect();
        assert!(times.len() > 5, "{name}: {times:?}");
        assert!(
            times.windows(2).all(|pair| pair[1] - pair[0] >= 2_000_000),
            "{name}: {times:?}"
        );
    }
}

#[test]
fn shuffling_is_drawn_by_the_seed() {
    let set = tagged();
    let filter = |shuffle, seed| ScenarioFilter {
        scenario_types: Some(types(&["behind_bike"])),
        num_scenarios_per_type: Some(20),
        shuffle,
        seed,
        ..Default::default()
    };
    let tokens = |filter: &ScenarioFilter| -> Vec<Token> {
        set.find(filter)
            .unwrap()
            .scenarios
            .into_iter()
            .map(|one| one.token)
            .collect()
    };
    assert_eq!(tokens(&filter(true, 1)), tokens(&filter(true, 1)));
    assert_ne!(tokens(&filter(true, 1)), tokens(&filter(true, 2)));
    assert!(!tokens(&filter(true, 1)).is_sorted());
    assert!(tokens(&filter(false, 1)).is_sorted());
}

#[test]
fn motion_of_the_ego() {
    let set = DataSet::new();
    let scenario = set.open().unwrap();
    let expert: Vec<_> = scenario.expert().collect();
    let distance: f64 = expert
        .windows(2)
        .skip(1)
        .map(|pair| pair[0].center().distance(&pair[1].center()))
        .sum();
    let passes = |filter: ScenarioFilter| {
        let filter = ScenarioFilter {
            scenario_tokens: Some(vec![set.token]),
            ..filter
        };
        !set.find(&filter).unwrap().scenarios.is_empty()
    };
    let moves = |meters| {
        passes(ScenarioFilter {
            ego_displacement_minimum_m: Some(meters),
            ..Default::default()
        })
    };
    assert!(distance > 10.0 && moves(distance - 0.01) && !moves(distance + 0.01));
    let speeds: Vec<f64> = expert.iter().map(|state| state.speed()).collect();
    let (low, high) = speeds
        .iter()
        .fold((f64::MAX, 0.0_f64), |(low, high), &speed| {
            (low.min(speed), high.max(speed))
        });
    let starts = |speed| {
        passes(ScenarioFilter {
            ego_start_speed_threshold: Some(speed),
            ..Default::default()
        })
    };
    let stops = |speed| {
        passes(ScenarioFilter {
            ego_stop_speed_threshold: Some(speed),
            ..Default::default()
        })
    };
    assert!(
        !starts(high + 0.1) && !stops(high + 0.1),
        "the ego is never so fast"
    );
    assert!(
        low < f64::EPSILON || (!starts(low / 2.0) && !stops(low / 2.0)),
        "the ego is never so slow"
    );
    // The ego crosses the middle of its speeds in one direction at least.
    let middle = f64::midpoint(low, high);
    assert!(starts(middle) || stops(middle));
    let noisy = |noise| {
        let filter = ScenarioFilter {
            speed_noise_tolerance: Some(noise),
            ..Default::default()
        };
        passes(ScenarioFilter {
            ego_start_speed_threshold: Some(middle),
            ..filter.clone()
        }) || passes(ScenarioFilter {
            ego_stop_speed_threshold: Some(middle),
            ..filter
        })
    };
    assert!(
        noisy(0.0) && !noisy(high - low + 0.1),
        "changes below the tolerance are noise"
    );
}

#[test]
fn token_sets_and_routes() {
    let set = DataSet::new();
    let path = set.folder.path().join("tokens.json");
    let passes = |filter: ScenarioFilter| {
        let filter = ScenarioFilter {
            scenario_tokens: Some(vec![set.token]),
            ..filter
        };
        set.find(&filter)
            .map(|findings| !findings.scenarios.is_empty())
    };
    let in_set = |fraction| {
        let token_set = Some(TokenSet {
            path: path.clone(),
            fraction,
        });
        passes(ScenarioFilter {
            token_set,
            ..Default::default()
        })
    };
    let rows: BTreeSet<String> = {
        let connection = rusqlite::Connection::open(&set.log).unwrap();
        let mut statement = connection
            .prepare("SELECT lower(hex(token)) FROM lidar_pc")
            .unwrap();
        statement
            .query_map([], |row| row.get(0))
            .unwrap()
            .map(Result::unwrap)
            .collect()
    };
    let write =
        |tokens: &[&String]| std::fs::write(&path, serde_json::to_string(tokens).unwrap()).unwrap();
    write(&rows.iter().collect::<Vec<_>>());
    assert!(in_set(0.99).unwrap());
    assert!(
        !in_set(1.0).unwrap(),
        "the set holds rows that the scenario does not have"
    );
    write(&rows.iter().take(1).collect::<Vec<_>>());
    assert!(!in_set(0.5).unwrap());
    std::fs::write(&path, "{}").unwrap();
    assert!(
        in_set(0.5)
            .unwrap_err()
            .to_string()
            .contains("a token set is a JSON list of tokens")
    );
    std::fs::write(&path, "[\"12\"]").unwrap();
    assert!(
        in_set(0.5)
            .unwrap_err()
            .to_string()
            .contains("'12' is no token")
    );
    let near = |radius| {
        passes(ScenarioFilter {
            ego_route_radius: Some(radius),
            ..Default::default()
        })
        .unwrap()
    };
    assert!(near(5.0));
}
