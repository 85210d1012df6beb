//! `planagent scenarios export`, and reading the exported folder.

use assert_cmd::Command;
use std::path::Path;

/// Runs the program with `NUPLAN_MAPS_ROOT`; exit code, stdout and stderr.
fn run(home: &Path, words: &[&str]) -> (i32, String, String) {
    let mut command = Command::cargo_bin("planagent").unwrap();
    let maps = home.join("out").join("maps");
    let ran = command
        .args(words)
        .env("NUPLAN_MAPS_ROOT", maps)
        .env("PLANAGENT_CACHE", home)
        .current_dir(home)
        .output();
    let output = ran.unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code().unwrap(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

#[test]
fn an_exported_scenario_is_found_in_its_folder() {
    let home = tempfile::tempdir().unwrap();
    let export = [
        "scenarios",
        "export",
        "generated/stationary_in_traffic/1",
        "--format",
        "nuplan",
        "--out",
        "out",
    ];
    let (code, stdout, stderr) = run(home.path(), &export);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.starts_with("generated-1_generated_stationary_in_traffic_1"),
        "{stdout}"
    );
    assert!(
        stderr.contains("NUPLAN_DATA_ROOT=out/data")
            && stderr.contains("NUPLAN_MAPS_ROOT=out/maps"),
        "{stderr}"
    );
    let (code, _, stderr) = run(home.path(), &export);
    assert!(
        code != 0 && stderr.contains("out exists and is not empty"),
        "{stderr}"
    );
    let token = stdout
        .split_whitespace()
        .skip_while(|word| *word != "token")
        .nth(1)
        .unwrap();
    let (code, stdout, stderr) = run(home.path(), &["scenarios", "show", "out/data", "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let shown: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&shown["id"], &shown["iterations"]),
        (&token.into(), &151.into()),
        "{shown}"
    );
    assert_eq!(shown["scenario_type"], "stationary_in_traffic");
}

#[test]
fn stand_in_maps_are_written_and_the_scenario_is_still_found() {
    let home = tempfile::tempdir().unwrap();
    let words = [
        "scenarios",
        "export",
        "generated/traversing_roundabout/1",
        "--format",
        "nuplan",
        "--out",
        "out",
    ];
    let flags = [
        "--stand-in-maps",
        "--scenario-type",
        "traversing_intersection",
    ];
    let (code, _, stderr) = run(home.path(), &[&words[..], &flags].concat());
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        std::fs::read_dir(home.path().join("out/maps"))
            .unwrap()
            .count(),
        6,
        "the list, the map and four more"
    );
    let (code, stdout, stderr) = run(home.path(), &["scenarios", "show", "out/data", "--json"]);
    assert_eq!(code, 0, "{stderr}");
    let shown: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(
        (&shown["iterations"], &shown["scenario_type"]),
        (&151.into(), &"traversing_intersection".into())
    );
}

#[test]
fn a_failed_export_leaves_nothing_behind() {
    let home = tempfile::tempdir().unwrap();
    let export = |words: &[&str]| {
        let all = [
            &["scenarios", "export", "--format", "nuplan", "--out", "out"],
            words,
        ]
        .concat();
        let (code, _, stderr) = run(home.path(), &all);
        assert!(
            code != 0 && std::fs::read_dir(home.path()).unwrap().next().is_none(),
            "{stderr}"
        );
        stderr
    };
    assert!(export(&["generated/changing_lane/1", "--epsg", "4326"]).contains("not a UTM zone"));
    assert!(
        export(&["generated/changing_lane/1", "--location", "a/b"]).contains("cannot name a map")
    );
    assert!(
        export(&["generated/changing_lane/1", "generated/changing_lane/1"])
            .contains("must be given once")
    );
    assert!(export(&["nowhere.tfrecord"]).contains("nowhere.tfrecord"));
    assert!(export(&[]).contains("SCENARIO"));
}
