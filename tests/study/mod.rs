//! `planagent study`: runs are shared and resumed, and the results do not depend on
//! interruptions.

mod paper;

use crate::cli::{planagent, read_json, refused, run};
use crate::runner::{kill_when, simulations, spawn, written};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A suite that every planner completes in a few seconds.
const SUITE: [&str; 5] = [
    "--suite",
    "recorded",
    "--scenario",
    "generated/changing_lane/3",
    "generated/stopping_with_lead/1",
];

/// The command line of a study on it.
fn study<'a>(name: &'a str, out: &'a Path) -> Vec<&'a str> {
    [&["study", name, "--out", out.to_str().unwrap()], &SUITE[..]].concat()
}

/// The files of a study's results, by name.
fn results(folder: &Path) -> BTreeMap<String, String> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries
        .map(|entry| {
            (
                entry.file_name().into_string().unwrap(),
                fs::read_to_string(entry.path()).unwrap(),
            )
        })
        .collect()
}

/// The folders of the runs.
fn runs(out: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(out.join("runs")) else {
        return Vec::new();
    };
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    found.sort();
    found
}

/// How many simulations of all runs are completed.
fn ended(out: &Path) -> usize {
    runs(out).iter().map(|run| simulations(run).len()).sum()
}

#[test]
fn a_killed_study_ends_like_an_uninterrupted_one_and_shares_its_runs() {
    let work = TempDir::new().unwrap();
    let [whole, killed] = ["whole", "killed"].map(|name| work.path().join(name));
    let (code, stdout, stderr) = run(&study("scenario-types", &whole));
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stderr.contains("8 simulations in 2 runs; 0 are completed, 8 are left"),
        "{stderr}"
    );
    assert!(
        stderr.contains(" for 4 simulations on"),
        "the time is known after the first scene: {stderr}"
    );
    assert!(
        stdout.contains("stopping_with_lead") && stdout.lines().all(|l| l.chars().count() <= 80),
        "{stdout}"
    );
    let expected = results(&whole.join("scenario-types"));
    assert_eq!(
        expected.keys().collect::<Vec<_>>(),
        ["recorded.svg", "results.json", "results.md"]
    );
    assert!(
        expected["results.md"].contains("![") && expected["results.md"].contains("changing_lane")
    );
    assert!(expected["recorded.svg"].starts_with("<svg "));

    for goal in [1, 5] {
        kill_when(spawn(&study("scenario-types", &killed)), || {
            ended(&killed) >= goal
        });
    }
    let before: BTreeMap<_, _> = runs(&killed).iter().flat_map(|run| written(run)).collect();
    assert!(before.len() >= 5);
    let (code, _, stderr) = run(&study("scenario-types", &killed));
    assert!(
        code == 0 && stderr.contains(&format!("{} are completed", before.len())),
        "{stderr}"
    );
    let after: BTreeMap<_, _> = runs(&killed).iter().flat_map(|run| written(run)).collect();
    assert!(
        before
            .iter()
            .all(|(folder, time)| after.get(folder) == Some(time)),
        "a simulation was repeated"
    );
    assert_eq!(results(&killed.join("scenario-types")), expected);

    // Another study shares a run with it, and `simulate` can resume each run.
    let (code, stdout, stderr) = run(&[&study("execution", &killed)[..], &["--json"]].concat());
    assert!(
        code == 0 && stderr.contains("16 simulations in 4 runs; 4 are completed, 12 are left"),
        "{stderr}"
    );
    let told: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(told, read_json(&killed.join("execution/results.json")));
    assert_eq!(ended(&killed), 20);
    for simulated in runs(&killed) {
        let (code, _, stderr) = run(&[
            "simulate",
            "--resume",
            simulated.to_str().unwrap(),
            "--json",
        ]);
        assert!(
            code == 0 && stderr.contains("4 of 4 simulations are completed"),
            "{stderr}"
        );
    }

    // The results are those of the runs.
    let suite = &told["suites"][0];
    assert_eq!(
        (&suite["name"], &suite["scenes"], &suite["benchmark"]),
        (&"recorded".into(), &2.into(), &Value::Null)
    );
    for variant in suite["variants"].as_array().unwrap() {
        let summary = read_json(
            &killed
                .join("execution")
                .join(variant["run"].as_str().unwrap())
                .join("summary.json"),
        );
        for (place, challenge) in variant["challenges"].as_array().unwrap().iter().enumerate() {
            let mean = summary["aggregates"][place]["score"].as_f64().unwrap() * 100.0;
            assert!(
                (challenge["score"].as_f64().unwrap() - mean).abs() < 1e-9,
                "{variant}"
            );
            assert_eq!(
                challenge["difference"].is_null(),
                variant["name"] == told["reference"],
                "{variant}"
            );
        }
    }
}

#[test]
fn a_model_without_weights_says_so() {
    let work = TempDir::new().unwrap();
    let flags = [
        "study",
        "mllm",
        "--suite",
        "recorded",
        "--scenario",
        "generated/changing_lane/3",
        "--out",
    ];
    // A cache of the hub with nothing in it.
    let output = planagent()
        .args(flags)
        .arg(work.path())
        .env("HF_HOME", work.path().join("hub"))
        .output()
        .unwrap();
    let (stdout, stderr) = (
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    );
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let rows: Vec<&str> = stdout
        .lines()
        .filter(|line| line.starts_with("llava-1.5-7b"))
        .collect();
    assert!(
        rows[0].contains("no weights") && stdout.contains("gpt-4v"),
        "{stdout}"
    );
    assert!(
        stdout.lines().all(|line| line.chars().count() <= 80),
        "{stdout}"
    );
    let results = read_json(&work.path().join("mllm/results.json"));
    let variants = results["suites"][0]["variants"].as_array().unwrap();
    let named = |name: &str| {
        variants
            .iter()
            .find(|variant| variant["name"] == name)
            .unwrap()
    };
    assert_eq!(named("cogvlm-chat-17b")["not_simulated"], "no weights");
    assert!(named("cogvlm-chat-17b")["challenges"][0]["score"].is_null());
    assert_eq!(named("cogvlm-chat-17b")["model"]["paper"]["time_ms"], 4405);
    assert!(
        named("nano")["challenges"][0]["score"].is_number()
            && named("nano")["model"]["call_ms"].is_number()
    );
}

#[test]
fn what_cannot_be_driven_is_refused_with_what_to_do() {
    let work = TempDir::new().unwrap();
    let out = work.path().to_str().unwrap();
    let said = |flags: &[&str]| refused(&[&["study"], flags, &["--out", out]].concat());
    assert!(
        said(&["mian"]).contains("scenario-types"),
        "the names are listed"
    );
    let unknown = said(&["main", "--suite", "val15"]);
    assert!(
        unknown.contains("val15") && unknown.contains("generated"),
        "{unknown}"
    );
    let bench = said(&[
        "mllm",
        "--bench",
        work.path().join("nowhere").to_str().unwrap(),
    ]);
    assert!(bench.contains("rows.jsonl"), "{bench}");
    let output = planagent()
        .args(["study", "main", "--suite", "recorded", "--out", out])
        .env_remove("PLANAGENT_DATA")
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2) && stderr.contains("--scenario") && stderr.contains("womd"),
        "{stderr}"
    );
}

#[test]
fn a_study_of_a_user_is_a_file() {
    let work = TempDir::new().unwrap();
    let file = work.path().join("mine.toml");
    let definition = "name = 'speeds'\ntitle = 'Two planners'\nlabels = ['planner', 'threshold']\nreference = 1\n\
        suites = ['generated']\n[[variants]]\nlabels = ['simple', '-']\nplanner = 'simple'\n\
        [[variants]]\nlabels = ['fixed', '0.5']\nplanner = 'fixed-code'\nsettings.reflection.threshold = 0.5\n";
    fs::write(&file, definition).unwrap();
    let (code, stdout, stderr) = run(&study(file.to_str().unwrap(), work.path()));
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.contains("Two planners") && stderr.contains("8 simulations in 2 runs"),
        "{stdout}{stderr}"
    );
    let results = read_json(&work.path().join("speeds/results.json"));
    assert_eq!(results["reference"], "planner: fixed, threshold: 0.5");
    assert_eq!(
        results["suites"][0]["variants"][1]["settings"]["reflection"]["threshold"],
        0.5
    );
    let config = |run: &Path| fs::read_to_string(run.join("config.toml")).unwrap();
    assert_eq!(
        runs(work.path())
            .iter()
            .filter(|run| config(run).contains("threshold = 0.5"))
            .count(),
        1
    );

    let out = work.path().to_str().unwrap();
    fs::write(
        &file,
        definition.replace("threshold = 0.5", "threshhold = 0.5"),
    )
    .unwrap();
    let wrong = refused(&["study", file.to_str().unwrap(), "--out", out]);
    assert!(wrong.contains("threshhold"), "{wrong}");
    fs::write(&file, definition.replace("reference = 1", "reference = 2")).unwrap();
    let wrong = refused(&["study", file.to_str().unwrap(), "--out", out]);
    assert!(
        wrong.contains("mine.toml") && wrong.contains("reference is 2"),
        "{wrong}"
    );
}
