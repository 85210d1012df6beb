//! `--modify`, in each command that takes a scenario, and in runs.

use super::{planagent, read_json, refused, run};
use crate::runner::simulations;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const TEXT: &str = "[[remove]]\nvehicles = true\n\n[[stopped]]\nahead_m = 45\n\n[[jaywalker]]\nahead_m = 30\nfrom_left_m = -4\n\
    to_left_m = 4\ntrigger_m = 25\n";

#[test]
fn a_modified_run_knows_its_file_and_resumes() {
    let work = TempDir::new().unwrap();
    let (file, out) = (work.path().join("mine.toml"), work.path().join("run"));
    fs::write(&file, TEXT).unwrap();
    let (path, folder) = (file.to_str().unwrap(), out.to_str().unwrap());
    let flags = [
        "simulate",
        "--planner",
        "idm",
        "--challenge",
        "both",
        "--modify",
        path,
        "--out",
        folder,
    ];
    let (code, _, stderr) = run(&flags);
    assert_eq!(code, 0, "{stderr}");
    let summary = read_json(&out.join("summary.json"));
    assert_eq!(
        summary["scenarios"][0]["id"],
        "generated/changing_lane/2~mine"
    );
    assert_eq!(simulations(&out).len(), 2);
    let manifest: toml::Table = fs::read_to_string(out.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert!(
        manifest["inputs"]["data"][path]["blake3"]
            .as_str()
            .is_some(),
        "{manifest}"
    );

    let (code, _, stderr) = run(&["simulate", "--resume", folder]);
    assert!(code == 0 && stderr.contains("0 are left"), "{stderr}");
    fs::write(&file, TEXT.replace("45", "50")).unwrap();
    let changed = refused(&["simulate", "--resume", folder]);
    assert!(
        changed.contains("mine.toml") && changed.contains("changed"),
        "{changed}"
    );

    let picture = work.path().join("picture.png");
    let (code, _, stderr) = run(&["render", folder, "--png", picture.to_str().unwrap(), "1"]);
    assert!(code == 0 && picture.is_file(), "{stderr}");
}

#[test]
fn shards_of_a_modified_split_merge() {
    let work = TempDir::new().unwrap();
    let path = |name: &str| work.path().join(name).to_str().unwrap().to_owned();
    let file = path("empty.toml");
    fs::write(&file, "[[remove]]\nvehicles = true\npeople = true\n").unwrap();
    let flags = [
        "simulate",
        "--planner",
        "simple",
        "--quiet",
        "--split",
        "generated",
        "--limit",
        "6",
        "--modify",
        &file,
    ];
    for part in ["1/2", "2/2"] {
        let (code, _, stderr) = run(&[
            &flags[..],
            &["--shard", part, "--out", &path(&part.replace('/', "of"))],
        ]
        .concat());
        assert_eq!(code, 0, "{stderr}");
    }
    let (code, _, stderr) = run(&[
        "merge",
        &path("1of2"),
        &path("2of2"),
        "--out",
        &path("whole"),
    ]);
    assert_eq!(code, 0, "{stderr}");
    let summary = read_json(&work.path().join("whole/summary.json"));
    let rows = summary["scenarios"].as_array().unwrap();
    assert_eq!(rows.len(), 6);
    assert!(
        rows.iter()
            .all(|row| row["id"].as_str().unwrap().ends_with("~empty")),
        "{rows:?}"
    );
}

#[test]
fn what_is_wrong_with_a_modification_is_said() {
    let work = TempDir::new().unwrap();
    let file = work.path().join("mine.toml");
    fs::write(
        &file,
        "[[stopped]]\nahead_m = 45\n\n[[cones]]\nahead_m = -5\n",
    )
    .unwrap();
    let path = file.to_str().unwrap();
    for command in [
        &["scenarios", "show", "generated/changing_lane/2"][..],
        &["scenarios", "list", "generated/changing_lane/2"],
    ] {
        let fault = refused(&[command, &["--modify", path]].concat());
        assert!(
            fault.contains("mine.toml, line 4: cones.ahead_m: -5 must be from"),
            "{fault}"
        );
    }
    let unknown = refused(&["simulate", "--modify", "crashes"]);
    assert!(
        unknown.contains("crashes") && unknown.contains("avoid_crashed_cars"),
        "{unknown}"
    );
}

#[test]
fn each_example_names_a_scene_that_fits() {
    let work = TempDir::new().unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/modified");
    let mut examples = 0;
    for entry in fs::read_dir(&folder).unwrap() {
        let file = entry.unwrap().path();
        let text = fs::read_to_string(&file).unwrap();
        let command = text
            .lines()
            .find_map(|line| line.strip_prefix("# A scene that fits: planagent "))
            .unwrap_or_else(|| panic!("{} names no scene", file.display()));
        let out = work.path().join(file.file_stem().unwrap());
        let words: Vec<&str> = command.split(' ').collect();
        let more = [
            "--planner",
            "idm",
            "--challenge",
            "both",
            "--quiet",
            "--out",
        ];
        let output = planagent()
            .args(words)
            .args(more)
            .arg(&out)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{}: {stderr}", file.display());
        assert_eq!(simulations(&out).len(), 2);
        let name = file.file_stem().unwrap().to_str().unwrap();
        let page = fs::read_to_string(folder.join("../../docs/modified.md")).unwrap();
        assert!(page.contains(command), "docs/modified.md lacks {command}");
        assert!(command.contains(&format!("/{name}.toml")), "{command}");
        examples += 1;
    }
    assert!(examples >= 5, "only {examples} examples");
}

#[test]
fn planners_without_a_model_pass_what_the_model_passes_unless_the_oncoming_lane_is_forbidden() {
    const PLANNERS: &str =
        "plan-agent,fixed-code,random-code,random-code-four,grid-code,grid-code-four,oracle-code";
    let work = TempDir::new().unwrap();
    let passing = |name: &str, more: &[&str]| {
        let out = work.path().join(name);
        let scene = "generated/following_lane_with_lead/4~overtake_parked_vehicle";
        let words = [
            "simulate",
            "--quiet",
            "--scenario",
            scene,
            "--planner",
            PLANNERS,
            "--out",
            out.to_str().unwrap(),
        ];
        let (code, _, stderr) = run(&[&words, more].concat());
        assert_eq!(code, 0, "{stderr}");
        let rows = read_json(&out.join("summary.json"))["scenarios"].clone();
        let passing = |row: &&serde_json::Value| row["score"].as_f64().unwrap() > 0.9;
        rows.as_array().unwrap().iter().filter(passing).count()
    };
    assert_eq!(passing("default", &[]), PLANNERS.split(',').count());
    let forbidden = ["--set", "environment.oncoming_lane=false"];
    assert_eq!(passing("forbidden", &forbidden), 0);
}
