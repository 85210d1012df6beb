//! `simulate --challenge open-loop`.

use super::{SCENE, read_json, run};
use crate::womd::written;
use tempfile::TempDir;

#[test]
fn every_planner_plans_far_enough_for_the_open_loop_metrics() {
    plans_far_enough(SCENE);
}

#[test]
fn every_planner_plans_far_enough_on_a_recording() {
    let work = TempDir::new().unwrap();
    let recording = work.path().join("recording.tfrecord");
    written::write(&recording, SCENE);
    plans_far_enough(recording.to_str().unwrap());
}

fn plans_far_enough(scenario: &str) {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = [
        "--planner",
        "plan-agent,pdm-closed,idm,simple,log-replay",
        "--challenge",
        "open-loop",
    ];
    let (code, stdout, stderr) = run(&[
        &["simulate", "--scenario", scenario],
        &flags[..],
        &["--out", out.to_str().unwrap()],
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("OLS") && stdout.contains("ADE"), "{stdout}");
    assert!(
        stdout.lines().all(|line| line.chars().count() <= 80),
        "wider than 80 columns:\n{stdout}"
    );
    let summary = read_json(&out.join("summary.json"));
    let rows = summary["scenarios"].as_array().unwrap();
    assert_eq!(rows.len(), 5);
    for row in rows {
        for metric in [
            "planner_miss_rate_within_bound",
            "planner_expert_average_l2_error_within_bound",
        ] {
            assert!(
                (0.0..=1.0).contains(&row[metric].as_f64().unwrap()),
                "{metric} in {row}"
            );
        }
        match row["planner"].as_str().unwrap() {
            "plan-agent" => assert!(row["planning_calls"].as_u64().unwrap() > 0, "{row}"),
            "log-replay" => assert!(row["score"].as_f64().unwrap() > 0.99, "{row}"),
            _ => {}
        }
    }
}
