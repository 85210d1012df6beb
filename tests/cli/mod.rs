//! The program as its user runs it: output, exit codes, files.

mod advice;
mod agents;
mod ask;
mod card;
#[cfg(unix)]
mod children;
mod code;
mod columns;
mod errors;
mod exec;
mod help;
#[cfg(unix)]
mod interrupt;
#[cfg(unix)]
mod memory;
mod modified;
mod open_loop;
mod outside_text;
mod prompts;
mod results;
mod scenarios;
mod settings;
mod shards;
#[cfg(unix)]
mod streams;
mod teach;
mod wild;

use crate::agent::scenario;
use crate::outside::{Needy, data};
use crate::womd::written;
use assert_cmd::Command;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A generated scene that every planner completes in a second or two.
const SCENE: &str = "generated/changing_lane/3";

pub(crate) fn planagent() -> Command {
    let mut command = Command::cargo_bin("planagent").unwrap();
    // The package's models and configuration, whatever the working directory.
    command
        .env(
            "PLANAGENT_MODELS",
            concat!(env!("CARGO_MANIFEST_DIR"), "/models"),
        )
        .env("NO_COLOR", "1");
    command.env_remove("CARGO_MANIFEST_DIR").env(
        "PLANAGENT_CACHE",
        concat!(env!("CARGO_TARGET_TMPDIR"), "/cache"),
    );
    command
}

/// Runs and gives exit code, stdout and stderr.
pub(crate) fn run(arguments: &[&str]) -> (i32, String, String) {
    let output = planagent().args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code().expect("no exit code"),
        text(output.stdout),
        text(output.stderr),
    )
}

/// Runs what must fail as bad input: exit code 2, nothing on stdout, no panic; gives stderr.
pub(crate) fn refused(arguments: &[&str]) -> String {
    let (code, stdout, stderr) = run(arguments);
    assert_eq!(code, 2, "{arguments:?}: {stderr}");
    assert!(stdout.is_empty(), "{stdout}");
    assert!(
        stderr.contains("error:") && !stderr.contains("panicked"),
        "{stderr}"
    );
    stderr
}

pub(crate) fn read_json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn simulated(out: &Path, threads: &str) -> Vec<u8> {
    let out = out.to_str().unwrap();
    let arguments = [
        "simulate",
        "--scenario",
        SCENE,
        "generated/stopping_with_lead/1",
        "--challenge",
        "both",
    ];
    let (code, _, stderr) = run(&[
        &arguments[..],
        &[
            "--planner",
            "plan-agent,idm",
            "--threads",
            threads,
            "--out",
            out,
        ],
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    fs::read(Path::new(out).join("summary.json")).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bytes_at_any_thread_count() {
    let folder = TempDir::new().unwrap();
    let one = simulated(&folder.path().join("one"), "1");
    let two = simulated(&folder.path().join("two"), "2");
    assert!(
        one == two,
        "{}\n{}",
        String::from_utf8_lossy(&one),
        String::from_utf8_lossy(&two)
    );
    let calls = |run: &str| {
        let text = fs::read_to_string(folder.path().join(run).join("calls.jsonl")).unwrap();
        let lines = text
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines
            .map(|mut call| {
                call.as_object_mut()
                    .unwrap()
                    .remove("time")
                    .map(|_| call)
                    .unwrap()
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(calls("one"), calls("two"));
    let [one, two] = ["one", "two"].map(|run| parquet_values(&folder.path().join(run)));
    assert!(one.len() > 30, "only {} Parquet files", one.len());
    let differing: Vec<&String> = one
        .keys()
        .filter(|name| one.get(*name) != two.get(*name))
        .collect();
    assert!(
        differing.is_empty() && one.len() == two.len(),
        "these differ: {differing:?}"
    );
}

/// The bytes of every Parquet file but the measured ones, by name; the stamp of the start is cut
/// out.
fn parquet_values(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for challenge in [
        "closed_loop_nonreactive_agents",
        "closed_loop_reactive_agents",
    ] {
        for folder in ["metrics", "aggregator_metric"] {
            for entry in fs::read_dir(run.join(challenge).join(folder)).unwrap() {
                let path = entry.unwrap().path();
                let name = path
                    .file_name()
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .split("_metrics_")
                    .next()
                    .unwrap();
                found.insert(
                    format!("{challenge}/{folder}/{name}"),
                    fs::read(&path).unwrap(),
                );
            }
        }
    }
    found
}

#[test]
fn a_run_leaves_what_the_readme_says() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("run");
    let (code, stdout, stderr) = run(&[
        "simulate",
        "--scenario",
        SCENE,
        "--set",
        "agent.blocked_interval_s=2.0",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.contains("plan-agent") && stdout.contains("no_ego_at_fault_collisions"),
        "{stdout}"
    );
    assert!(
        stdout.contains("ms/step  ms/call p50  simulations"),
        "{stdout}"
    );
    assert!(
        stdout.lines().all(|line| line.chars().count() <= 80),
        "wider than 80 columns:\n{stdout}"
    );

    let summary = read_json(&out.join("summary.json"));
    let row = &summary["scenarios"][0];
    assert_eq!(row["id"], SCENE);
    assert_eq!(row["scenario_type"], "changing_lane");
    assert_eq!(row["challenge"], "closed_loop_nonreactive_agents");
    let product: f64 = [
        "no_ego_at_fault_collisions",
        "drivable_area_compliance",
        "ego_is_making_progress",
        "driving_direction_compliance",
    ]
    .iter()
    .map(|name| row[*name].as_f64().unwrap())
    .product();
    let weights = [
        ("ego_progress_along_expert_route", 5.0),
        ("time_to_collision_within_bound", 5.0),
        ("speed_limit_compliance", 4.0),
        ("ego_is_comfortable", 2.0),
    ];
    let mean: f64 = weights
        .iter()
        .map(|(name, weight)| row[*name].as_f64().unwrap() * weight)
        .sum::<f64>()
        / 16.0;
    assert!((row["score"].as_f64().unwrap() - product * mean).abs() < 1e-12);

    // 15 s at 10 Hz with a call every 20 iterations, the first at iteration 0.
    let calls: Vec<Value> = fs::read_to_string(out.join("calls.jsonl"))
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(calls.len(), 8);
    assert_eq!(row["planning_calls"], 8);
    for (i, call) in calls.iter().enumerate() {
        assert_eq!(call["iteration"], 20 * i);
        let attempt = &call["attempts"][0];
        let rounds: Vec<&str> = attempt["rounds"]
            .as_array()
            .unwrap()
            .iter()
            .map(|round| round["round"].as_str().unwrap())
            .collect();
        assert_eq!(rounds, ["understanding", "instruction", "code"]);
        let first = &attempt["rounds"][0]["tokens"];
        assert!(
            first["image"].as_u64().unwrap() > 0 && first["cached"].as_u64().unwrap() > 0,
            "{first}"
        );
        assert_eq!(attempt["rounds"][1]["tokens"]["image"], 0);
        assert!(attempt["reflection"]["score"].as_f64().is_some());
        assert!(call["time"]["call"]["total"].as_f64().unwrap() > 0.0);
    }
    let simulation =
        out.join("simulations/000000-generated_changing_lane_3-plan-agent-nonreactive");
    let transcript = fs::read_to_string(simulation.join("transcript.md")).unwrap();
    assert!(
        transcript.contains("Generate_IDM_Planner(") && transcript.contains("bev/020.png"),
        "{transcript}"
    );
    assert!(image::open(simulation.join("bev/020.png")).unwrap().width() > 16);
    let timing = read_json(&out.join("timing.json"));
    assert!(timing["planning_call_ms"]["total"]["p50"].as_f64().unwrap() > 0.0);
    let agent = &timing["planners"][0];
    assert_eq!(
        (&agent["planning_calls"], &agent["iterations"]),
        (&8.into(), &150.into())
    );
    let [mean, call] = [
        &agent["mean_iteration_ms"],
        &agent["planning_call_ms"]["p50"],
    ]
    .map(Value::as_f64);
    assert!(mean > Some(0.0) && mean < call, "{agent}");
    let config = fs::read_to_string(out.join("config.toml")).unwrap();
    assert!(config.contains("threshold = 0.75"), "{config}");

    let again = refused(&[
        "simulate",
        "--scenario",
        SCENE,
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(
        again.contains("holds a run") && again.contains("--resume"),
        "{again}"
    );
    let foreign = folder.path().join("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("notes.txt"), "mine").unwrap();
    let full = refused(&[
        "simulate",
        "--scenario",
        SCENE,
        "--out",
        foreign.to_str().unwrap(),
    ]);
    assert!(full.contains("not empty"), "{full}");
}

#[test]
fn plan_makes_one_call_for_people_and_for_programs() {
    let folder = TempDir::new().unwrap();
    let image = folder.path().join("bev.png");
    let arguments = [
        "plan",
        "--scenario",
        SCENE,
        "--at",
        "3.0",
        "--image",
        image.to_str().unwrap(),
    ];
    let (code, stdout, stderr) = run(&arguments);
    assert_eq!(code, 0, "{stderr}");
    for part in [
        "scene?",
        "lat=",
        "Generate_IDM_Planner(",
        "Reflection:",
        "Trajectory",
    ] {
        assert!(stdout.contains(part), "no {part} in\n{stdout}");
    }
    // One picture for people, and the model's own.
    let own = image::open(folder.path().join("bev.model.png")).unwrap();
    let shown = image::open(&image).unwrap();
    assert_eq!((own.width(), own.height()), (128, 128));
    assert!(
        shown.width() > 1200 && shown.height() > 640,
        "{} x {}",
        shown.width(),
        shown.height()
    );
    let (code, stdout, _) = run(&[&arguments[..], &["--json"]].concat());
    assert_eq!(code, 0);
    let record: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(record["at_s"], 3.0);
    assert_eq!(record["trajectory"].as_array().unwrap().len(), 81);
    let late = refused(&["plan", "--scenario", SCENE, "--at", "99"]);
    assert!(late.contains("outside the window"), "{late}");
}

#[test]
fn scenarios_are_listed_shown_and_generated() {
    let (code, stdout, _) = run(&["scenarios", "list"]);
    assert_eq!(code, 0);
    assert!(
        stdout.contains("generated/following_lane_with_lead/0"),
        "{stdout}"
    );
    let (code, stdout, _) = run(&["scenarios", "show", SCENE, "--json"]);
    assert_eq!(code, 0);
    let shown: Value = serde_json::from_str(&stdout).unwrap();
    assert!(shown["lanes"].as_u64().unwrap() > 0 && !shown["route"].as_array().unwrap().is_empty());
    let (code, stdout, _) = run(&[
        "scenarios",
        "generate",
        "--type",
        "changing_lane",
        "--count",
        "2",
    ]);
    assert_eq!((code, stdout.lines().count()), (0, 2), "{stdout}");
}

#[test]
fn a_dataset_is_written_and_resumed() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("data");
    let arguments = [
        "dataset",
        "--out",
        out.to_str().unwrap(),
        "--states",
        "1",
        "--validation",
        "1",
        "--quiet",
    ];
    assert_eq!(run(&arguments).0, 0);
    let lines = fs::read_to_string(out.join("train-00000.jsonl")).unwrap();
    let first: Value = serde_json::from_str(lines.lines().next().unwrap()).unwrap();
    let answer = &first["conversation"][2];
    let content: Vec<char> = answer["content"].as_str().unwrap().chars().collect();
    let [start, end] = [0, 1].map(|i| answer["learn"][0][i].as_u64().unwrap() as usize);
    let scene_type: String = content[start..end].iter().collect();
    assert_eq!(first["facts"]["scene_type"], scene_type);
    let spans = |answer: &Value, key: &str| answer[key].as_array().map(Vec::len);
    assert_eq!(spans(answer, "weights"), None, "facts weigh the same");
    for decision in [&first["conversation"][4], &first["conversation"][6]] {
        assert_eq!(spans(decision, "weights"), spans(decision, "learn"));
        assert!(
            decision["weights"]
                .as_array()
                .unwrap()
                .iter()
                .all(|weight| weight.as_f64().unwrap() > 0.0)
        );
    }
    let image = image::open(out.join("train-00000.png")).unwrap();
    assert_eq!(
        (image.width(), image.height()),
        (128, 128 * lines.lines().count() as u32)
    );
    let before = fs::metadata(out.join("train-00000.jsonl"))
        .unwrap()
        .modified()
        .unwrap();
    assert_eq!(run(&arguments).0, 0);
    assert_eq!(
        fs::metadata(out.join("train-00000.jsonl"))
            .unwrap()
            .modified()
            .unwrap(),
        before
    );
    let other = refused(&[&arguments[..], &["--seed", "1"]].concat());
    assert!(other.contains("other settings"), "{other}");
}

#[test]
fn a_dataset_has_modified_scenarios_and_pairs_with_one_text() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("data");
    let counts = [
        "--states",
        "1",
        "--validation",
        "0",
        "--modified",
        "1",
        "--twins",
        "1",
        "--prompt-set",
        "compact-2",
    ];
    let (code, stdout, stderr) = run(&[
        &["dataset", "--json", "--out", out.to_str().unwrap()][..],
        &counts,
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    let rows = |name: &str| -> Vec<Value> {
        let text = fs::read_to_string(out.join(name)).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    };
    let (states, twins) = (rows("train-00000.jsonl"), rows("train-twins-00000.jsonl"));
    let counted: Value = serde_json::from_str(stdout.lines().next().unwrap()).unwrap();
    assert_eq!(counted["counts"]["twins"], twins.len());
    let modified = states
        .iter()
        .filter(|row| row["state"].as_str().unwrap().contains('~'))
        .count();
    assert!(
        modified > states.len() / 2 && counted["counts"]["modified"] == modified,
        "{counted}"
    );
    for row in states.iter().chain(&twins) {
        let grids: Vec<&str> = row["occupancy"]
            .as_array()
            .unwrap()
            .iter()
            .map(|grid| grid.as_str().unwrap())
            .collect();
        assert!(
            grids.len() == 3
                && grids
                    .iter()
                    .all(|grid| grid.len() == 64 && u128::from_str_radix(&grid[..32], 16).is_ok())
        );
    }
    assert!(
        states
            .iter()
            .any(|row| row["occupancy"][0] != row["occupancy"][2]),
        "things move"
    );
    let refused: Vec<&Value> = states
        .iter()
        .filter_map(|row| row.get("refused"))
        .flat_map(|codes| codes.as_array().unwrap())
        .collect();
    assert!(!refused.is_empty());
    for code in refused {
        let number = |key: &str| code[key].as_f64().unwrap();
        assert!(
            number("reflection") < 0.98 && number("score") <= 1.0 && number("value").is_finite()
        );
        let parts = code["parts"].as_object().unwrap();
        assert!(parts.len() == 6 && parts.values().any(|part| part.as_f64().unwrap() < 1.0));
        assert!(
            code["reason"]
                .as_str()
                .unwrap()
                .starts_with("Reflection scores")
        );
    }
    let tried = |row: &Value| {
        row.get("tried")
            .map(|codes| codes.as_array().unwrap().clone())
    };
    assert!(
        states.iter().any(|row| tried(row).is_some())
            && twins.iter().all(|twin| tried(twin).is_none())
    );
    for codes in states.iter().filter_map(tried) {
        let sum: f64 = codes
            .iter()
            .map(|code| code["chance"].as_f64().unwrap())
            .sum();
        assert!(codes.len() > 1 && (sum - 1.0).abs() < 1e-9, "{codes:?}");
        let code = |code: &Value| code["answers"][1]["content"].as_str().unwrap().to_owned();
        assert!(
            codes
                .iter()
                .all(|one| code(one).starts_with("Generate_IDM_Planner(")),
            "{codes:?}"
        );
    }
    let label = |row: &Value| row["conversation"][6]["content"].clone();
    let is_tried = |row: &Value, codes: Vec<Value>| {
        codes
            .iter()
            .any(|code| code["answers"][1]["content"] == label(row))
    };
    assert!(
        states
            .iter()
            .all(|row| tried(row).is_none_or(|codes| is_tried(row, codes))),
        "the label is one of them"
    );
    assert!(!twins.is_empty() && twins.len() % 2 == 0);
    for pair in twins.chunks(2) {
        let prompts =
            |row: &Value| [0, 1, 3, 5].map(|turn| row["conversation"][turn]["content"].clone());
        assert_eq!(
            (&pair[0]["twin"], prompts(&pair[0])),
            (&pair[1]["twin"], prompts(&pair[1]))
        );
        assert_ne!(pair[0]["facts"]["code"], pair[1]["facts"]["code"]);
    }
}

#[test]
fn bad_input_is_refused_with_what_and_where() {
    let folder = TempDir::new().unwrap();
    let config = folder.path().join("wrong.toml");
    fs::write(&config, "[reflection]\nthreshhold = 0.5\n").unwrap();
    let wrong_key = refused(&["simulate", "--config", config.to_str().unwrap()]);
    assert!(
        wrong_key.contains("wrong.toml")
            && wrong_key.contains("threshhold")
            && wrong_key.contains("line 2"),
        "{wrong_key}"
    );
    fs::write(&config, "[reflection]\nthreshold = 7.5\n").unwrap();
    let out_of_range = refused(&["simulate", "--config", config.to_str().unwrap()]);
    assert!(
        out_of_range.contains("reflection.threshold is 7.5e0"),
        "{out_of_range}"
    );

    fs::write(&config, "[environment]\nnode_length_m = 1e300\n").unwrap();
    let node = refused(&["simulate", "--config", config.to_str().unwrap()]);
    assert!(
        node.contains("environment.node_length_m") && node.contains("6 to 100"),
        "{node}"
    );
    let threads = refused(&["simulate", "--threads", "1000000"]);
    assert!(threads.contains("--threads"), "{threads}");

    let missing = refused(&["simulate", "--scenario", "nowhere.tfrecord"]);
    assert!(missing.contains("nowhere.tfrecord"), "{missing}");
    let kind = refused(&["simulate", "--scenario", "generated/flying/1"]);
    assert!(kind.contains("flying"), "{kind}");
    let planner = refused(&["simulate", "--planner", "telepathy"]);
    assert!(
        planner.contains("telepathy") && planner.contains("log-replay"),
        "{planner}"
    );
    let model = refused(&[
        "simulate",
        "--model",
        "no-such-model",
        "--out",
        folder.path().join("x").to_str().unwrap(),
    ]);
    assert!(model.contains("no-such-model"), "{model}");

    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let unwritable = file.join("run");
    let folder_error = refused(&[
        "simulate",
        "--planner",
        "idm",
        "--out",
        unwritable.to_str().unwrap(),
    ]);
    assert!(folder_error.contains("cannot write"), "{folder_error}");
    assert_eq!(
        folder_error.matches("cannot write").count(),
        1,
        "a cause is printed once: {folder_error}"
    );

    let foreign = folder.path().join("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("notes.txt"), "mine").unwrap();
    let dataset = refused(&[
        "dataset",
        "--out",
        foreign.to_str().unwrap(),
        "--states",
        "1",
    ]);
    assert!(dataset.contains("foreign"), "{dataset}");
}

/// A copy of the model that ships, to be broken.
fn copied_model(folder: &Path) -> PathBuf {
    let copy = folder.join("model");
    fs::create_dir(&copy).unwrap();
    for entry in fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/models/nano")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            fs::copy(&path, copy.join(path.file_name().unwrap())).unwrap();
        }
    }
    copy
}

#[test]
fn broken_checkpoints_are_refused() {
    use candle_core::{Device, Tensor};
    type Tensors = std::collections::HashMap<String, Tensor>;
    const NORM: &str = "language_model.model.norm.weight";
    let change = |tensors: &mut Tensors, what: &str| {
        let norm = tensors.remove(NORM).unwrap();
        match what {
            "missing" => None,
            "misshapen" => tensors.insert(NORM.to_owned(), norm.narrow(0, 0, 7).unwrap()),
            _ => tensors.insert(NORM.to_owned(), (norm * f64::NAN).unwrap()),
        };
    };
    for what in ["missing", "misshapen", "NaN"] {
        let work = TempDir::new().unwrap();
        let model = copied_model(work.path());
        let weights = model.join("model.safetensors");
        let mut tensors = candle_core::safetensors::load(&weights, &Device::Cpu).unwrap();
        change(&mut tensors, what);
        candle_core::safetensors::save(&tensors, &weights).unwrap();
        let out = work.path().join("run");
        let stderr = refused(&[
            "simulate",
            "--model",
            model.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ]);
        assert!(stderr.contains("norm.weight"), "{what}: {stderr}");
    }
    let work = TempDir::new().unwrap();
    let model = copied_model(work.path());
    fs::remove_file(model.join("tokenizer.json")).unwrap();
    let stderr = refused(&["plan", "--model", model.to_str().unwrap()]);
    assert!(stderr.contains("tokenizer.json"), "{stderr}");
}

#[test]
fn broken_recordings_are_refused() {
    let whole = written::bytes(&scenario(SCENE));
    let work = TempDir::new().unwrap();
    let broken = work.path().join("broken.tfrecord");
    let name = broken.to_str().unwrap();
    fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    let truncated = refused(&["simulate", "--planner", "idm", "--scenario", name]);
    assert!(truncated.contains("broken.tfrecord"), "{truncated}");
    let mut flipped = whole;
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    fs::write(&broken, flipped).unwrap();
    let checksum = refused(&["simulate", "--planner", "idm", "--scenario", name]);
    assert!(
        checksum.to_lowercase().contains("crc") || checksum.contains("checksum"),
        "{checksum}"
    );
}

/// Simulates every recording of a folder; gives the rows of the summary.
fn simulate_recordings(folder: &Path, flags: &[&str]) -> Vec<Value> {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let arguments = [
        "simulate",
        "--scenario",
        folder.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, _, stderr) = run(&[&arguments[..], flags].concat());
    assert_eq!(code, 0, "{stderr}");
    let rows = read_json(&out.join("summary.json"))["scenarios"]
        .as_array()
        .unwrap()
        .clone();
    assert!(!rows.is_empty());
    rows
}

/// Log replay keeps to road and direction, and PlanAgent plans.
fn check_simulated(folder: &Path) -> usize {
    let replayed = simulate_recordings(folder, &["--planner", "log-replay"]);
    for row in &replayed {
        assert_eq!(row["drivable_area_compliance"], 1.0, "{row}");
        assert_eq!(row["driving_direction_compliance"], 1.0, "{row}");
    }
    for row in simulate_recordings(folder, &["--challenge", "both"]) {
        assert!(row["planning_calls"].as_u64().unwrap() >= 3, "{row}");
        let score = row["score"].as_f64().unwrap();
        assert_eq!(
            score <= 0.0,
            !row["zeroed_by"].as_array().unwrap().is_empty(),
            "{row}"
        );
    }
    replayed.len()
}

#[test]
fn written_recordings_are_simulated() {
    let folder = TempDir::new().unwrap();
    for (file, scene) in [
        ("one", SCENE),
        ("two", "generated/starting_right_turn/1"),
        ("three", "generated/traversing_intersection/1"),
    ] {
        written::write(&folder.path().join(format!("{file}.tfrecord")), scene);
    }
    assert_eq!(check_simulated(folder.path()), 3);
}

#[test]
fn every_recording_is_simulated() -> Needy {
    let recordings = check_simulated(&data("womd")?);
    assert!(recordings >= 11, "{recordings} recordings");
    Ok(())
}

#[test]
fn the_example_configuration_shows_every_default() {
    let text = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/planagent.toml")).unwrap();
    let example: planagent_runs::runner::Config = toml::from_str(&text).unwrap();
    assert_eq!(example, planagent_runs::runner::Config::default());
    let defaults: toml::Table =
        toml::Table::try_from(planagent_runs::runner::Config::default()).unwrap();
    let shown: toml::Table = toml::from_str(&text).unwrap();
    for (section, value) in &defaults {
        let keys = value
            .as_table()
            .map(|table| table.keys().cloned().collect::<Vec<_>>())
            .unwrap_or_default();
        assert!(shown.contains_key(section), "{section} is not shown");
        for key in keys {
            assert!(
                shown[section].as_table().unwrap().contains_key(&key),
                "{section}.{key} is not shown"
            );
        }
    }
}

/// Help names what the registries hold.
#[test]
fn help_lists_planners_suites_and_studies_with_their_sizes() {
    let help = |command: &str| {
        run(&[command, "--help"])
            .1
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
    };
    let simulate = help("simulate");
    for part in [
        "generated (16 types x 10)",
        "generated-test14 (14 types x 150)",
        "generated-test14-hard (14 types x 20)",
    ] {
        assert!(simulate.contains(part), "no {part} in {simulate}");
    }
    assert!(
        simulate.contains("val14") && simulate.contains("dtpp-small [default: plan-agent]. Or"),
        "{simulate}"
    );
    let study = help("study");
    assert!(
        study.contains(
            "recorded, interactive, ceilings, agents, tokens, twins; all for all of these"
        ),
        "{study}"
    );
}
