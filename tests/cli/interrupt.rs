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
    interrupted_after(folder, arguments, begun, Duration::from_millis(200))
}

/// The same some time after `begun` exists.
fn interrupted_after(folder: &Path, arguments: &[&str], begun: &str, pause: Duration) -> String {
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
    sleep(pause);
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

/// The folder of a bench exists from the first measured model on, so the message names it from then
/// on alone.
#[test]
fn an_interrupted_bench_says_what_is_possible() {
    let work = TempDir::new().unwrap();
    let bench = ["bench", "nano", "--iterations", "100000", "--out", "be"];
    // Nothing on the disk says that it began.
    let stderr = interrupted_after(work.path(), &bench, ".", Duration::from_secs(5));
    assert!(
        !work.path().join("be").exists() && !stderr.contains("--resume"),
        "{stderr}"
    );
    assert!(stderr.contains("the same command starts again"), "{stderr}");
}

#[test]
fn an_interrupted_run_of_a_command_names_the_command() {
    let work = TempDir::new().unwrap();
    let command = "c=exec:read first; echo '{\"type\": \"ready\"}'; sleep 600";
    let simulate = ["simulate", "--planner", command, "--out", "my run"];
    let stderr = interrupted(work.path(), &simulate, "my run/manifest.toml");
    let line = stderr
        .split('`')
        .nth(1)
        .unwrap_or_else(|| panic!("{stderr}"));
    assert!(
        line.starts_with("planagent simulate --resume 'my run' --planner 'c=exec:read first"),
        "{stderr}"
    );
    // As a shell reads it, the run is found again: the command still sleeps.
    let script = format!(
        "exec \"$0\" {} --exec-timeout 1",
        &line["planagent ".len()..]
    );
    let resumed = Command::new("sh")
        .args(["-c", &script])
        .arg(planagent().get_program())
        .current_dir(work.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&resumed.stderr);
    assert!(
        resumed.status.code() == Some(1) && said.contains("gave no answer within 1 s"),
        "{said}"
    );
}
