//! The scenario that commands take where none is named. A first look must not flatter: the model that
//! ships is clearly better there than what does not read the scene.

use crate::cli::{planagent, read_json};
use half::f16;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use safetensors::SafeTensors;
use safetensors::tensor::{TensorView, serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Seeds of the runs and of the random weights.
const SEEDS: [u64; 3] = [0, 1, 2];
/// Draws of random weights for each seed. Two draws in fifteen drive this scene well by chance, so
/// their median counts (docs/decisions/127-default-scene.md).
const DRAWS: u64 = 5;
/// How much better the model is, in points of 100.
const MARGIN: f64 = 2.0;
/// Planning calls that the default takes at most, so that it takes at most 5 s.
const MAX_CALLS: u64 = 12;

/// Scores x 100 of the default scenario by planner, and the planning calls of `plan-agent`.
fn simulated(out: &Path, seed: u64, flags: &[&str]) -> (BTreeMap<String, f64>, u64) {
    let seed = seed.to_string();
    let output = planagent()
        .args(["simulate", "--seed", &seed, "--quiet", "--out"])
        .arg(out)
        .args(flags)
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    let summary = read_json(&out.join("summary.json"));
    let rows = summary["scenarios"].as_array().unwrap();
    let of = |row: &serde_json::Value| {
        let planner = row["planner"].as_str().unwrap().to_owned();
        (planner, 100.0 * row["score"].as_f64().unwrap())
    };
    let calls = rows
        .iter()
        .filter(|row| row["planner"] == "plan-agent")
        .map(|row| row["planning_calls"].as_u64().unwrap())
        .sum();
    (rows.iter().map(of).collect(), calls)
}

/// The model that ships with random weights: matrices keep the variance of what they multiply, norms
/// do nothing, and biases are 0.
fn with_random_weights(folder: &Path, seed: u64) {
    let nano = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/nano");
    fs::create_dir(folder).unwrap();
    for entry in fs::read_dir(&nano).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        if name.to_string_lossy().ends_with(".json") || name == "chat_template.jinja" {
            fs::copy(&path, folder.join(name)).unwrap();
        }
    }
    let bytes = fs::read(nano.join("model.safetensors")).unwrap();
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut values: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    // Sorted, so that a seed draws the same weights in each process: the reader's order is that of a hash map.
    let sorted: BTreeMap<_, _> = tensors.tensors().into_iter().collect();
    for (name, tensor) in sorted {
        let shape = tensor.shape().to_vec();
        let inputs: usize = shape.iter().skip(1).product();
        let range = (3.0 / inputs as f32).sqrt();
        let is_norm = name.contains("norm") && name.ends_with("weight");
        let is_bias = name.ends_with("bias");
        let mut value = || match (is_norm, is_bias) {
            (true, _) => 1.0,
            (_, true) => 0.0,
            _ => random.random_range(-range..range),
        };
        let count: usize = shape.iter().product();
        let data = (0..count).flat_map(|_| f16::from_f32(value()).to_le_bytes());
        values.push((name, shape, data.collect()));
    }
    let views = values.iter().map(|(name, shape, data)| {
        let view = TensorView::new(safetensors::Dtype::F16, shape.clone(), data).unwrap();
        (name.as_str(), view)
    });
    let file = serialize(views, None).unwrap();
    fs::write(folder.join("model.safetensors"), file).unwrap();
}

#[test]
fn the_model_that_ships_is_first_by_two_points_for_three_seeds() {
    let work = TempDir::new().unwrap();
    for seed in SEEDS {
        let own = work.path().join(format!("own-{seed}"));
        let planners = ["--planner", "plan-agent,random-code,fixed-code"];
        let (mut scores, calls) = simulated(&own, seed, &planners);
        assert!(calls <= MAX_CALLS, "{calls} planning calls");
        let nano = scores.remove("plan-agent").unwrap();
        let draws = (seed * DRAWS..(seed + 1) * DRAWS).map(|draw| {
            let model = work.path().join(format!("random-{draw}"));
            with_random_weights(&model, draw);
            let out = work.path().join(format!("other-{draw}"));
            simulated(&out, seed, &["--model", model.to_str().unwrap()]).0["plan-agent"]
        });
        let mut draws: Vec<f64> = draws.collect();
        draws.sort_by(f64::total_cmp);
        println!("random weights: {draws:.1?}");
        scores.insert("random weights".to_owned(), draws[draws.len() / 2]);
        assert_eq!(scores.len(), 3);
        for (name, score) in scores {
            assert!(
                nano >= score + MARGIN,
                "seed {seed}: the model has {nano:.2}, {name} {score:.2}"
            );
        }
    }
}
