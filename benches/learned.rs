//! The networks of learned planners beside PyTorch on the same weights and inputs, in the published
//! shapes with random parameters.
//!
//! `PLANAGENT_PYTHON=… cargo bench --bench learned` prints the Markdown table of `docs/learned.md`
//! (about a minute on two cores); the interpreter needs torch and safetensors. Both sides use two
//! threads, one after the other, planner by planner.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a benchmark is no interface and may stop at an error"
)]

#[path = "../tests/learned/exported.rs"]
mod exported;

use exported::{Exported, PLANNERS, Run, Shape, network};
use mimalloc::MiMalloc;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// The program's.
#[global_allocator]
static GLOBAL: MiMalloc = MiMalloc;

/// Runs of a network: at least so many, and for so long.
const LEAST: usize = 5;
const TIME: Duration = Duration::from_secs(2);
/// Largest accepted deviation of an output, absolute and relative.
const MAX_DEVIATION: f32 = 1e-3;

fn main() {
    let folder =
        std::env::temp_dir().join(format!("planagent-bench-learned-{}", std::process::id()));
    let python = std::env::var_os("PLANAGENT_PYTHON").unwrap_or_else(|| "python3".into());
    let train = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/learned/train");
    let output = Command::new(python)
        .env("PYTHONPATH", train)
        .args(["-m", "imitation", "speed", "--out"])
        .arg(&folder)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let theirs: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    println!(
        "PyTorch {}, {} threads\n",
        theirs["torch"].as_str().unwrap(),
        theirs["threads"]
    );
    println!(
        "| network | parameters | here, ms | PyTorch, ms | times as fast |\n|---|---|---|---|---|"
    );
    for planner in PLANNERS {
        let file = |kind: &str| folder.join(format!("{planner}{kind}.safetensors"));
        let io = Exported::open(&file(".io"));
        let run = network(planner, &file(""), &io, Shape::Published);
        check(planner, &io, &run);
        // As in the program, on a thread of the pool: from outside, every product would wake one.
        let here = rayon::scope(|_| median(&run));
        let about = &theirs["planners"][planner];
        let there = about["ms"].as_f64().unwrap();
        println!(
            "| {planner} | {} | {here:.2} | {there:.2} | {:.2} |",
            about["parameters"],
            there / here
        );
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// Stops where an output is another one than PyTorch's.
fn check(planner: &str, io: &Exported, run: &Run) {
    let found = run();
    // The scores of unused branches are -inf.
    let numbers = |tensor: &candle_core::Tensor| {
        let values = tensor.maximum(-1e9f64).unwrap();
        values.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    };
    for (name, expected) in io.outputs() {
        let (_, found) = found.iter().find(|(own, _)| own == name).unwrap();
        for (found, expected) in numbers(found).into_iter().zip(numbers(expected)) {
            let off = (found - expected).abs() / (1.0 + expected.abs());
            assert!(
                off < MAX_DEVIATION,
                "{planner} {name}: {found} instead of {expected}"
            );
        }
    }
}

/// Median time, milliseconds.
fn median(run: &Run) -> f64 {
    let (mut times, begun) = (Vec::new(), Instant::now());
    while times.len() < LEAST || begun.elapsed() < TIME {
        let started = Instant::now();
        std::hint::black_box(run());
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
