//! Some simulations whose scores and planner codes are pinned: they guard `RESULT_VERSION`.

use planagent::planning::all_planners;
use planagent_agent::planner::PlanAgentSettings;
use planagent_agent::simulation::Challenge;
use planagent_runs::runner::{Config, RESULT_VERSION, load_model, silent};
use planagent_runs::worker::run::{SimulationTask, run};
use planagent_scenario::ScenarioRef;
use planagent_scenario::generator::Spec;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;
use std::sync::Mutex;

/// The scenes; every planner that needs no checkpoint simulates each with non-reactive and with
/// reactive agents.
const SCENES: [&str; 2] = [
    "generated/changing_lane/3",
    "generated/stopping_with_lead/1",
];
/// Tokens of the context of nano.
const NANO_CONTEXT: usize = 1024;
/// The pinned results.
const PINNED: &str = "tests/fixtures/pinned_results.toml";
/// Environment variable that writes them again.
const UPDATE: &str = "PLANAGENT_UPDATE_GOLDEN";

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Pinned {
    result_version: u32,
    simulations: Vec<Simulation>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Simulation {
    task: String,
    score: f64,
    /// BLAKE3 of the planner codes of all attempts, a line each.
    codes: String,
}

fn tasks() -> Vec<SimulationTask> {
    let of_scene = |scene: &str| {
        let source = ScenarioRef::from(scene.parse::<Spec>().unwrap());
        let of_planner = move |planner| {
            let source = source.clone();
            Challenge::CLOSED_LOOP.map(|challenge| SimulationTask {
                source: source.clone(),
                planner,
                challenge,
            })
        };
        let settings = PlanAgentSettings::default();
        let mut entries = all_planners().entries().to_vec();
        // Learned planners need a checkpoint of somebody; prompts of some agents are longer than the
        // context of the model that ships; `oracle-end` tries the codes of `oracle-grid` for longer
        // than a test may take.
        entries.retain(|entry| {
            entry.prepare(&settings).is_ok()
                && entry.least_context() <= NANO_CONTEXT
                && entry.name.as_str() != "oracle-end"
        });
        entries
            .into_iter()
            .map(|entry| entry.name)
            .flat_map(of_planner)
    };
    SCENES.into_iter().flat_map(of_scene).collect()
}

fn simulate() -> Vec<Simulation> {
    let mut config = Config::default();
    concat!(env!("CARGO_MANIFEST_DIR"), "/models/nano.toml").clone_into(&mut config.mllm.model);
    let loaded = load_model(&config, &silent()).unwrap();
    let agent = loaded.agent_parts(&config, &silent()).unwrap();
    let (tasks, done) = (tasks(), Mutex::new(Vec::new()));
    let numbers: Vec<usize> = (0..tasks.len()).collect();
    let outcome: Result<(), String> = run(&tasks, &numbers, &agent, &|_| (), &|number, record| {
        let outcome = record.outcome?;
        let mut codes = blake3::Hasher::new();
        for attempt in outcome.calls.iter().flat_map(|call| &call.attempts) {
            let code = attempt.line().unwrap_or_default();
            codes.update(code.as_bytes()).update(b"\n");
        }
        let codes = codes.finalize().to_hex().to_string();
        let (task, score) = (tasks[number].to_string(), outcome.score.value);
        done.lock()
            .unwrap()
            .push((number, Simulation { task, score, codes }));
        Ok(())
    });
    outcome.unwrap();
    let mut simulations = done.into_inner().unwrap();
    simulations.sort_by_key(|(number, _)| *number);
    simulations
        .into_iter()
        .map(|(_, simulation)| simulation)
        .collect()
}

#[test]
fn results_change_only_with_their_version() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(PINNED);
    let now = Pinned {
        result_version: RESULT_VERSION,
        simulations: simulate(),
    };
    if std::env::var_os(UPDATE).is_some() {
        fs::write(&path, toml::to_string(&now).unwrap()).unwrap();
    }
    let pinned: Pinned = toml::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let differing: Vec<_> = pinned
        .simulations
        .iter()
        .zip(&now.simulations)
        .filter(|(then, now)| then != now)
        .collect();
    assert!(
        differing.is_empty() && pinned.simulations.len() == now.simulations.len(),
        "results changed: {differing:#?}\n\
         If the change is meant, raise RESULT_VERSION in src/runs/runner/result_version.rs and pin again by {UPDATE}=1.",
    );
    assert_eq!(
        pinned.result_version, RESULT_VERSION,
        "RESULT_VERSION was changed; pin the results again by {UPDATE}=1"
    );
}
