//! Planners that are commands: `--planner exec:COMMAND`.

use super::{SCENE, read_json, refused, run};
use crate::outside::{Missing, Needy};
use crate::runner::simulations;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/exec_planner.py");

/// A Python interpreter.
pub(super) fn python() -> Result<String, Missing> {
    crate::outside::python(&[])
}

/// A planner of some lines of Python.
pub(super) fn script(folder: &Path, name: &str, lines: &str) -> Result<String, Missing> {
    let path = folder.join(name);
    fs::write(
        &path,
        format!("import json, os, sys, time\nready = lambda: print('{{\"type\": \"ready\"}}', flush=True)\n{lines}"),
    )
    .unwrap();
    Ok(format!("{} {}", python()?, path.display()))
}

pub(super) fn rows(run: &Path) -> Vec<Value> {
    read_json(&run.join("summary.json"))["scenarios"]
        .as_array()
        .unwrap()
        .clone()
}

#[test]
fn a_command_plans_like_a_planner_of_ours() -> Needy {
    let python = python()?;
    let work = TempDir::new().unwrap();
    let [one, two] = ["one", "two"].map(|name| work.path().join(name));
    let planner = format!("idm,exec:{python} {EXAMPLE}");
    for out in [&one, &two] {
        let flags = [
            "simulate",
            "--scenario",
            "generated/changing_lane/5",
            "--challenge",
            "both",
            "--planner",
            &planner,
            "--out",
        ];
        let (code, stdout, stderr) = run(&[&flags[..], &[out.to_str().unwrap()]].concat());
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains("exec-exec_planner"), "{stdout}");
    }
    assert_eq!(
        fs::read(one.join("summary.json")).unwrap(),
        fs::read(two.join("summary.json")).unwrap()
    );
    let own: Vec<Value> = rows(&one)
        .into_iter()
        .filter(|row| row["planner"] == "exec-exec_planner")
        .collect();
    assert_eq!(own.len(), 2);
    assert!(
        own.iter()
            .all(|row| row["succeeded"] == true && row["score"].is_number()),
        "{own:?}"
    );
    let manifest: toml::Table = fs::read_to_string(one.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(
        manifest["commands"]["exec-exec_planner"].as_str(),
        Some(format!("{python} {EXAMPLE}").as_str())
    );
    let folder = simulations(&one)
        .into_iter()
        .find(|path| path.display().to_string().contains("exec-exec_planner"))
        .unwrap();
    let record: toml::Table = fs::read_to_string(folder.join("record.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let times = record["time"]["planner_s"].as_array().unwrap();
    assert!(
        times.len() == 150 && times.iter().all(|time| time.as_float().unwrap() > 0.0),
        "{}",
        times.len()
    );
    assert!(
        one.join("closed_loop_reactive_agents/runner_report.parquet")
            .is_file()
    );
    let (code, _, stderr) = run(&["report", one.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let png = work.path().join("frame.png");
    let frame = [
        "render",
        one.to_str().unwrap(),
        "2",
        "--png",
        png.to_str().unwrap(),
        "--at",
        "5",
        "--pixels",
        "160",
    ];
    assert_eq!(run(&frame).0, 0);
    Ok(())
}

/// Simulates with a command that must fail; gives the error of the simulation.
fn failing(work: &Path, command: &str) -> String {
    let out = work.join("run");
    let _ = fs::remove_dir_all(&out);
    let planner = format!("wrong=exec:{command}");
    let flags = [
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        &planner,
        "--exec-timeout",
        "1",
        "--out",
    ];
    let started = Instant::now();
    let (code, _, stderr) = run(&[&flags[..], &[out.to_str().unwrap()]].concat());
    assert_eq!(code, 1, "{stderr}");
    assert!(
        started.elapsed() < Duration::from_secs(30),
        "{:?}",
        started.elapsed()
    );
    assert!(stderr.contains("1 of 1 simulations failed"), "{stderr}");
    rows(&out)[0]["error"].as_str().unwrap().to_owned()
}

#[test]
fn a_command_that_is_dead_silent_or_wrong_fails_its_simulation() {
    let work = TempDir::new().unwrap();
    let dead = failing(work.path(), "echo 'no such module' >&2; exit 3");
    assert!(
        dead.contains("the command ended (exit status: 3)") && dead.contains("no such module"),
        "{dead}"
    );
    let unknown = failing(work.path(), "no-such-program-anywhere");
    assert!(
        unknown.contains("the command ended (exit status: 127)"),
        "{unknown}"
    );
    let chatty = failing(work.path(), "read first; echo hello; cat > /dev/null");
    assert!(
        chatty.contains("answered what is no message") && chatty.contains("hello"),
        "{chatty}"
    );
    let nan = failing(
        work.path(),
        "read first; echo '{\"type\": \"ready\"}'; read step; echo '{\"type\": \"trajectory\", \"states\": [{\"t\": 0.0, \"x\": NaN}]}'; cat > /dev/null",
    );
    assert!(
        nan.contains("states[0].x is NaN") && nan.contains("\"x\": NaN}"),
        "{nan}"
    );
    let far = failing(
        work.path(),
        "read first; echo '{\"type\": \"ready\"}'; read step; echo '{\"type\": \"trajectory\", \"states\": [\
         {\"t\": 0.0, \"x\": 9e5, \"y\": 0, \"heading\": 0, \"speed\": 0}, \
         {\"t\": 8.0, \"x\": 9e5, \"y\": 0, \"heading\": 0, \"speed\": 0}]}'; cat > /dev/null",
    );
    assert!(far.contains("away from the ego now"), "{far}");
    let early = failing(
        work.path(),
        "read first; echo '{\"type\": \"trajectory\", \"states\": []}'; cat > /dev/null",
    );
    assert!(early.contains("another message than ready"), "{early}");
    let silent = failing(
        work.path(),
        "read first; echo '{\"type\": \"ready\"}'; cat > /dev/null",
    );
    assert!(
        silent.contains("gave no answer within 1 s") && silent.contains("iteration 0"),
        "{silent}"
    );
    let empty = failing(
        work.path(),
        "read first; echo '{\"type\": \"ready\"}'; read step; echo '{\"type\": \"trajectory\", \"states\": []}'; cat > /dev/null",
    );
    assert!(empty.contains("at least 2 states"), "{empty}");
    let error = failing(
        work.path(),
        "read first; echo '{\"type\": \"error\", \"message\": \"no route\"}'; cat > /dev/null",
    );
    assert!(error.contains("the command says: no route"), "{error}");
}

/// Answers each step with a straight trajectory; `answers` says how often, by the number of the step.
fn straight(work: &Path, name: &str, answers: &str, end: &str) -> Result<String, Missing> {
    let lines = format!(
        "import math\nsys.stdin.readline()\nready()\nfor n, line in enumerate(sys.stdin):\n    ego = json.loads(line)['ego']\n    \
         v, h = ego['velocity'][0], ego['heading']\n    states = [{{'t': t / 2, 'x': ego['x'] + v * t / 2 * math.cos(h), \
         'y': ego['y'] + v * t / 2 * math.sin(h), 'heading': h, 'speed': v}} for t in range(17)]\n    \
         for _ in range({answers}):\n        print(json.dumps({{'type': 'trajectory', 'states': states}}), flush=True)\n{end}"
    );
    script(work, name, &lines)
}

#[test]
fn a_command_that_answers_ahead_or_too_often_fails_its_simulation() -> Needy {
    let work = TempDir::new().unwrap();
    let right = straight(work.path(), "right.py", "1", "")?;
    let (code, _, stderr) = run(&[
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        &format!("right=exec:{right}"),
        "--out",
        work.path().join("right").to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    for (name, answers) in [
        ("twice.py", "2"),
        ("once_too_often.py", "2 if n == 0 else 1"),
    ] {
        let error = failing(work.path(), &straight(work.path(), name, answers, "")?);
        // A line that comes late is taken for the next answer, until the plans leave the ego.
        let is_found = error.contains("wrote a line that answers no message")
            && error.contains("trajectory")
            || error.contains("away from the ego now");
        assert!(is_found, "{error}");
    }
    let late = straight(work.path(), "late.py", "2 if n == 148 else 1", "")?;
    let error = failing(work.path(), &late);
    assert!(
        error.contains("answers no message") || error.contains("after the answer to its last"),
        "{error}"
    );
    let goodbye = straight(
        work.path(),
        "goodbye.py",
        "1",
        "print('goodbye', flush=True)\n",
    )?;
    let error = failing(work.path(), &goodbye);
    assert!(
        error.contains("after the answer to its last message") && error.contains("goodbye"),
        "{error}"
    );
    Ok(())
}

#[test]
fn a_silent_command_is_ended_with_what_it_started() -> Needy {
    let work = TempDir::new().unwrap();
    let ids = work.path().join("ids");
    let lines = format!(
        "import subprocess\nchild = subprocess.Popen(['sleep', '600'])\n\
         open({:?}, 'w').write(f'{{os.getpid()}} {{child.pid}}')\nready()\ntime.sleep(600)\n",
        ids.display().to_string()
    );
    let command = script(work.path(), "silent.py", &lines)?;
    let error = failing(work.path(), &command);
    assert!(error.contains("gave no answer within 1 s"), "{error}");
    let alive = |id: &str| {
        let status = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        // A zombie is dead; its adopter has to reap it.
        !status.is_empty() && !status.contains(") Z ")
    };
    let ids = fs::read_to_string(&ids).unwrap();
    let patience = Instant::now();
    while ids.split(' ').any(alive) && patience.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(!ids.split(' ').any(alive), "{ids} are alive");
    Ok(())
}

#[test]
fn a_run_is_never_resumed_with_a_command_that_was_not_given_again() -> Needy {
    let work = TempDir::new().unwrap();
    let marker = work.path().join("started");
    let lines = format!(
        "open({:?}, 'a').write('x')\nready()\nsys.stdin.read()\n",
        marker.display().to_string()
    );
    let command = script(work.path(), "marking.py", &lines)?;
    let out: PathBuf = work.path().join("run");
    let folder = out.to_str().unwrap();
    let planner = format!("exec:{command}");
    let flags = ["--planner", &planner, "--exec-timeout", "0.5"];
    let scene = ["simulate", "--scenario", SCENE, "--out", folder];
    assert_eq!(run(&[&scene[..], &flags].concat()).0, 1);
    let starts = || fs::read_to_string(&marker).unwrap().len();
    assert_eq!(starts(), 1);
    // A run that has ended shows its results and starts nothing.
    let (code, _, stderr) = run(&["simulate", "--resume", folder]);
    assert!(
        code == 1 && stderr.contains("only its results are shown"),
        "{stderr}"
    );
    for name in ["summary.json", "timing.json"] {
        fs::remove_file(out.join(name)).unwrap();
    }
    fs::remove_dir_all(&simulations(&out)[0]).unwrap();
    let error = refused(&["simulate", "--resume", folder]);
    assert!(
        error.contains("exec-marking") && error.contains("never starts by itself"),
        "{error}"
    );
    let other = refused(&[
        "simulate",
        "--resume",
        folder,
        "--planner",
        "exec-marking=exec:true",
    ]);
    assert!(other.contains("commands.exec-marking: was"), "{other}");
    assert_eq!(starts(), 1, "a command was started without being given");
    assert_eq!(
        run(&[&["simulate", "--resume", folder], &flags[..]].concat()).0,
        1
    );
    assert_eq!(starts(), 2);
    Ok(())
}

#[test]
fn a_study_compares_a_command() -> Needy {
    let python = python()?;
    let work = TempDir::new().unwrap();
    let study = work.path().join("mine.toml");
    let text = format!(
        "name = 'mine'\ntitle = 'A command'\nlabels = ['planner']\nsuites = ['recorded']\n\
         [[variants]]\nlabels = ['idm']\nplanner = 'idm'\n\
         [[variants]]\nlabels = ['mine']\nplanner = 'mine=exec:{python} {EXAMPLE}'\n"
    );
    fs::write(&study, text).unwrap();
    let out = work.path().join("out");
    let flags = [
        "study",
        study.to_str().unwrap(),
        "--scenario",
        SCENE,
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, stdout, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("mine"), "{stdout}");
    assert!(!stderr.contains("0 simulations on"), "{stderr}");
    let results = fs::read_to_string(out.join("mine/results.md")).unwrap();
    assert!(
        results.contains(&format!("--scenario {SCENE}")),
        "{results}"
    );
    let (code, csv, _) = run(&[&flags[..], &["--csv", "--quiet"]].concat());
    assert_eq!((code, csv.lines().count()), (0, 5), "{csv}");
    assert!(csv.contains("mine,recorded,mine,"), "{csv}");
    Ok(())
}

#[test]
fn equal_failures_are_one_line_at_once_and_one_at_the_end() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "--split",
        "generated",
        "--limit",
        "5",
        "--challenge",
        "nonreactive",
        "--planner",
        "wrong=exec:read first; echo hello; cat > /dev/null",
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, _, stderr) = run(&flags);
    assert_eq!(code, 1, "{stderr}");
    assert_eq!(stderr.matches("hello").count(), 2, "{stderr}");
    assert!(
        stderr.contains("in the same way failed 4 more: ") && stderr.contains("and 1 more"),
        "{stderr}"
    );
    assert!(stderr.contains("5 of 5 simulations failed"), "{stderr}");
    assert_eq!(rows(&out).len(), 5);
}
