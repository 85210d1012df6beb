//! The page of a run and the renders of its simulations.

#[cfg(unix)]
mod browser;
#[cfg(unix)]
mod chromium;
mod files;
#[cfg(unix)]
mod hostile;
#[cfg(unix)]
mod layout;
#[cfg(unix)]
mod live;
mod serve;

use crate::cli::run;
use std::path::Path;

/// Types of the generated scenes.
const TYPES: [&str; 4] = [
    "changing_lane",
    "stopping_with_lead",
    "traversing_roundabout",
    "waiting_for_pedestrian_to_cross",
];

/// Simulates scenarios.
fn simulate(out: &Path, scenarios: &[String], planners: &str) {
    let words: Vec<&str> = scenarios.iter().map(String::as_str).collect();
    let flags = [
        "--planner",
        planners,
        "--out",
        out.to_str().unwrap(),
        "--quiet",
    ];
    let (code, _, stderr) = run(&[&["simulate", "--scenario"], &words[..], &flags[..]].concat());
    assert_eq!(code, 0, "{stderr}");
}

fn scenes(count: usize) -> Vec<String> {
    (0..count)
        .map(|i| {
            format!(
                "generated/{}/{}",
                TYPES[i % TYPES.len()],
                1 + i / TYPES.len()
            )
        })
        .collect()
}
