//! Ctrl-C: the program says how its work goes on.

use super::planagent;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// SIGINT, as systems number it.
const INTERRUPT: i32 = 2;
/// Time after which a program that does nothing hangs.
const PATIENCE: Duration = Duration::from_mins(1);

/// Starts the program, interrupts it once `begun` exists, and gives its stderr.
fn interrupted(folder: &Path, arguments: &[&str], begun: &str) -> String {
    let mut command = Command::new(planagent().get_program());
    command.args(arguments).current_dir(folder).env(
        "PLANAGENT_MODELS",
        concat!(env!("CARGO_MANIFEST_DIR"), "/models"),
    );
    let mut child = command
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while !folder.join(begun).exists() {
        assert!(began.elapsed() < PATIENCE, "{begun} does not appear");
        sleep(Duration::from_millis(5));
    }
    // The file is there before the first simulation begins.
    sleep(Duration::from_millis(200));
    // The shell's own `kill`: a small system has no program of that name.
    assert!(
        Command::new("sh")
            .args(["-c", &format!("kill -INT {}", child.id())])
            .status()
            .unwrap()
            .success()
    );
    let mut stderr = String::new();
    child
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut stderr)
        .unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(INTERRUPT), "{stderr}");
    stderr
}

#[test]
fn an_interrupted_run_says_how_it_goes_on() {
    let work = TempDir::new().unwrap();
    let simulate = [
        "simulate",
        "--split",
        "generated-test14",
        "--planner",
        "pdm-closed",
    ];
    let stderr = interrupted(work.path(), &simulate, "runs/0001/manifest.toml");
    assert!(
        stderr.ends_with("interrupted; `planagent simulate --resume runs/0001` goes on\n"),
        "{stderr}"
    );
    let study = [
        "study",
        "main",
        "--suite",
        "generated-test14",
        "--quick",
        "--out",
        "studies",
    ];
    let stderr = interrupted(work.path(), &study, "studies/runs");
    assert!(
        stderr.ends_with("interrupted; the same command goes on\n"),
        "{stderr}"
    );
}
