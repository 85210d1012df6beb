//! Errors as users read them.

use super::{planagent, run};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs in a folder without data of nuPlan; gives the exit code and stderr.
fn error(folder: &Path, arguments: &[&str]) -> (i32, String) {
    let mut command = planagent();
    for variable in [
        "NUPLAN_DATA_ROOT",
        "NUPLAN_MAPS_ROOT",
        "NUPLAN_SPLITS_ROOT",
        "PLANAGENT_DATA",
    ] {
        command.env_remove(variable);
    }
    let output = command
        .args(arguments)
        .current_dir(folder)
        .env("COLUMNS", "80")
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let models = concat!(env!("CARGO_MANIFEST_DIR"), "/models");
    (
        output.status.code().unwrap(),
        text.replace(models, "[MODELS]")
            .replace(folder.to_str().unwrap(), "[FOLDER]"),
    )
}

/// What is mistyped or does not exist.
const WRONG: &[&[&str]] = &[
    &["simulat"],
    &["simulate", "--plannr", "idm"],
    &["simulate", "--planner", "imd"],
    &["simulate", "--planner", "telepathy"],
    &["simulate", "--planner", "exec:"],
    &["simulate", "--planner", "idm=exec:true"],
    &["simulate", "--model", "nanoo"],
    &["simulate", "--split", "generated-test14-hrad"],
    &["simulate", "--split", "val14"],
    &["simulate", "--scenario", "val14"],
    &["simulate", "--split", "generated/changing_lane/3"],
    &["simulate", "--scenario", "generated/chaning_lane/3"],
    &["simulate", "--scenario", "nowhere.tfrecord"],
    &["simulate", "--scenario", "generated/changing_lane/3~nudge"],
    &["simulate", "--type", "chaning_lane"],
    &["simulate", "--scenario", "notes.txt"],
    &["simulate", "--model", "nowhere.gguf"],
    &["simulate", "--limit", "0"],
    &["simulate", "--limit", "-1"],
    &["simulate", "--seed", "-1"],
    &[
        "simulate",
        "--planner",
        "idm",
        "--checkpoint",
        "plantf=nowhere.ckpt",
    ],
    &[
        "simulate",
        "--scenario",
        "generated/changing_lane/2~a/k.toml",
        "generated/changing_lane/2~b/k.toml",
    ],
    &["simulate", "--shard", "3/2"],
    &["simulate", "--challenge", "reactiv"],
    &["simulate", "--planner", "simple", "--exec-timeout", "0"],
    &["simulate", "--set", "reflection.treshold=0.5"],
    &["simulate", "--set", "threshold"],
    &["simulate", "--set", "reflection.threshold=high"],
    &["simulate", "--set", "reflection.threshold=7"],
    &["simulate", "--csv", "--json"],
    &["simulate", "--seed", "9223372036854775808"],
    &["bench", "nano", "--iterations", "18446744073709551615"],
    &["plan", "--prompt-set", "nowhere"],
    &["ask", "What is ahead?", "--set", "environment.bev=false"],
    &["scenarios", "generate", "--type", "chaning_lane"],
    &[
        "scenarios",
        "generate",
        "--from",
        "18446744073709551615",
        "--count",
        "2",
    ],
    &["scenarios", "list", "--modify", "low_traffic_density"],
    &[
        "scenarios",
        "statistics",
        "generated/changing_lane/0",
        "generated/changing_lane/1",
        "--modify",
        "nowhere.toml",
    ],
    &[
        "dataset",
        "--out",
        "data",
        "--modify",
        "low_traffic_density",
    ],
    &[
        "dataset",
        "--out",
        "data",
        "--for",
        "imitation",
        "--twins",
        "2",
    ],
    &["experiment", "main", "--quick"],
    &["study", "foo"],
    &["study", "scenario-type"],
    &["study", "recorded"],
    &["study", "taken.toml"],
    &["study", "setting.toml"],
    &["study", "planner.toml"],
    &["study", "controls", "--out", "theirs"],
    &["card", "--out", "theirs"],
    &["memory", "fill", "agent-driver", "--out", "notes.txt"],
    &["models", "fetch", "nnao"],
    &["report"],
    &["report", "nowhere"],
    &["render", "nowhere", "--png", "sheet.png"],
    &["render", "--gif", "film.mp4"],
    &["render", "--gif", "film.gif", "--at", "3"],
    &["compare", "one", "two"],
    &["merge"],
    &["completions", "csh"],
];

/// A study of a user.
const STUDY: &str = "
name = 'mine'
title = 'A threshold'
labels = ['threshold']
suites = ['generated-test14']
[[variants]]
labels = ['0.5']
planner = 'idm'
settings.reflection.threshold = 0.5
";

#[test]
fn errors_are_as_reviewed() {
    let work = TempDir::new().unwrap();
    fs::write(work.path().join("notes.txt"), "no recording").unwrap();
    for folder in ["a", "b"] {
        fs::create_dir(work.path().join(folder)).unwrap();
        fs::write(
            work.path().join(folder).join("k.toml"),
            "[[cones]]\nahead_m = 30.0\n",
        )
        .unwrap();
    }
    for (name, changed) in [
        ("taken", ("mine", "controls")),
        ("setting", ("reflection.threshold", "reflection.treshold")),
        ("planner", ("idm", "idmm")),
    ] {
        let text = STUDY.replace(changed.0, changed.1);
        fs::write(work.path().join(format!("{name}.toml")), text).unwrap();
    }
    fs::create_dir_all(work.path().join("theirs/controls")).unwrap();
    for file in ["controls/results.md", "card.md"] {
        fs::write(work.path().join("theirs").join(file), "notes").unwrap();
    }
    let mut text = String::new();
    for arguments in WRONG {
        let (code, error) = error(work.path(), arguments);
        assert_eq!(code, 2, "{arguments:?}: {error}");
        assert!(!error.contains("panicked"), "{error}");
        writeln!(text, "$ planagent {}\n{error}", arguments.join(" ")).unwrap();
    }
    insta::with_settings!({prepend_module_to_snapshot => false}, {
        insta::assert_snapshot!("errors", text);
    });
}

#[test]
fn every_error_quotes_names_alike() {
    let work = TempDir::new().unwrap();
    for (arguments, quoted) in [
        (&["simulate", "--planner", "imd"][..], "'imd'"),
        (&["simulate", "--split", "vl14"], "'vl14'"),
        (
            &["simulate", "--scenario", "generated/flying/1"],
            "'flying'",
        ),
        (&["study", "foo"], "'foo'"),
        (&["simulate", "--type", "flying"], "'flying'"),
    ] {
        let (_, error) = error(work.path(), arguments);
        assert!(error.contains(quoted), "{error}");
    }
}

/// Files of a model that nobody named may be absent; a broken folder is a fault.
#[test]
fn a_check_of_all_models_fails_for_broken_ones_only() {
    let (cache, models) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let check = |names: &[&str]| {
        let mut command = planagent();
        command.args(["models", "check"]).args(names);
        let output = command
            .env("HF_HOME", cache.path())
            .env("PLANAGENT_MODELS", models.path())
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stdout).unwrap(),
        )
    };
    let describe = |name: &str| {
        let text =
            format!("name = '{name}'\nprompt_set = 'compact'\nsource = {{ folder = '{name}' }}\n");
        fs::write(models.path().join(format!("{name}.toml")), text).unwrap();
    };
    describe("nowhere");
    let (code, text) = check(&[]);
    assert_eq!(code, Some(0), "{text}");
    assert!(
        text.contains("nano: llava") && text.contains("can be opened"),
        "{text}"
    );
    let fetched =
        "llava-1.5-7b: not on this machine; `planagent models fetch llava-1.5-7b` downloads it";
    assert!(
        text.contains(fetched) && text.contains("nowhere: not on this machine"),
        "{text}"
    );
    assert!(
        !text.contains("mllm.offline") && !text.contains("openai"),
        "{text}"
    );
    for named in ["llava-1.5-7b", "nowhere"] {
        assert_eq!(check(&[named]).0, Some(1), "{named}");
    }
    describe("broken");
    fs::create_dir(models.path().join("broken")).unwrap();
    let (code, text) = check(&[]);
    assert!(code == Some(1) && text.contains("config.json"), "{text}");
}

#[test]
fn a_quiet_run_with_a_dead_server_says_so() {
    let work = TempDir::new().unwrap();
    let description = work.path().join("dead.toml");
    let server = "name = 'dead'\nprompt_set = 'compact'\n[source]\nendpoint = 'http://127.0.0.1:9'\nmodel = 'none'\ngrammar = 'none'\nimage_size = 336\nretries = 0\n";
    fs::write(&description, server).unwrap();
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "-q",
        "--model",
        description.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, _, stderr) = run(&flags);
    assert_eq!(code, 2, "{stderr}");
    assert!(
        stderr.contains("the model 'dead' cannot be asked, so nothing is simulated")
            && stderr.contains("cannot connect"),
        "{stderr}"
    );
}

#[test]
fn an_unreadable_log_is_named_once() {
    let work = TempDir::new().unwrap();
    fs::create_dir(work.path().join("logs")).unwrap();
    let log = work.path().join("logs/broken.db");
    // Not a text, which would be passed over.
    fs::write(&log, b"\x01\x02 no database").unwrap();
    let exported = work.path().join("out");
    let good = [
        "scenarios",
        "export",
        "generated/changing_lane/3",
        "--format",
        "nuplan",
        "--out",
        exported.to_str().unwrap(),
    ];
    assert_eq!(run(&good).0, 0);
    let data = exported.join("data");
    let moved = fs::read_dir(&data)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .next()
        .unwrap();
    let from = if moved.is_dir() {
        fs::read_dir(&moved)
            .unwrap()
            .next()
            .unwrap()
            .unwrap()
            .path()
    } else {
        moved
    };
    fs::copy(&from, work.path().join("logs/good.db")).unwrap();
    let maps = exported.join("maps");
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "--planner",
        "simple",
        "--scenario",
        work.path().join("logs").to_str().unwrap(),
    ]
    .map(str::to_owned);
    let more = [
        "--maps-root",
        maps.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let arguments: Vec<&str> = flags.iter().map(String::as_str).chain(more).collect();
    let (code, _, stderr) = run(&arguments);
    assert_eq!(code, 1, "{stderr}");
    let failed = stderr
        .lines()
        .find(|line| line.starts_with("failed: "))
        .unwrap();
    assert_eq!(failed.matches("broken.db").count(), 1, "{failed}");
}
