//! stdout and stderr that are full or closed: the work goes on, with its own exit code.

use super::{SCENE, planagent};
use std::fs::{self, File, OpenOptions};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use tempfile::TempDir;

/// The model that answers without a trial, in a moment.
const TINY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/tiny_llava");

/// A stream that fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Broken {
    /// Each write is an error: a full disk.
    Full,
    /// Its reader is gone.
    Gone,
    /// It was closed before the program began.
    Closed,
}

impl Broken {
    const ALL: [Self; 3] = [Self::Full, Self::Gone, Self::Closed];

    fn stream(self) -> Stdio {
        match self {
            // Only Linux has the device; elsewhere a file that is not writable fails too.
            Self::Full if Path::new("/dev/full").exists() => OpenOptions::new()
                .write(true)
                .open("/dev/full")
                .unwrap()
                .into(),
            Self::Full => File::open("/dev/null").unwrap().into(),
            Self::Gone => {
                let (reader, writer) = std::io::pipe().unwrap();
                drop(reader);
                writer.into()
            }
            // The shell closes it.
            Self::Closed => Stdio::null(),
        }
    }
}

/// Runs the program with a broken stderr or stdout; gives its status.
fn run(arguments: &[&str], stderr: Option<Broken>, stdout: Option<Broken>) -> ExitStatus {
    let program = planagent().get_program().to_owned();
    let closed = |stream: Option<Broken>, word: &'static str| {
        if stream == Some(Broken::Closed) {
            word
        } else {
            ""
        }
    };
    let script = format!(
        "exec \"$0\" \"$@\" {} {}",
        closed(stderr, "2>&-"),
        closed(stdout, ">&-")
    );
    Command::new("sh")
        .args(["-c", &script])
        .arg(program)
        .args(arguments)
        .env(
            "PLANAGENT_MODELS",
            concat!(env!("CARGO_MANIFEST_DIR"), "/models"),
        )
        .env(
            "PLANAGENT_CACHE",
            concat!(env!("CARGO_TARGET_TMPDIR"), "/cache"),
        )
        .stderr(stderr.map_or_else(Stdio::null, Broken::stream))
        .stdout(stdout.map_or_else(Stdio::null, Broken::stream))
        .status()
        .unwrap()
}

#[test]
fn a_stderr_that_fails_ends_nothing() {
    let work = TempDir::new().unwrap();
    for broken in Broken::ALL {
        let out = work.path().join(format!("{broken:?}"));
        let out = out.to_str().unwrap();
        let simulate = ["simulate", "--scenario", SCENE, "--planner", "log-replay"];
        let status = run(
            &[&simulate[..], &["--out", out]].concat(),
            Some(broken),
            None,
        );
        assert_eq!(status.code(), Some(0), "{broken:?}");
        assert!(Path::new(out).join("summary.json").is_file(), "{broken:?}");
        // Notes, failures, errors of the program and of clap, advice, bars.
        let (gone, picture) = (format!("{out}-missing"), format!("{out}.gif"));
        for (arguments, code) in [
            (&["simulate", "--resume", out, "-v"][..], 0),
            (&["report", out], 0),
            (
                &["render", out, "0", "--gif", &picture, "--pixels", "160"],
                0,
            ),
            (&["simulate", "--resume", &gone], 2),
            (&["simulate", "--no-such-option"], 2),
            (&["no-such-command"], 2),
            (&["simulate", "--set", "no.such=1"], 2),
            (&["models", "list"], 0),
            (
                &[
                    "ask",
                    "Who?",
                    "--scenario",
                    SCENE,
                    "--model",
                    TINY,
                    "--max-tokens",
                    "2",
                    "--prompt-set",
                    "compact",
                ],
                0,
            ),
        ] {
            let status = run(arguments, Some(broken), None);
            assert_eq!(
                status.code(),
                Some(code),
                "{arguments:?} with stderr {broken:?}"
            );
        }
    }
}

#[test]
fn a_stdout_that_fails_ends_no_work() {
    let work = TempDir::new().unwrap();
    for broken in Broken::ALL {
        let out = work.path().join(format!("{broken:?}"));
        let out = out.to_str().unwrap();
        let simulate = ["simulate", "--scenario", SCENE, "--planner", "log-replay"];
        let status = run(
            &[&simulate[..], &["--out", out]].concat(),
            None,
            Some(broken),
        );
        // A table that could not be written is an error; a reader that is gone wanted no more.
        let code = if broken == Broken::Full { 2 } else { 0 };
        assert_eq!(status.code(), Some(code), "{broken:?}");
        assert!(Path::new(out).join("summary.json").is_file(), "{broken:?}");
        for arguments in [
            &["--help"][..],
            &["--version"],
            &["models", "list", "--json"],
            &["config"],
            &["completions", "bash"],
            &["simulate", "--resume", out, "--csv"],
        ] {
            let status = run(arguments, None, Some(broken));
            assert_eq!(
                status.code(),
                Some(code),
                "{arguments:?} with stdout {broken:?}"
            );
        }
    }
}

#[test]
fn both_streams_may_fail_at_once() {
    let work = TempDir::new().unwrap();
    for (stderr, stdout) in [
        (Broken::Gone, Broken::Gone),
        (Broken::Full, Broken::Full),
        (Broken::Closed, Broken::Closed),
    ] {
        let out = work.path().join(format!("{stderr:?}"));
        let flags = [
            "simulate",
            "--scenario",
            SCENE,
            "--planner",
            "log-replay",
            "--out",
        ];
        let status = run(
            &[&flags[..], &[out.to_str().unwrap()]].concat(),
            Some(stderr),
            Some(stdout),
        );
        assert!([Some(0), Some(2)].contains(&status.code()), "{status}");
        assert!(fs::metadata(out.join("summary.json")).unwrap().len() > 100);
    }
}

/// A limit of the size of files (`ulimit -f`) sends a signal that ends a program.
#[test]
fn a_file_beyond_the_limit_of_the_system_is_an_error_of_the_write() {
    let work = TempDir::new().unwrap();
    let script = "ulimit -f 8; exec \"$0\" \"$@\"";
    let mut limited = Command::new("sh");
    limited
        .args(["-c", script])
        .arg(planagent().get_program())
        .args(["simulate", "--scenario", SCENE, "--planner", "idm"])
        .args(["--out", "run"])
        .current_dir(work.path());
    let output = limited.output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("cannot write"), "{stderr}");
}

#[test]
fn more_threads_than_the_limit_are_refused_by_the_variable() {
    let mut command = Command::new(planagent().get_program());
    let output = command
        .args(["scenarios", "list"])
        .env("RAYON_NUM_THREADS", "99999")
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("RAYON_NUM_THREADS is 99999"), "{stderr}");
}
