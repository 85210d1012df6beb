//! Many processes in one place: each gets its own, or one file is whole in the end.

use super::resume::spawn;
use crate::cli::{planagent, run};
use std::fs;
use std::process::Stdio;
use tempfile::TempDir;

/// Processes at one time.
const PROCESSES: usize = 8;

#[test]
fn every_start_gets_a_folder_of_its_own() {
    let work = TempDir::new().unwrap();
    let start = || {
        let program = planagent();
        let mut command = std::process::Command::new(program.get_program());
        command
            .current_dir(work.path())
            .args(["simulate", "--planner", "log-replay", "--quiet"])
            .stdout(Stdio::null())
            .spawn()
            .unwrap()
    };
    let started: Vec<_> = (0..PROCESSES).map(|_| start()).collect();
    for mut process in started {
        assert!(process.wait().unwrap().success());
    }
    let runs = fs::read_dir(work.path().join("runs")).unwrap();
    let complete = runs.filter(|run| {
        let run = run.as_ref().unwrap().path();
        run.join("summary.json").is_file()
    });
    assert_eq!(complete.count(), PROCESSES);
}

#[test]
fn many_reports_of_one_run_all_succeed() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    assert_eq!(
        run(&["simulate", "--planner", "idm", "--out", folder, "--quiet"]).0,
        0
    );
    let started: Vec<_> = (0..PROCESSES).map(|_| spawn(&["report", folder])).collect();
    for mut process in started {
        assert!(process.wait().unwrap().success());
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.trim_end().ends_with("</html>"));
    let left = fs::read_dir(&out)
        .unwrap()
        .filter(|entry| {
            let name = entry.as_ref().unwrap().file_name();
            name.to_string_lossy().starts_with(".unfinished-")
        })
        .count();
    assert_eq!(left, 0);
}
