//! Wild numbers in a run folder that others made: one record costs one row, a picture is drawn, a
//! page is shown.

use super::{read_json, run};
use crate::runner::simulations;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use serde_json::Value;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A run of two scenes with two planners.
fn whole(work: &Path) -> PathBuf {
    let out = work.join("run");
    let (code, _, stderr) = run(&[
        "simulate",
        "--scenario",
        "generated/changing_lane/3",
        "generated/stopping_with_lead/1",
        "--planner",
        "log-replay,idm",
        "--quiet",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    out
}

/// Replaces the number of a key in the record of the first simulation.
fn set_in_record(out: &Path, key: &str, wild: &str) -> String {
    let record = simulations(out)[0].join("record.toml");
    let before = fs::read_to_string(&record).unwrap();
    let line = |line: &str| {
        if line.starts_with(&format!("{key} = ")) {
            format!("{key} = {wild}\n")
        } else {
            format!("{line}\n")
        }
    };
    let after: String = before.lines().map(line).collect();
    assert_ne!(before.trim(), after.trim(), "no {key} in {before}");
    fs::write(&record, after).unwrap();
    before
}

#[test]
fn a_wild_number_of_one_record_costs_one_row() {
    let work = TempDir::new().unwrap();
    let out = whole(work.path());
    let folder = out.to_str().unwrap();
    for (key, wild) in [
        ("score", "1e308"),
        ("score", "nan"),
        ("score", "-inf"),
        ("score", "-0.1"),
        ("rethinks", "9223372036854775807"),
        ("started_s", "1e300"),
        ("ended_s", "nan"),
        ("planner_s", "[1e308, 1e308]"),
    ] {
        let before = set_in_record(&out, key, wild);
        let (code, json, stderr) = run(&["report", folder, "--json"]);
        assert_eq!(code, 0, "{key} = {wild}: {stderr}");
        let contents: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(contents["simulations"], 3, "{key} = {wild}: {contents}");
        assert_eq!(contents["damaged"].as_array().unwrap().len(), 1);
        assert!(stderr.contains("is damaged and left out"), "{stderr}");
        let (code, table, stderr) =
            run(&["compare", folder, folder, "--planner", "idm,log-replay"]);
        assert_eq!(code, 0, "{key} = {wild}: {stderr}");
        assert!(!table.contains("inf") && !table.contains("NaN"), "{table}");
        fs::write(simulations(&out)[0].join("record.toml"), before).unwrap();
    }
    // The advice repeats what is left out.
    set_in_record(&out, "score", "1e308");
    let (code, _, stderr) = run(&["simulate", "--resume", folder]);
    assert_eq!(code, 0, "{stderr}");
    let rows = read_json(&out.join("summary.json"))["scenarios"].clone();
    assert_eq!(rows.as_array().unwrap().len(), 4);
}

/// Changes the replay of the first simulation.
fn change_replay(out: &Path, change: impl Fn(&mut Value)) {
    let path = simulations(out)[0].join("replay.json.gz");
    let mut text = String::new();
    GzDecoder::new(fs::File::open(&path).unwrap())
        .read_to_string(&mut text)
        .unwrap();
    let mut replay: Value = serde_json::from_str(&text).unwrap();
    change(&mut replay);
    let mut encoder = GzEncoder::new(fs::File::create(&path).unwrap(), Compression::fast());
    encoder.write_all(replay.to_string().as_bytes()).unwrap();
    encoder.finish().unwrap();
}

/// The numbers of a value, each with the path to it.
fn numbers(value: &Value, path: &str, found: &mut Vec<String>) {
    match value {
        Value::Array(list) => {
            // The first number of a list and the last are enough.
            for i in [0, list.len().saturating_sub(1)] {
                if let Some(inner) = list.get(i) {
                    numbers(inner, &format!("{path}/{i}"), found);
                }
            }
        }
        Value::Object(fields) => {
            for (name, inner) in fields {
                numbers(inner, &format!("{path}/{name}"), found);
            }
        }
        Value::Number(_) => found.push(path.to_owned()),
        _ => {}
    }
    found.dedup();
}

#[test]
fn a_replay_with_wild_numbers_is_drawn_or_refused() {
    let work = TempDir::new().unwrap();
    let out = whole(work.path());
    let replay = simulations(&out)[0].join("replay.json.gz");
    let before = fs::read(&replay).unwrap();
    let (mut paths, mut text) = (Vec::new(), String::new());
    GzDecoder::new(&before[..])
        .read_to_string(&mut text)
        .unwrap();
    numbers(&serde_json::from_str(&text).unwrap(), "", &mut paths);
    assert!(paths.len() > 20, "{paths:?}");
    // A place of each kind: the same field of another object is no new one.
    let kind = |path: &str| -> String {
        path.split('/')
            .filter(|part| part.parse::<usize>().is_err())
            .collect()
    };
    let mut kinds = Vec::new();
    paths.retain(|path| {
        let is_new = !kinds.contains(&kind(path));
        kinds.push(kind(path));
        is_new
    });
    let png = work.path().join("a.png");
    for path in &paths {
        for wild in [i64::MAX, -1_000_000_000_000] {
            change_replay(&out, |replay| {
                *replay.pointer_mut(path).unwrap() = wild.into();
            });
            let (code, _, stderr) = run(&[
                "render",
                out.to_str().unwrap(),
                "0",
                "--png",
                png.to_str().unwrap(),
                "--pixels",
                "96",
            ]);
            assert!(
                [0, 2].contains(&code) && !stderr.contains("panicked"),
                "{path} = {wild}: exit code {code}: {stderr}"
            );
            fs::write(&replay, &before).unwrap();
        }
    }
}

#[test]
fn a_file_that_cannot_be_read_costs_the_replay_of_its_simulation() {
    let work = TempDir::new().unwrap();
    let out = whole(work.path());
    fs::write(simulations(&out)[0].join("replay.json.gz"), "no gzip").unwrap();
    let (code, json, stderr) = run(&["report", out.to_str().unwrap(), "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let contents: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&contents["simulations"], &contents["replays"]),
        (&4.into(), &3.into())
    );
    assert!(
        stderr.contains("replay.json.gz") && stderr.contains("the scores of its simulation alone"),
        "{stderr}"
    );
}
