//! A failed simulation is recorded, and the run continues.

use super::parquet::{aggregator_table, table};
use super::{assert_same_results, simulations};
use crate::cli::{read_json, run};
use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::worker::panic_guard;
use planagent_runs::worker::run::{self as runner, AgentParts, SimulationRecord, SimulationTask};
use planagent_scenario::{ScenarioRef, generator};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use tempfile::TempDir;

fn tasks() -> Vec<SimulationTask> {
    let missing = ScenarioRef::unreadable(
        Path::new("nowhere.tfrecord"),
        "nowhere.tfrecord: cannot open".to_owned(),
    );
    let of = |source: &ScenarioRef, planner| SimulationTask {
        source: source.clone(),
        planner,
        challenge: Challenge::NonReactive,
    };
    let scene = ScenarioRef::from(generator::DEFAULT);
    vec![
        of(&missing, PlannerName::new("simple")),
        of(&scene, PlannerName::PLAN_AGENT),
        of(&scene, PlannerName::new("simple")),
    ]
}

/// All records of a run of [`tasks`], by number.
fn records(on_iteration: &(dyn Fn() + Sync)) -> BTreeMap<usize, SimulationRecord> {
    let records = Mutex::new(BTreeMap::new());
    let outcome: Result<(), ()> = runner::run(
        &tasks(),
        &[0, 1, 2],
        &AgentParts::default(),
        &|_| on_iteration(),
        &|number, record| {
            assert!(records.lock().unwrap().insert(number, record).is_none());
            Ok(())
        },
    );
    outcome.unwrap();
    records.into_inner().unwrap()
}

#[test]
fn an_error_is_recorded_and_the_run_continues() {
    let records = records(&|| ());
    let error = |number: usize| records[&number].outcome.as_ref().unwrap_err().clone();
    assert!(error(0).contains("nowhere.tfrecord"), "{}", error(0));
    assert!(error(1).contains("needs a model"), "{}", error(1));
    let outcome = records[&2].outcome.as_ref().unwrap();
    assert_eq!(records[&2].scenario, generator::DEFAULT.to_string());
    assert!(outcome.metrics.len() > 8 && outcome.log.runtimes_s.len() == outcome.log.samples.len());
}

#[test]
fn a_panic_is_recorded_with_its_place_and_the_run_continues() {
    panic_guard::install_hook();
    let records = records(&|| panic!("a wheel came off"));
    let error = records[&2].outcome.as_ref().unwrap_err();
    assert!(
        error.contains("a wheel came off") && error.contains("failures.rs"),
        "{error}"
    );
    assert_eq!(records.len(), 3);
}

#[test]
fn no_simulation_starts_after_a_record_that_cannot_be_written() {
    let outcome = runner::run(
        &tasks(),
        &[0, 1, 2],
        &AgentParts::default(),
        &|_| (),
        &|number, _| Err(format!("disk full at {number}")),
    );
    assert!(outcome.unwrap_err().starts_with("disk full at"));
}

/// Marks a simulation as failed in its record.
fn mark_failed(folder: &Path) {
    let record = folder.join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    let lines = text.lines().map(|line| {
        if line.starts_with("score = ") {
            "error = \"a wheel came off\""
        } else {
            line
        }
    });
    let header: Vec<&str> = lines.take_while(|line| *line != "[[metrics]]").collect();
    fs::write(&record, header.join("\n")).unwrap();
}

#[test]
fn failed_simulations_are_listed_and_repeated_only_on_demand() {
    let work = TempDir::new().unwrap();
    let [whole, mended] = ["whole", "mended"].map(|name| work.path().join(name));
    for out in [&whole, &mended] {
        let flags = [
            "simulate",
            "--split",
            "generated",
            "--limit",
            "2",
            "--planner",
            "simple",
            "--quiet",
        ];
        assert_eq!(
            run(&[&flags[..], &["--out", out.to_str().unwrap()]].concat()).0,
            0
        );
    }
    mark_failed(&simulations(&mended)[1]);

    let resume = ["simulate", "--resume", mended.to_str().unwrap()];
    let (code, stdout, stderr) = run(&resume);
    assert_eq!(code, 1, "{stderr}");
    assert!(
        stderr.contains("a wheel came off") && stderr.contains("1 of 2 simulations failed"),
        "{stderr}"
    );
    assert!(
        stdout
            .lines()
            .any(|line| line.starts_with("simple") && line.ends_with('1')),
        "{stdout}"
    );
    let summary = read_json(&mended.join("summary.json"));
    assert_eq!(summary["scenarios"][1]["error"], "a wheel came off");
    assert_eq!(summary["scenarios"][1]["succeeded"], false);
    assert_eq!(summary["aggregates"][0]["failed"], 1);
    assert_eq!(
        summary["aggregates"][0]["score"], summary["scenarios"][0]["score"],
        "a failed simulation does not count"
    );

    let (code, _, stderr) = run(&[&resume[..], &["--retry-failed"]].concat());
    assert_eq!(code, 0, "{stderr}");
    assert_same_results(&whole, &mended);
}

#[test]
fn results_of_a_run_in_which_all_failed_can_be_read() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "--split",
        "generated",
        "--limit",
        "2",
        "--planner",
        "simple",
        "--challenge",
        "both",
    ];
    assert_eq!(
        run(&[&flags[..], &["--quiet", "--out", out.to_str().unwrap()]].concat()).0,
        0
    );
    for folder in simulations(&out) {
        mark_failed(&folder);
    }
    let (code, stdout, stderr) = run(&["simulate", "--resume", out.to_str().unwrap()]);
    assert_eq!(code, 1, "{stderr}");
    assert!(
        stdout
            .lines()
            .any(|line| line.starts_with("simple") && line.ends_with('4')),
        "{stdout}"
    );
    assert!(!stdout.contains("coll ="), "a legend of nothing: {stdout}");
    for challenge in Challenge::CLOSED_LOOP {
        let (columns, rows) = aggregator_table(&out, &challenge.to_string());
        assert_eq!(rows, 0);
        let expected = [
            "scenario",
            "log_name",
            "scenario_type",
            "num_scenarios",
            "planner_name",
            "aggregator_type",
            "drivable_area_compliance",
            "driving_direction_compliance",
            "ego_is_comfortable",
            "ego_is_making_progress",
            "ego_progress_along_expert_route",
            "no_ego_at_fault_collisions",
            "speed_limit_compliance",
            "time_to_collision_within_bound",
            "score",
        ];
        assert_eq!(columns, expected);
        let report = out
            .join(challenge.to_string())
            .join("runner_report.parquet");
        assert_eq!(table(&report).1, 2);
    }
}
