//! Runs: written simulation by simulation, resumed, and read by other programs.

mod failures;
mod inputs;
mod library;
mod nuboard;
mod nuplan_folders;
mod parallel;
mod parquet;
mod pinned;
mod renamed_settings;
mod resume;
mod splits;

pub(crate) use resume::{kill_when, spawn, written};

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The flags of a run of `scenarios` generated scenes with planners that are quick.
fn quick_run(scenarios: usize) -> Vec<String> {
    let count = scenarios.to_string();
    let scenes = [
        "simulate",
        "--split",
        "generated",
        "--type",
        "starting_left_turn",
        "--limit",
        &count,
    ];
    scenes
        .into_iter()
        .chain([
            "--planner",
            "log-replay,simple",
            "--quiet",
            "--challenge",
            "both",
        ])
        .map(str::to_owned)
        .collect()
}

/// Folders of the completed simulations, by name.
pub(crate) fn simulations(run: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(run.join("simulations")) else {
        return Vec::new();
    };
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| !path.file_name().unwrap().to_str().unwrap().starts_with('.'));
    found.sort();
    found
}

/// Everything in a run's folder whose bytes may not depend on the clock, by name; the stamp of the
/// start is cut out.
fn results(run: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, root: &Path, found: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path
                .strip_prefix(root)
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned();
            if path.is_dir() {
                walk(&path, root, found);
            } else if !["timing.json", "manifest.toml", ".lock"].contains(&name.as_str())
                && !name.ends_with("record.toml")
                && !name.ends_with("runner_report.parquet")
            {
                let name = name.split("_metrics_").next().unwrap().to_owned();
                assert!(found.insert(name, fs::read(&path).unwrap()).is_none());
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(run, run, &mut found);
    found
}

/// Fails with the names of the files that differ.
fn assert_same_results(one: &Path, other: &Path) {
    let (one, other) = (results(one), results(other));
    let differing: Vec<&String> = one
        .keys()
        .chain(other.keys())
        .filter(|name| one.get(*name) != other.get(*name))
        .collect();
    assert!(differing.is_empty(), "these differ: {differing:?}");
}
