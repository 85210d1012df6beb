//! Speedup by a second core: the same simulations on one thread and on two, several times in turn.
//! Prints the wall times and the median of their ratio. `cargo bench --bench cores`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark is no interface and may stop at an error"
)]

use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::worker::run::{AgentParts, SimulationTask, run};
use planagent_scenario::ScenarioRef;
use planagent_scenario::generator::{Spec, types};
use std::time::Instant;

/// Pairs of runs.
const ROUNDS: usize = 9;
/// Seeds of every scenario type.
const SEEDS: u64 = 2;

/// Every scenario type with IDM and PDM-Closed in both challenges.
fn tasks() -> Vec<SimulationTask> {
    let scenes = types::in_suites()
        .flat_map(|scenario_type| (0..SEEDS).map(move |seed| Spec::new(scenario_type, seed)));
    scenes
        .flat_map(|spec| {
            [PlannerName::new("idm"), PlannerName::PDM_CLOSED]
                .into_iter()
                .flat_map(move |planner| {
                    let source = ScenarioRef::from(spec);
                    Challenge::CLOSED_LOOP.map(|challenge| SimulationTask {
                        source: source.clone(),
                        planner,
                        challenge,
                    })
                })
        })
        .collect()
}

/// Wall time of all simulations with this many threads, seconds.
fn seconds(tasks: &[SimulationTask], threads: usize) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    let todo: Vec<usize> = (0..tasks.len()).collect();
    let started = Instant::now();
    pool.install(|| {
        run(
            tasks,
            &todo,
            &AgentParts::default(),
            &|_| (),
            &|_, record| record.outcome.map(|_| ()),
        )
        .unwrap();
    });
    started.elapsed().as_secs_f64()
}

fn main() {
    let tasks = tasks();
    seconds(&tasks, 2);
    let mut ratios: Vec<f64> = (0..ROUNDS)
        .map(|round| {
            let (one, two) = (seconds(&tasks, 1), seconds(&tasks, 2));
            println!(
                "round {round}: {} simulations, one thread {one:.3} s, two threads {two:.3} s, ratio {:.3}",
                tasks.len(),
                one / two
            );
            one / two
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    println!("median ratio {:.3}", ratios[ROUNDS / 2]);
}
