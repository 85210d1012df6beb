//! A run that was killed is gone on with: nothing lost, nothing twice, the same files at the end.

use super::{assert_same_results, drives, quick_run};
use crate::cli::{planagent, read_json, refused, run};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};
use tempfile::TempDir;

/// Scenes of the run that is killed; four drives each.
const SCENES: usize = 5;
/// Drives of that run.
const DRIVES: usize = 4 * SCENES;

fn strings(flags: &[String]) -> Vec<&str> {
    flags.iter().map(String::as_str).collect()
}

/// Starts the program and does not wait for it.
pub(crate) fn spawn(flags: &[&str]) -> Child {
    let program = planagent();
    let mut command = Command::new(program.get_program());
    for (name, value) in program.get_envs() {
        command.env(name, value.unwrap());
    }
    command.args(flags).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// When each drive's record was written.
pub(crate) fn written(run: &Path) -> BTreeMap<PathBuf, SystemTime> {
    let record = |drive: PathBuf| {
        let time = fs::metadata(drive.join("record.toml")).unwrap().modified().unwrap();
        (drive, time)
    };
    drives(run).into_iter().map(record).collect()
}

/// Kills `child` (SIGKILL) as soon as `moment` has come; says whether it was still alive.
pub(crate) fn kill_when(mut child: Child, moment: impl Fn() -> bool) -> bool {
    let patience = Instant::now();
    while !moment() && child.try_wait().unwrap().is_none() {
        assert!(patience.elapsed() < Duration::from_secs(300), "the moment never came");
        std::thread::sleep(Duration::from_millis(2));
    }
    let alive = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    alive
}

#[test]
fn a_run_that_is_killed_again_and_again_ends_like_one_that_is_not() {
    let work = TempDir::new().unwrap();
    let [whole, killed] = ["whole", "killed"].map(|name| work.path().join(name));
    let flags = quick_run(SCENES);
    let (code, _, stderr) = run(&[&strings(&flags)[..], &["--out", whole.to_str().unwrap()]].concat());
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(drives(&whole).len(), DRIVES);

    let begin = [&strings(&flags)[..], &["--out", killed.to_str().unwrap()]].concat();
    let go_on = ["simulate", "--resume", killed.to_str().unwrap(), "--quiet"];
    // Before the manifest is there, the run has to be begun again.
    kill_when(spawn(&begin), || killed.is_dir());
    if !killed.join("manifest.toml").is_file() {
        let nothing = refused(&go_on);
        assert!(nothing.contains("holds no run"), "{nothing}");
        kill_when(spawn(&begin), || killed.join("manifest.toml").is_file());
    }
    let mut before = BTreeMap::new();
    let mut kills = 0;
    let halfway = |drives: usize| move |run: &Path| super::drives(run).len() >= drives;
    for goal in [1, 2, 7, 12, DRIVES - 1, DRIVES] {
        kills += usize::from(kill_when(spawn(&go_on), || halfway(goal)(&killed)));
        let now = written(&killed);
        assert!(before.iter().all(|(drive, time)| now.get(drive) == Some(time)), "a drive was lost or made twice");
        before = now;
    }
    assert!(kills >= 4, "only {kills} kills came in time");
    let (code, _, stderr) = run(&go_on);
    assert_eq!(code, 0, "{stderr}");
    let after = written(&killed);
    assert_eq!(after.len(), DRIVES);
    assert!(before.iter().all(|(drive, time)| after.get(drive) == Some(time)), "a drive was made twice");
    assert_same_results(&whole, &killed);
    let leftovers = fs::read_dir(killed.join("simulations")).unwrap().count() - DRIVES;
    assert_eq!(leftovers, 0, "unfinished drives are left behind");

    // Going on with a run that has ended changes nothing.
    assert_eq!(run(&go_on).0, 0);
    assert_same_results(&whole, &killed);
}

#[test]
fn a_run_is_gone_on_with_only_as_it_was_started() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    let flags = ["simulate", "--scenario", "generated/changing_lane/3", "--planner", "log-replay", "--quiet"];
    assert_eq!(run(&[&flags[..], &["--out", folder, "--seed", "7"]].concat()).0, 0);

    let resumed = |more: &[&str]| refused(&[&["simulate", "--resume", folder], more].concat());
    let seed = resumed(&["--seed", "8"]);
    assert!(seed.contains("config.seed: was 7, is 8"), "{seed}");
    let planner = resumed(&["--planner", "idm"]);
    assert!(planner.contains("planners: was log-replay, is idm"), "{planner}");
    let challenge = resumed(&["--challenge", "both"]);
    assert!(challenge.contains("challenges: was closed_loop_nonreactive_agents, is closed"), "{challenge}");
    let scenarios = resumed(&["--scenario", "generated/changing_lane/4"]);
    assert!(scenarios.contains("scenarios.blake3: was"), "{scenarios}");
    let config = work.path().join("other.toml");
    fs::write(&config, "[reflection]\nthreshold = 0.5\n").unwrap();
    let configured = resumed(&["--config", config.to_str().unwrap()]);
    assert!(configured.contains("config.reflection.threshold: was 0.75, is 0.5"), "{configured}");

    // The same flags once more, or none at all, are as it was started; its own configuration is the default then.
    assert_eq!(run(&[&flags[..], &["--resume", folder, "--seed", "7"]].concat()).0, 0);
    let (code, stdout, _) = run(&["simulate", "--resume", folder, "--json"]);
    assert_eq!(code, 0);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&stdout).unwrap(), read_json(&out.join("summary.json")));

    let again = refused(&[&flags[..], &["--out", folder]].concat());
    assert!(again.contains("--resume"), "{again}");
    let nowhere = refused(&["simulate", "--resume", work.path().join("nowhere").to_str().unwrap()]);
    assert!(nowhere.contains("holds no run"), "{nowhere}");

    // A record of another drive is no record of this one.
    let record = drives(&out)[0].join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    fs::write(&record, text.replace("changing_lane/3", "changing_lane/5")).unwrap();
    let foreign = refused(&["simulate", "--resume", folder]);
    assert!(foreign.contains("changing_lane/5 by log-replay") && foreign.contains("record.toml"), "{foreign}");
    // A damaged one is made again.
    fs::write(&record, &text[..text.len() / 2]).unwrap();
    let (code, _, stderr) = run(&["simulate", "--resume", folder]);
    assert!(code == 0 && stderr.contains("is damaged"), "{stderr}");
    // So is a manifest that cannot be read refused with its place.
    fs::write(out.join("manifest.toml"), "planagent = 1\n").unwrap();
    let manifest = refused(&["simulate", "--resume", folder]);
    assert!(manifest.contains("manifest.toml") && manifest.contains("line 1"), "{manifest}");
}

#[test]
fn two_processes_do_not_share_a_folder() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = quick_run(SCENES);
    let mut first = spawn(&[&strings(&flags)[..], &["--out", out.to_str().unwrap()]].concat());
    let patience = Instant::now();
    while drives(&out).is_empty() {
        assert!(patience.elapsed() < Duration::from_secs(120), "no drive came");
        std::thread::sleep(Duration::from_millis(2));
    }
    let second = refused(&["simulate", "--resume", out.to_str().unwrap()]);
    assert!(second.contains("another process"), "{second}");
    first.kill().unwrap();
    first.wait().unwrap();
}
