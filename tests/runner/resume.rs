//! A killed run is resumed: no simulation is lost or repeated, and the result is that of an
//! uninterrupted run.

use super::{assert_same_results, quick_run, simulations};
use crate::cli::{planagent, read_json, refused, run};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};
use tempfile::TempDir;

/// Scenes of the killed run; four simulations each.
const SCENES: usize = 5;
/// Simulations of that run.
const SIMULATIONS: usize = 4 * SCENES;

fn strings(flags: &[String]) -> Vec<&str> {
    flags.iter().map(String::as_str).collect()
}

/// Starts the program and does not wait for it.
pub(crate) fn spawn(flags: &[&str]) -> Child {
    let program = planagent();
    let mut command = Command::new(program.get_program());
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    command
        .args(flags)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// When each simulation's record was written.
pub(crate) fn written(run: &Path) -> BTreeMap<PathBuf, SystemTime> {
    let record = |folder: PathBuf| {
        let time = fs::metadata(folder.join("record.toml"))
            .unwrap()
            .modified()
            .unwrap();
        (folder, time)
    };
    simulations(run).into_iter().map(record).collect()
}

/// Kills `child` (SIGKILL) as soon as `moment` has come; says whether it was still alive.
pub(crate) fn kill_when(mut child: Child, moment: impl Fn() -> bool) -> bool {
    let patience = Instant::now();
    while !moment() && child.try_wait().unwrap().is_none() {
        assert!(
            patience.elapsed() < Duration::from_mins(5),
            "the moment never came"
        );
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
    let (code, _, stderr) =
        run(&[&strings(&flags)[..], &["--out", whole.to_str().unwrap()]].concat());
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(simulations(&whole).len(), SIMULATIONS);

    let begin = [&strings(&flags)[..], &["--out", killed.to_str().unwrap()]].concat();
    let resume = ["simulate", "--resume", killed.to_str().unwrap(), "--quiet"];
    // Without a manifest, the run has to start again.
    kill_when(spawn(&begin), || killed.is_dir());
    if !killed.join("manifest.toml").is_file() {
        let nothing = refused(&resume);
        assert!(nothing.contains("holds no run"), "{nothing}");
        kill_when(spawn(&begin), || killed.join("manifest.toml").is_file());
    }
    let mut before = BTreeMap::new();
    let mut kills = 0;
    let halfway = |count: usize| move |run: &Path| super::simulations(run).len() >= count;
    for goal in [1, 2, 7, 12, SIMULATIONS - 1, SIMULATIONS] {
        kills += usize::from(kill_when(spawn(&resume), || halfway(goal)(&killed)));
        let now = written(&killed);
        assert!(
            before
                .iter()
                .all(|(folder, time)| now.get(folder) == Some(time)),
            "a simulation was lost or repeated"
        );
        before = now;
    }
    assert!(kills >= 4, "only {kills} kills came in time");
    let (code, _, stderr) = run(&resume);
    assert_eq!(code, 0, "{stderr}");
    let after = written(&killed);
    assert_eq!(after.len(), SIMULATIONS);
    assert!(
        before
            .iter()
            .all(|(folder, time)| after.get(folder) == Some(time)),
        "a simulation was repeated"
    );
    assert_same_results(&whole, &killed);
    let leftovers = fs::read_dir(killed.join("simulations")).unwrap().count() - SIMULATIONS;
    assert_eq!(leftovers, 0, "unfinished simulations are left behind");

    // Resuming a run that has ended changes nothing.
    assert_eq!(run(&resume).0, 0);
    assert_same_results(&whole, &killed);
}

#[test]
fn a_run_is_resumed_only_as_it_was_started() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    let flags = [
        "simulate",
        "--scenario",
        "generated/changing_lane/3",
        "--planner",
        "log-replay",
        "--quiet",
    ];
    assert_eq!(
        run(&[&flags[..], &["--out", folder, "--seed", "7"]].concat()).0,
        0
    );

    let resumed = |more: &[&str]| refused(&[&["simulate", "--resume", folder], more].concat());
    let seed = resumed(&["--seed", "8"]);
    assert!(seed.contains("config.seed: was 7, is 8"), "{seed}");
    let planner = resumed(&["--planner", "idm"]);
    assert!(
        planner.contains("planners: was log-replay, is idm"),
        "{planner}"
    );
    let challenge = resumed(&["--challenge", "both"]);
    assert!(
        challenge.contains("challenges: was closed_loop_nonreactive_agents, is closed"),
        "{challenge}"
    );
    let scenarios = resumed(&["--scenario", "generated/changing_lane/4"]);
    assert!(scenarios.contains("scenarios.blake3: was"), "{scenarios}");
    let config = work.path().join("other.toml");
    fs::write(&config, "[reflection]\nthreshold = 0.5\n").unwrap();
    let configured = resumed(&["--config", config.to_str().unwrap()]);
    assert!(
        configured.contains("config.reflection.threshold: was 0.75, is 0.5"),
        "{configured}"
    );

    // The same flags once more, or none at all, are as it was started; its own configuration is the
    // default then.
    assert_eq!(
        run(&[&flags[..], &["--resume", folder, "--seed", "7"]].concat()).0,
        0
    );
    let (code, stdout, _) = run(&["simulate", "--resume", folder, "--json"]);
    assert_eq!(code, 0);
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(&stdout).unwrap(),
        read_json(&out.join("summary.json"))
    );

    let again = refused(&[&flags[..], &["--out", folder]].concat());
    assert!(again.contains("--resume"), "{again}");
    let nowhere = refused(&[
        "simulate",
        "--resume",
        work.path().join("nowhere").to_str().unwrap(),
    ]);
    assert!(nowhere.contains("there is no such folder"), "{nowhere}");

    // A record of another simulation is refused.
    let record = simulations(&out)[0].join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    fs::write(&record, text.replace("changing_lane/3", "changing_lane/5")).unwrap();
    let foreign = refused(&["simulate", "--resume", folder]);
    assert!(
        foreign.contains("changing_lane/5 by log-replay") && foreign.contains("record.toml"),
        "{foreign}"
    );
    // The simulation of a damaged record is repeated.
    fs::write(&record, &text[..text.len() / 2]).unwrap();
    let (code, _, stderr) = run(&["simulate", "--resume", folder]);
    assert!(code == 0 && stderr.contains("is damaged"), "{stderr}");
    // A run of another format version is refused by name.
    let manifest = fs::read_to_string(out.join("manifest.toml")).unwrap();
    fs::write(
        out.join("manifest.toml"),
        manifest.replace("format_version = 2\n", "format_version = 1\n"),
    )
    .unwrap();
    let old = refused(&["simulate", "--resume", folder]);
    assert!(
        old.contains("has format version 1, this program reads version 2"),
        "{old}"
    );
    assert_eq!(
        refused(&["report", folder]).replace('\n', ""),
        old.replace('\n', "")
    );
    // So are results of another version,
    fs::write(
        out.join("manifest.toml"),
        manifest.replace("result_version = ", "result_version = 9"),
    )
    .unwrap();
    let other = refused(&["simulate", "--resume", folder]);
    assert!(other.contains("result_version: was 9"), "{other}");
    // and a manifest that cannot be read, with its place.
    fs::write(
        out.join("manifest.toml"),
        "format_version = 2\nplanagent = 1\n",
    )
    .unwrap();
    let manifest = refused(&["simulate", "--resume", folder]);
    assert!(
        manifest.contains("manifest.toml") && manifest.contains("line 2"),
        "{manifest}"
    );
}

#[test]
fn two_processes_do_not_share_a_folder() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = quick_run(SCENES);
    let mut first = spawn(&[&strings(&flags)[..], &["--out", out.to_str().unwrap()]].concat());
    let patience = Instant::now();
    while simulations(&out).is_empty() {
        assert!(
            patience.elapsed() < Duration::from_mins(2),
            "no simulation came"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
    let second = refused(&["simulate", "--resume", out.to_str().unwrap()]);
    assert!(second.contains("another process"), "{second}");
    first.kill().unwrap();
    first.wait().unwrap();
}
