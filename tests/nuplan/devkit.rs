//! The values of nuplan-devkit and `tuplan_garage` on scenarios that we export. `tests/devkit` runs
//! both programs; docs/devkit.md says how far they agree.

use super::round_trip::{SimulatedPlanner, generated, read_back, simulated};
use crate::outside::{Missing, Needy};
use planagent_agent::simulation::Challenge;
use planagent_scenario::Scenario;
use planagent_scenario::generator::types;
use planagent_scenario::nuplan::export::{ExportSettings, write_scenarios};
use planagent_score::metrics::{Evaluation, MetricResult};
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Values that differ by no more are the same number in another order of operations.
const SAME: f64 = 1e-6;
/// The largest difference of a value. The tracker's state may differ by so much: it is a filter of
/// the poses.
const CLOSE: f64 = 1e-3;
/// Share of the values that agree: within [`SAME`], those of the tracker's state within [`CLOSE`].
const REACH: f64 = 0.99;
/// Of a score of 1.
const SAME_SCORE: f64 = 1e-4;

/// `tests/devkit/make_values.py` writes it: numbers of the devkit's own runs.
#[derive(Debug, Deserialize)]
struct Values {
    /// Metrics, and statistics as METRIC/STATISTIC: the columns of every simulation.
    columns: Vec<String>,
    simulations: Vec<DevkitSimulation>,
}

#[derive(Debug, Deserialize)]
struct DevkitSimulation {
    /// TYPE/SEED of the generator.
    scenario: String,
    planner: String,
    challenge: String,
    score: f64,
    values: Vec<Option<Value>>,
}

/// JSON has no infinite numbers: `"inf"` is one, such as a time to collision without one.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
enum Value {
    Finite(f64),
    Named(String),
}

impl Value {
    fn number(&self) -> f64 {
        match self {
            Self::Finite(value) => *value,
            Self::Named(name) => name.parse().unwrap(),
        }
    }
}

fn devkit_values() -> Values {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/fixtures/devkit/values.json"
    );
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn planner(name: &str) -> SimulatedPlanner {
    match name {
        "log-replay" => SimulatedPlanner::LogReplay,
        "simple" => SimulatedPlanner::Simple,
        "idm" => SimulatedPlanner::Idm,
        "pdm-closed" => SimulatedPlanner::PdmClosed,
        other => panic!("no planner {other}"),
    }
}

fn challenge(name: &str) -> Challenge {
    match name {
        "nonreactive" => Challenge::NonReactive,
        "reactive" => Challenge::Reactive,
        other => panic!("no challenge {other}"),
    }
}

/// Our values by column.
fn columns(metrics: &[MetricResult]) -> BTreeMap<String, f64> {
    let scores = metrics
        .iter()
        .filter_map(|metric| Some((metric.name.clone(), metric.score?)));
    let statistics = metrics.iter().flat_map(|metric| {
        metric
            .statistics
            .iter()
            .map(|one| (format!("{}/{}", metric.name, one.name), one.value))
    });
    scores.chain(statistics).collect()
}

/// Whether a column names the state that the devkit's tracker derives from poses: accelerations,
/// jerks, yaw rates, comfort.
fn of_tracker(column: &str) -> bool {
    let metric = column.split('/').next().unwrap_or_default();
    ["acceleration", "jerk", "yaw_rate", "is_comfortable"]
        .iter()
        .any(|end| metric.ends_with(end))
}

/// What differs in a simulation.
#[derive(Debug, Default)]
struct Differences {
    /// Number of the devkit's values.
    values: usize,
    /// Number of those that do not agree.
    apart: usize,
    /// Values that differ by more than [`CLOSE`], and the score.
    wrong: Vec<String>,
}

impl Differences {
    fn from_simulation(simulation: &DevkitSimulation, names: &[String], ours: &Evaluation) -> Self {
        let own = columns(&ours.metrics);
        let mut found = Self::default();
        for (name, theirs) in names.iter().zip(&simulation.values) {
            let (theirs, value) = (theirs.as_ref().map(Value::number), own.get(name).copied());
            let distance = match (theirs, value) {
                (None, None) => continue,
                (Some(a), Some(b)) if a.total_cmp(&b).is_eq() => 0.0,
                (Some(a), Some(b)) => (a - b).abs(),
                _ => f64::INFINITY,
            };
            found.values += 1;
            found.apart += usize::from(distance > if of_tracker(name) { CLOSE } else { SAME });
            if distance > CLOSE {
                found
                    .wrong
                    .push(format!("{name}: devkit {theirs:?}, ours {value:?}"));
            }
        }
        if (simulation.score - ours.score.value).abs() > SAME_SCORE {
            found.wrong.push(format!(
                "score: devkit {}, ours {}",
                simulation.score, ours.score.value
            ));
        }
        found
    }
}

#[test]
fn our_values_are_those_of_the_devkit() {
    let Values {
        columns,
        simulations,
    } = devkit_values();
    assert!(simulations.len() >= 64, "{} simulations", simulations.len());
    let names: BTreeSet<&str> = simulations
        .iter()
        .map(|one| one.scenario.as_str())
        .collect();
    let scenarios: Vec<Scenario> = names
        .par_iter()
        .map(|name| {
            let (kind, seed) = name.split_once('/').unwrap();
            generated(types::named(kind).unwrap(), seed.parse().unwrap())
        })
        .collect();
    let home = tempfile::tempdir().unwrap();
    let settings = ExportSettings::default();
    let exported = write_scenarios(&scenarios, &home.path().join("out"), &settings).unwrap();
    let read = read_back(&exported, &settings, home.path());
    let by_name: BTreeMap<&str, &Scenario> = names
        .into_iter()
        .zip(read.iter().map(|(scenario, _)| scenario))
        .collect();
    let found: Vec<(String, Differences)> = simulations
        .par_iter()
        .map(|one| {
            let ours = simulated(
                by_name[one.scenario.as_str()],
                planner(&one.planner),
                challenge(&one.challenge),
            );
            let place = format!("{} {} {}", one.scenario, one.planner, one.challenge);
            (place, Differences::from_simulation(one, &columns, &ours))
        })
        .collect();
    let wrong = found
        .iter()
        .flat_map(|(place, one)| one.wrong.iter().map(move |what| format!("{place}: {what}")));
    assert_eq!(wrong.collect::<Vec<_>>(), Vec::<String>::new());
    let (values, apart) = found
        .iter()
        .fold((0, 0), |(v, a), (_, one)| (v + one.values, a + one.apart));
    let which: Vec<&String> = found
        .iter()
        .filter(|(_, one)| one.apart > 0)
        .map(|(place, _)| place)
        .collect();
    assert!(
        values > 4000 && (apart as f64) < (1.0 - REACH) * values as f64,
        "{apart} of {values} differ: {which:?}"
    );
}

#[test]
fn a_changed_value_is_found() {
    let Values {
        columns,
        mut simulations,
    } = devkit_values();
    let one = simulations
        .iter_mut()
        .find(|one| one.planner == "simple")
        .unwrap();
    let (kind, seed) = one.scenario.split_once('/').unwrap();
    let scenario = generated(types::named(kind).unwrap(), seed.parse().unwrap());
    let home = tempfile::tempdir().unwrap();
    let settings = ExportSettings::default();
    let exported = write_scenarios(&[scenario], &home.path().join("out"), &settings).unwrap();
    let (read, _) = read_back(&exported, &settings, home.path()).remove(0);
    let ours = simulated(&read, SimulatedPlanner::Simple, challenge(&one.challenge));
    let before = Differences::from_simulation(one, &columns, &ours);
    let place = columns
        .iter()
        .position(|name| name == "ego_mean_speed/ego_mean_speed_value")
        .unwrap();
    let speed = one.values[place].as_ref().unwrap().number();
    one.values[place] = Some(Value::Finite(speed + 2e-6));
    let after = Differences::from_simulation(one, &columns, &ours);
    assert_eq!(
        (after.apart, after.wrong.len(), before.wrong.len()),
        (before.apart + 1, 0, 0),
        "{before:?} {after:?}"
    );
    one.values[place] = None;
    one.score += 2e-4;
    let wrong = Differences::from_simulation(one, &columns, &ours).wrong;
    assert!(
        wrong.len() == 2 && wrong[0].starts_with("ego_mean_speed") && wrong[1].starts_with("score"),
        "{wrong:?}"
    );
}

/// `PLANAGENT_DEVKIT` names a clone of nuplan-devkit; `PLANAGENT_PYTHON` an interpreter that
/// imports it.
#[test]
fn the_devkit_runs_an_export_and_agrees() -> Needy {
    let devkit = crate::outside::devkit()?;
    let python = crate::outside::python(&[])?;
    let imported = Command::new(&python)
        .args(["-c", "import nuplan.planning"])
        .env("PYTHONPATH", &devkit)
        .output();
    if !imported.is_ok_and(|output| output.status.success()) {
        return Err(Missing(format!(
            "needs packages of nuplan-devkit; {python} cannot import nuplan from {}",
            devkit.display()
        )));
    }
    let home = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/devkit/compare.py");
    let output = Command::new(&python)
        .arg(script)
        .args([
            "--program",
            env!("CARGO_BIN_EXE_planagent"),
            "--challenge",
            "reactive",
            "--planner",
            "simple",
        ])
        .args(["--scenarios", "generated/stationary_in_traffic/3"])
        .arg("--devkit")
        .arg(&devkit)
        .arg("--out")
        .arg(home.path().join("out"))
        .output()
        .unwrap();
    let (said, wrong) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(
        output.status.success() && said.contains("reached: 100.000 %"),
        "{said}{wrong}"
    );
    Ok(())
}
