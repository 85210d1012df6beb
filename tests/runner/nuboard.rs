//! What nuBoard opens: read by plain Python, and by the devkit where there is one.

use super::quick_run;
use crate::cli::run;
use crate::outside::{Needy, devkit, python};
use std::fs;
use std::process::Command;
use tempfile::TempDir;

/// Opens a moved run of two scenarios with `read_nuboard.py`; what it printed.
fn opened(python: &str) -> String {
    let work = TempDir::new().unwrap();
    let [out, moved] = ["run", "elsewhere"].map(|name| work.path().join(name));
    let mut flags = quick_run(2);
    flags.extend(["--out".to_owned(), out.to_str().unwrap().to_owned()]);
    let (code, _, stderr) = run(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code, 0, "{stderr}");
    fs::rename(&out, &moved).unwrap();

    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/runner/read_nuboard.py");
    let output = Command::new(python)
        .arg(script)
        .arg(&moved)
        .output()
        .unwrap();
    let [stdout, stderr] =
        [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(
        output.status.success() && stdout.contains("2 files opened"),
        "{stdout}\n{stderr}"
    );
    stdout
}

#[test]
fn nuboards_files_of_each_challenge_open_also_after_the_run_is_moved() -> Needy {
    opened(&python(&[])?);
    Ok(())
}

#[test]
fn nuboards_own_classes_open_a_run() -> Needy {
    devkit()?;
    let stdout = opened(&python(&[])?);
    assert!(stdout.contains("opened by the devkit"), "{stdout}");
    Ok(())
}
