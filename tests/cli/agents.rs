//! Other agents that a command controls: `--agents exec:COMMAND`.

use super::exec::{python, rows, script};
use super::{SCENE, read_json, refused, run};
use crate::outside::Needy;
use crate::runner::simulations;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/exec_agents.py");
/// An agent policy that replays the log.
const REPLAY: &str = "for line in sys.stdin:\n    print('{\"type\": \"ready\"}' if '\"initialize\"' in line[:30] else '{\"type\": \"agents\", \"objects\": []}', flush=True)\n";

#[test]
fn agents_that_are_left_out_follow_the_log_and_the_policy_stands_in_the_place_of_the_challenge()
-> Needy {
    let work = TempDir::new().unwrap();
    let command = script(work.path(), "replay.py", REPLAY)?;
    let out = work.path().join("run");
    let agents = format!("replay=exec:{command}");
    let flags = [
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        "pdm-closed",
        "--challenge",
        "nonreactive",
    ];
    let (code, stdout, stderr) = run(&[
        &flags[..],
        &["--agents", &agents, "--out", out.to_str().unwrap()],
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.contains("replay = agents under the policy replay: no challenge of nuPlan"),
        "{stdout}"
    );
    let rows = rows(&out);
    let of = |challenge: &str| {
        rows.iter()
            .find(|row| row["challenge"] == challenge)
            .unwrap()
            .clone()
    };
    let (log, own) = (
        of("closed_loop_nonreactive_agents"),
        of("closed_loop_own_agents_replay"),
    );
    assert_eq!(log["score"], own["score"]);
    assert!(own["score"].is_number());
    let manifest: toml::Table = fs::read_to_string(out.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(
        manifest["agents"]["replay"].as_str(),
        Some(command.as_str())
    );
    assert!(
        out.join("closed_loop_own_agents_replay/runner_report.parquet")
            .is_file()
    );
    let (code, _, stderr) = run(&["report", out.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let png = work.path().join("frame.png");
    let frame = [
        "render",
        out.to_str().unwrap(),
        "--challenge",
        "replay",
        "--png",
        png.to_str().unwrap(),
        "--at",
        "5",
    ];
    let (code, _, stderr) = run(&frame);
    assert_eq!(code, 0, "{stderr}");
    Ok(())
}

/// An agent policy that has everything a kilometer away.
const AWAY: &str = "\
for message in map(json.loads, sys.stdin):
    if message['type'] == 'initialize':
        ready()
        continue
    keys = ('track', 'y', 'heading', 'velocity')
    away = [{'x': one['x'] + 1000, **{key: one[key] for key in keys}} for one in message['logged']]
    print(json.dumps({'type': 'agents', 'objects': away}), flush=True)
";

#[test]
fn agents_are_where_the_command_has_them() -> Needy {
    let work = TempDir::new().unwrap();
    let command = script(work.path(), "away.py", AWAY)?;
    let out = work.path().join("run");
    let agents = format!("away=exec:{command}");
    let flags = [
        "simulate",
        "--scenario",
        "generated/stopping_with_lead/1",
        "--planner",
        "simple",
        "--challenge",
        "nonreactive",
    ];
    let (code, _, stderr) = run(&[
        &flags[..],
        &["--agents", &agents, "--out", out.to_str().unwrap()],
    ]
    .concat());
    assert_eq!(code, 0, "{stderr}");
    let rows = rows(&out);
    let score = |place: usize| rows[place]["score"].as_f64().unwrap();
    // The planner drives straight ahead, into the lead of the recording.
    assert!(score(0) == 0.0 && score(1) > 0.5, "{rows:?}");
    Ok(())
}

#[test]
fn the_example_runs_and_gives_the_same_twice() -> Needy {
    let python = python()?;
    let work = TempDir::new().unwrap();
    let [one, two] = ["one", "two"].map(|name| work.path().join(name));
    let agents = format!("exec:{python} {EXAMPLE}");
    for out in [&one, &two] {
        let flags = [
            "simulate",
            "--scenario",
            "generated/stopping_with_lead/1",
            SCENE,
            "--planner",
            "simple",
            "--agents",
        ];
        let (code, _, stderr) =
            run(&[&flags[..], &[&agents, "--out", out.to_str().unwrap()]].concat());
        assert_eq!(code, 0, "{stderr}");
    }
    assert_eq!(
        fs::read(one.join("summary.json")).unwrap(),
        fs::read(two.join("summary.json")).unwrap()
    );
    let rows = rows(&one);
    assert!(
        rows.iter()
            .all(|row| row["challenge"] == "closed_loop_own_agents_exec-exec_agents"),
        "{rows:?}"
    );
    assert!(
        rows.iter()
            .all(|row| row["succeeded"] == true && row["score"].is_number()),
        "{rows:?}"
    );
    Ok(())
}

/// Simulates with agents that must fail; gives the error of the simulation.
fn failing(work: &Path, command: &str) -> String {
    let out = work.join("run");
    let _ = fs::remove_dir_all(&out);
    let agents = format!("wrong=exec:{command}");
    let flags = [
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        "simple",
        "--agents",
        &agents,
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
    rows(&out)[0]["error"].as_str().unwrap().to_owned()
}

#[test]
fn agents_that_are_dead_silent_or_wrong_fail_their_simulation() {
    let work = TempDir::new().unwrap();
    let ready = "echo '{\"type\": \"ready\"}'";
    let dead = failing(work.path(), "echo 'no such module' >&2; exit 3");
    assert!(
        dead.contains("the command ended (exit status: 3)") && dead.contains("no such module"),
        "{dead}"
    );
    assert!(
        dead.contains("the other agents cannot be moved to iteration 1"),
        "{dead}"
    );
    let silent = failing(work.path(), &format!("{ready}; cat > /dev/null"));
    assert!(silent.contains("gave no answer within 1 s"), "{silent}");
    let answer = |line: &str| {
        failing(
            work.path(),
            &format!("read first; {ready}; read step; echo '{line}'; cat > /dev/null"),
        )
    };
    let planner = answer("{\"type\": \"trajectory\", \"states\": []}");
    assert!(planner.contains("another message than agents"), "{planner}");
    let unknown = answer(
        "{\"type\": \"agents\", \"objects\": [{\"track\": 4000000, \"x\": 0, \"y\": 0, \"heading\": 0, \"velocity\": [0, 0]}]}",
    );
    assert!(
        unknown.contains("track 4000000 is neither in objects nor in logged"),
        "{unknown}"
    );
    let error = answer("{\"type\": \"error\", \"message\": \"no idea\"}");
    assert!(error.contains("the command says: no idea"), "{error}");
}

#[test]
fn a_run_never_starts_agents_that_were_not_given_again() -> Needy {
    let work = TempDir::new().unwrap();
    let marker = work.path().join("started");
    let lines = format!(
        "open({:?}, 'a').write('x')\n{REPLAY}",
        marker.display().to_string()
    );
    let command = script(work.path(), "marking.py", &lines)?;
    let out = work.path().join("run");
    let folder = out.to_str().unwrap();
    let agents = format!("exec:{command}");
    let scene = [
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        "simple",
        "--out",
        folder,
        "--agents",
        &agents,
    ];
    assert_eq!(run(&scene).0, 0);
    let starts = || fs::read_to_string(&marker).unwrap().len();
    assert_eq!(starts(), 1);
    let score = read_json(&out.join("summary.json"))["scenarios"][0]["score"].clone();
    for name in ["summary.json", "timing.json"] {
        fs::remove_file(out.join(name)).unwrap();
    }
    fs::remove_dir_all(&simulations(&out)[0]).unwrap();
    let error = refused(&["simulate", "--resume", folder]);
    assert!(
        error.contains("never starts by itself") && error.contains("--agents 'exec-marking=exec:"),
        "{error}"
    );
    let other = refused(&[
        "simulate",
        "--resume",
        folder,
        "--agents",
        "exec-marking=exec:true",
    ]);
    assert!(other.contains("agents.exec-marking: was"), "{other}");
    assert_eq!(starts(), 1, "a command was started without being given");
    assert_eq!(
        run(&["simulate", "--resume", folder, "--agents", &agents]).0,
        0
    );
    assert_eq!(
        (
            starts(),
            &read_json(&out.join("summary.json"))["scenarios"][0]["score"]
        ),
        (2, &score)
    );
    Ok(())
}

#[test]
fn a_word_that_is_no_command_says_what_to_write() {
    let idm = refused(&["simulate", "--agents", "idm"]);
    assert!(
        idm.contains("'idm' is no command") && idm.contains("--challenge nonreactive and reactive"),
        "{idm}"
    );
    let reserved = refused(&["simulate", "--agents", "reactive=exec:true"]);
    assert!(
        reserved.contains("'reactive' is the name of a challenge"),
        "{reserved}"
    );
}
