//! What nuBoard opens: read by plain Python, and by the devkit where there is one.

use super::quick_run;
use crate::cli::run;
use crate::outside::skipped;
use std::fs;
use std::process::Command;
use tempfile::TempDir;

#[test]
fn nuboard_opens_each_challenge_also_after_the_run_is_moved() {
    let python = std::env::var_os("PLANAGENT_PYTHON").unwrap_or_else(|| "python3".into());
    if !Command::new(&python).arg("--version").output().is_ok_and(|output| output.status.success()) {
        skipped(format!("{} does not run; set PLANAGENT_PYTHON to a Python", python.to_string_lossy()));
        return;
    }
    let work = TempDir::new().unwrap();
    let [out, moved] = ["run", "elsewhere"].map(|name| work.path().join(name));
    let mut flags = quick_run(2);
    flags.extend(["--out".to_owned(), out.to_str().unwrap().to_owned()]);
    let (code, _, stderr) = run(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code, 0, "{stderr}");
    fs::rename(&out, &moved).unwrap();

    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/runner/read_nuboard.py");
    let output = Command::new(&python).arg(script).arg(&moved).output().unwrap();
    let [stdout, stderr] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(output.status.success() && stdout.contains("2 files opened"), "{stdout}\n{stderr}");
    if std::env::var_os("PLANAGENT_DEVKIT").is_none() {
        skipped("nuBoard's own classes: set PLANAGENT_DEVKIT to the sources of nuplan-devkit");
    } else {
        assert!(stdout.contains("opened by the devkit"), "{stdout}\n{stderr}");
    }
}
