//! Scenarios written in nuPlan's formats and read again.

use super::compare::{Pair, blocks};
use planagent_agent::planner::{IdmPlanner, LogReplay, PdmClosed, Planner, SimplePlanner};
use planagent_agent::simulation::{Challenge, simulate};
use planagent_scenario::Scenario;
use planagent_scenario::generator::{ScenarioType, Spec, generate, types};
use planagent_scenario::nuplan::export::{
    ExportChanges, ExportSettings, Exported, write_scenarios,
};
use planagent_scenario::nuplan::{Logs, MapStore, ScenarioFilter, SearchResult, open, search};
use planagent_score::metrics::Evaluation;
use planagent_world::LaneAreas;
use planagent_world::geometry::{Point, Vector};
use rayon::prelude::*;
use std::path::Path;

/// Maximal difference of scores by rounding.
const SAME_SCORE: f64 = 1e-6;

pub(super) fn generated(kind: ScenarioType, seed: u64) -> Scenario {
    generate(&Spec::new(kind, seed)).unwrap()
}

/// The scenarios of a written folder, with the shift of their origins.
pub(super) fn read_back(
    exported: &Exported,
    settings: &ExportSettings,
    cache: &Path,
) -> Vec<(Scenario, Vector)> {
    let maps = MapStore::with_cache(Some(exported.maps.clone()), Some(cache.to_owned()));
    let logs = Logs::under(&exported.data).unwrap().logs;
    let SearchResult { scenarios, .. } =
        search(&logs, &ScenarioFilter::default(), &maps, &|_, _| ()).unwrap();
    assert_eq!(scenarios.len(), exported.logs.len(), "a log is a scenario");
    let read = exported.logs.iter().map(|log| {
        let one = scenarios
            .iter()
            .find(|one| one.token.to_string() == log.token)
            .unwrap();
        let origin = maps.map(&log.location).unwrap().origin;
        (open(&maps, one).unwrap(), settings.origin.coords - origin)
    });
    read.collect()
}

/// The metrics of a planner on a scenario.
pub(super) fn simulated(
    scenario: &Scenario,
    planner: SimulatedPlanner,
    challenge: Challenge,
) -> Evaluation {
    let evaluated = |planner: &mut dyn Planner| {
        simulate(scenario, planner, challenge)
            .unwrap()
            .evaluate(scenario)
            .unwrap()
    };
    match planner {
        SimulatedPlanner::LogReplay => {
            evaluated(&mut LogReplay::new(scenario.recorded().copied().collect()))
        }
        SimulatedPlanner::Simple => evaluated(&mut SimplePlanner::default()),
        SimulatedPlanner::Idm => evaluated(&mut IdmPlanner::default()),
        SimulatedPlanner::PdmClosed => evaluated(&mut PdmClosed::new()),
    }
}

/// The planner of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SimulatedPlanner {
    LogReplay,
    Simple,
    Idm,
    PdmClosed,
}

/// The compared simulations. An unoptimized build takes minutes for all of them: each type runs one
/// of them in turn.
const SIMULATIONS: [(SimulatedPlanner, Challenge); 6] = [
    (SimulatedPlanner::LogReplay, Challenge::NonReactive),
    (SimulatedPlanner::Idm, Challenge::Reactive),
    (SimulatedPlanner::PdmClosed, Challenge::NonReactive),
    (SimulatedPlanner::LogReplay, Challenge::Reactive),
    (SimulatedPlanner::Idm, Challenge::NonReactive),
    (SimulatedPlanner::PdmClosed, Challenge::Reactive),
];

/// Simulates both and compares every metric: binary ones must be equal, the others within `close`.
pub(super) fn check_scores(
    before: &Scenario,
    after: &Scenario,
    (planner, challenge): (SimulatedPlanner, Challenge),
    close: f64,
) {
    let (a, b) = (
        simulated(before, planner, challenge),
        simulated(after, planner, challenge),
    );
    let (value, value_after) = (a.score.value, b.score.value);
    let simulation = format!("{} {planner:?} {challenge:?}", before.id);
    assert!(
        (value - value_after).abs() <= close,
        "{simulation}: {value} {value_after}"
    );
    for (metric, metric_after) in a.metrics.iter().zip(&b.metrics) {
        let (name, score, score_after) = (&metric.name, metric.score, metric_after.score);
        let same = match (score, score_after) {
            // Scores of 0, 1/2 and 1 come from binary metrics and must be equal.
            (Some(a), Some(b)) if [0.0, 0.5, 1.0].contains(&a) => a.total_cmp(&b).is_eq(),
            (Some(a), Some(b)) => (a - b).abs() <= close,
            (a, b) => a == b,
        };
        assert!(same, "{simulation} {name}: {score:?} {score_after:?}");
    }
}

#[test]
fn every_generated_type_comes_back_with_its_scores() {
    let settings = ExportSettings::default();
    let scenarios: Vec<Scenario> = types::in_suites()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|kind| generated(kind, 3))
        .collect();
    let home = tempfile::tempdir().unwrap();
    let exported = write_scenarios(&scenarios, &home.path().join("out"), &settings).unwrap();
    let read = read_back(&exported, &settings, home.path());
    scenarios
        .par_iter()
        .zip(&read)
        .zip(&exported.logs)
        .enumerate()
        .for_each(|(place, ((before, (after, shift)), log))| {
            let pair = Pair {
                before,
                after,
                shift: *shift,
            };
            assert_eq!(before.scenario_type, after.scenario_type);
            pair.check_map();
            pair.check_frames();
            let names = |scenario: &Scenario| -> Vec<i64> {
                scenario
                    .route
                    .roadblocks
                    .iter()
                    .map(|&block| scenario.map[block].source_id)
                    .collect()
            };
            assert_eq!(names(before), names(after), "{}", before.id);
            let connectors_beside = |lane: &&planagent_world::Lane| lane.is_connector();
            let lost: usize = before
                .map
                .lanes()
                .iter()
                .filter(connectors_beside)
                .map(|l| l.left.len() + l.right.len())
                .sum();
            // Of a type that nuPlan does not map, the log ends with the scenario.
            let dropped = log.changes.dropped_future_states;
            assert!(
                dropped == 0 || dropped == before.future.len(),
                "{}: {dropped}",
                before.id
            );
            let expected = ExportChanges {
                neighbors_changed: lost,
                dropped_future_states: dropped,
                ..ExportChanges::default()
            };
            assert_eq!(log.changes, expected, "{}", before.id);
            for (a, b) in before.frames.iter().zip(&after.frames) {
                let lights = |scenario: &Scenario,
                              frame: &planagent_scenario::Frame|
                 -> Vec<(i64, planagent_world::SignalStatus)> {
                    frame
                        .lights
                        .iter()
                        .map(|(lane, status)| (scenario.map[lane].source_id, status))
                        .collect()
                };
                assert_eq!(lights(before, a), lights(after, b));
            }
            // Log replay and metrics look at the states after the end; an unmapped type loses them.
            assert_eq!(
                after.future.is_empty(),
                before.scenario_type == "traversing_roundabout"
            );
            let kept = if after.future.is_empty() {
                Vec::new()
            } else {
                before.future.clone()
            };
            let before = &Scenario {
                future: kept,
                ..before.clone()
            };
            let own = place % SIMULATIONS.len();
            let simulations = if cfg!(debug_assertions) {
                &SIMULATIONS[own..=own]
            } else {
                &SIMULATIONS[..]
            };
            simulations
                .par_iter()
                .for_each(|&simulation| check_scores(before, after, simulation, SAME_SCORE));
        });
}

#[test]
fn other_zones_and_origins_do_as_well() {
    let scenario = generated(types::starting_left_turn::TYPE, 5);
    for (epsg, origin) in [
        (32_619, Point::new(331_000.5, 4_690_000.25)),
        (32_748, Point::new(365_000.0, 9_300_000.0)),
    ] {
        let settings = ExportSettings {
            location: Some("somewhere".to_owned()),
            epsg,
            origin,
            ..ExportSettings::default()
        };
        let home = tempfile::tempdir().unwrap();
        let exported = write_scenarios(
            std::slice::from_ref(&scenario),
            &home.path().join("out"),
            &settings,
        )
        .unwrap();
        let read = read_back(&exported, &settings, home.path());
        let (after, shift) = &read[0];
        let pair = Pair {
            before: &scenario,
            after,
            shift: *shift,
        };
        pair.check_map();
        pair.check_frames();
        assert!(
            after.map.name().contains(&format!("EPSG:{epsg}")),
            "{}",
            after.map.name()
        );
        assert_eq!(
            (scenario.map.lane_areas(), after.map.lane_areas()),
            (LaneAreas::Derived, LaneAreas::Drawn)
        );
    }
}

#[test]
fn what_was_read_writes_and_reads_again() {
    let settings = ExportSettings::default();
    let first = generated(types::changing_lane::TYPE, 4);
    let home = tempfile::tempdir().unwrap();
    let exported = write_scenarios(
        std::slice::from_ref(&first),
        &home.path().join("one"),
        &settings,
    )
    .unwrap();
    let (second, _) = read_back(&exported, &settings, home.path()).remove(0);
    let exported = write_scenarios(
        std::slice::from_ref(&second),
        &home.path().join("two"),
        &settings,
    )
    .unwrap();
    assert_eq!(
        exported.logs[0].changes,
        ExportChanges::default(),
        "nuPlan can say what it said"
    );
    let (third, shift) = read_back(&exported, &settings, home.path()).remove(0);
    let pair = Pair {
        before: &second,
        after: &third,
        shift,
    };
    pair.check_map();
    pair.check_frames();
    assert_eq!(
        blocks(&second.map, &second.route.roadblocks),
        blocks(&third.map, &third.route.roadblocks)
    );
}
