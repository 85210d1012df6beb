//! Run folders and study folders of before, whose manifests have settings by their names of then.

use super::{simulations, written};
use crate::cli::{refused, run};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use toml::{Table, Value};

const SCENE: &str = "generated/changing_lane/3";

/// Gives a manifest the intervals in iterations, as programs of before wrote them.
fn write_as_before(run: &Path) {
    let file = run.join("manifest.toml");
    let mut manifest: Table = fs::read_to_string(&file).unwrap().parse().unwrap();
    let config = manifest["config"].as_table_mut().unwrap();
    for (old, new) in [
        ("interval", "interval_s"),
        ("blocked_interval", "blocked_interval_s"),
    ] {
        let seconds = config["agent"].as_table_mut().unwrap().remove(new).unwrap();
        let iterations = (seconds.as_float().unwrap() * 10.0).round() as i64;
        let reasoning = config["reasoning"].as_table_mut().unwrap();
        reasoning.insert(old.to_owned(), Value::Integer(iterations));
    }
    fs::write(&file, toml::to_string(&manifest).unwrap()).unwrap();
}

#[test]
fn a_run_of_before_is_resumed_reported_and_compared() {
    let work = TempDir::new().unwrap();
    let [old, new] = ["old", "new"].map(|name| work.path().join(name));
    let begin = |out: &Path| {
        let out = out.to_str().unwrap();
        let set = ["--set", "agent.interval_s=3.0"];
        let flags = ["simulate", "--scenario", SCENE, "--planner", "idm", "--out"];
        let (code, _, stderr) = run(&[&flags[..], &[out], &set].concat());
        assert_eq!(code, 0, "{stderr}");
    };
    begin(&old);
    begin(&new);
    write_as_before(&old);
    let summary = fs::read(old.join("summary.json")).unwrap();
    let (old, new) = (old.to_str().unwrap(), new.to_str().unwrap());

    let (code, _, stderr) = run(&["simulate", "--resume", old]);
    assert!(
        code == 0 && stderr.contains("1 of 1 simulations are completed"),
        "{stderr}"
    );
    assert_eq!(
        fs::read(Path::new(old).join("summary.json")).unwrap(),
        summary
    );
    let (code, _, stderr) = run(&["report", old]);
    assert_eq!(code, 0, "{stderr}");
    let (code, stdout, stderr) = run(&["compare", old, new]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("idm"), "{stdout}");

    // Another interval is another run, in the words of now.
    let file = work.path().join("other.toml");
    fs::write(&file, "[agent]\ninterval_s = 1.0\n").unwrap();
    let other = refused(&[
        "simulate",
        "--resume",
        old,
        "--config",
        file.to_str().unwrap(),
    ]);
    assert!(
        other.contains("config.agent.interval_s: was 3.0, is 1.0"),
        "{other}"
    );
}

#[test]
fn a_study_finds_the_runs_of_before_in_their_folder() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("experiments");
    let flags = ["study", "interval", "--suite", "recorded"];
    let flags = [&flags[..], &["--scenario", SCENE, "--out"]].concat();
    let flags = [&flags[..], &[out.to_str().unwrap()]].concat();
    let (code, stdout, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");
    let runs: Vec<_> = fs::read_dir(out.join("runs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    for run in &runs {
        write_as_before(run);
    }
    let times = || -> BTreeMap<_, _> { runs.iter().flat_map(|run| written(run)).collect() };
    let (before, total) = (
        times(),
        runs.iter().map(|run| simulations(run).len()).sum::<usize>(),
    );
    let (code, again, stderr) = run(&flags);
    assert!(
        code == 0 && stderr.contains(&format!("{total} are completed, 0 are left")),
        "{stderr}"
    );
    assert_eq!((again, times()), (stdout, before));
}

#[test]
fn a_setting_of_before_is_refused_with_its_name_of_now() {
    let work = TempDir::new().unwrap();
    let file = work.path().join("planagent.toml");
    fs::write(&file, "[reasoning]\nblocked_interval = 15\n").unwrap();
    let of_file = refused(&["config", "--config", file.to_str().unwrap()]);
    assert!(
        of_file.contains("line 2") && of_file.contains("write agent.blocked_interval_s = 1.5"),
        "{of_file}"
    );
    let study = work.path().join("own.toml");
    let text = "name = 'own'\ntitle = 'Own'\nlabels = ['a']\nsuites = ['recorded']\n\
        [[variants]]\nlabels = ['1']\nsettings = { reasoning = { interval = 10 } }\n";
    fs::write(&study, text).unwrap();
    for of_flags in [
        refused(&["simulate", "--set", "reasoning.interval=10"]),
        refused(&[
            "study",
            study.to_str().unwrap(),
            "--scenario",
            SCENE,
            "--out",
            work.path().to_str().unwrap(),
        ]),
    ] {
        assert!(
            of_flags.contains("write agent.interval_s = 1.0"),
            "{of_flags}"
        );
    }
}
