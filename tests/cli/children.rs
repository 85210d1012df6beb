//! Commands and programs that this one starts end with it, however it ends.

use super::{SCENE, planagent};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time after which a program that does nothing hangs.
const PATIENCE: Duration = Duration::from_mins(1);

/// Whether `what` becomes true in time.
fn soon(mut what: impl FnMut() -> bool) -> bool {
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        if what() {
            return true;
        }
        sleep(Duration::from_millis(20));
    }
    false
}

/// Whether a process runs; a zombie does not.
fn runs(number: &str) -> bool {
    if Path::new("/proc/self/stat").exists() {
        let stat = fs::read_to_string(format!("/proc/{number}/stat")).unwrap_or_default();
        return !stat.is_empty() && !stat.contains(") Z ");
    }
    signal("0", number)
}

/// Sends a signal by the shell's own `kill`; whether the process was there.
fn signal(name: &str, number: &str) -> bool {
    let command = format!("kill -{name} {number} 2>/dev/null");
    let status = Command::new("sh").args(["-c", &command]).status().unwrap();
    status.success()
}

/// Starts the program with these arguments, waits for the numbers that its children write to
/// `pids`, ends it by a signal, and checks that the children end.
fn ends_with(work: &Path, arguments: &[&str], path: Option<&Path>, name: &str) {
    let pids = work.join("pids");
    let _ = fs::remove_file(&pids);
    let mut command = Command::new(planagent().get_program());
    if let Some(path) = path {
        command.env("PATH", path);
    }
    let mut program = command
        .args(arguments)
        .current_dir(work)
        .env(
            "PLANAGENT_MODELS",
            concat!(env!("CARGO_MANIFEST_DIR"), "/models"),
        )
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut numbers = Vec::new();
    let written = soon(|| {
        let text = fs::read_to_string(&pids).unwrap_or_default();
        numbers = text.split_whitespace().map(str::to_owned).collect();
        numbers.len() >= 2 && text.ends_with('\n')
    });
    assert!(written, "{arguments:?}: no child began");
    assert!(numbers.iter().all(|number| runs(number)), "{arguments:?}");
    assert!(signal(name, &program.id().to_string()));
    let mut status = None;
    soon(|| {
        status = program.try_wait().unwrap();
        status.is_some()
    });
    let _ = program.kill();
    let status = status.unwrap_or_else(|| panic!("{arguments:?} does not end after {name}"));
    assert!(status.signal().is_some(), "{status}");
    let ended = soon(|| numbers.iter().all(|number| !runs(number)));
    for number in &numbers {
        signal("KILL", number);
    }
    assert!(ended, "{arguments:?} after {name}: children go on");
}

/// A script that reads nothing, with a process in the background, that runs for ever.
fn stubborn(work: &Path, name: &str, begin: &str) -> String {
    use std::os::unix::fs::PermissionsExt;
    let path = work.join(name);
    let pids = work.join("pids");
    let text = format!(
        "#!/bin/sh\n{begin}\nsleep 600 &\necho $! >> {pids}\necho $$ >> {pids}\nexec sleep 600\n",
        pids = pids.display()
    );
    fs::write(&path, text).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn commands_of_planners_and_agents_end_with_the_program() {
    let work = TempDir::new().unwrap();
    let command = stubborn(work.path(), "command", "echo '{\"type\": \"ready\"}'");
    let exec = format!("c=exec:{command}");
    for (name, more) in [
        ("INT", ["--planner", &exec]),
        ("TERM", ["--planner", &exec]),
        ("KILL", ["--planner", &exec]),
        ("KILL", ["--agents", &exec]),
    ] {
        let planner: &[&str] = if more[0] == "--agents" {
            &["--planner", "log-replay"]
        } else {
            &[]
        };
        let out = work.path().join("run");
        let _ = fs::remove_dir_all(&out);
        let flags = ["simulate", "--scenario", SCENE, "--exec-timeout", "300"];
        let all = [&flags[..], &more, planner, &["--out", "run", "-q"]].concat();
        ends_with(work.path(), &all, None, name);
    }
}

/// Who waits for the program sees no process of its commands afterwards, not even a zombie: what a
/// shell started is taken before the program ends.
#[cfg(target_os = "linux")]
#[test]
fn after_a_signal_no_process_of_a_command_is_left() {
    let work = TempDir::new().unwrap();
    let command = stubborn(work.path(), "command", "echo '{\"type\": \"ready\"}'");
    // The shell of the command goes on beside what it starts.
    let exec = format!("c=exec:{command}; true");
    let pids = work.path().join("pids");
    let mut program = Command::new(planagent().get_program())
        .args(["simulate", "--scenario", SCENE, "--planner", &exec])
        .args(["--exec-timeout", "300", "--out", "run", "-q"])
        .current_dir(work.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut numbers = String::new();
    assert!(soon(|| {
        numbers = fs::read_to_string(&pids).unwrap_or_default();
        numbers.lines().count() == 2 && numbers.ends_with('\n')
    }));
    assert!(signal("TERM", &program.id().to_string()));
    program.wait().unwrap();
    for number in numbers.split_whitespace() {
        assert!(!signal("0", number), "{number} is left");
    }
}

#[test]
fn a_film_encoder_ends_with_the_program() {
    let work = TempDir::new().unwrap();
    let (code, _, stderr) = super::run(&[
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        "log-replay",
        "--quiet",
        "--out",
        work.path().join("run").to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    let programs = work.path().join("programs");
    fs::create_dir(&programs).unwrap();
    let encoder = stubborn(work.path(), "encoder", "");
    fs::rename(encoder, programs.join("ffmpeg")).unwrap();
    let system = std::env::var_os("PATH").unwrap_or_default();
    let mut path = programs.clone().into_os_string();
    path.push(":");
    path.push(system);
    // A shell may start tests with an ignored SIGINT, which a program inherits.
    for name in ["TERM", "KILL"] {
        ends_with(
            work.path(),
            &["render", "run", "0", "--mp4", "film.mp4"],
            Some(Path::new(&path)),
            name,
        );
    }
}
