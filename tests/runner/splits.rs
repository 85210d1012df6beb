//! Lists of scenarios by name and file.

use super::simulations;
use crate::cli::{read_json, refused, run};
use planagent_runs::report::ScenarioList;
use planagent_runs::worker::interactive::{GENERATED, RECORDED, suite_words};
use planagent_runs::worker::suite::Suite;
use planagent_scenario::generator::{Spec, generate, types};
use planagent_scenario::modified::kind_texts;
use planagent_scenario::nuplan::export::{ExportSettings, write_scenario};
use serde_json::{Value, json};
use std::fs;
use tempfile::TempDir;

/// A token that no log holds.
const ABSENT: &str = "00000000000000ff";

#[test]
fn a_filter_file_is_driven_and_what_is_missing_is_an_error_of_the_run() {
    let work = TempDir::new().unwrap();
    let scene = generate(&Spec::new(types::changing_lane::TYPE, 0)).unwrap();
    let exported = write_scenario(
        &scene,
        &work.path().join("nuplan"),
        &ExportSettings::default(),
    );
    let token = exported.unwrap().logs[0].token.clone();
    let filter = work.path().join("mine.yaml");
    let text = format!(
        "scenario_tokens:\n  - \"{token}\"\n  - \"{ABSENT}\"\nremove_invalid_goals: false\nshuffle: false\n"
    );
    fs::write(&filter, text).unwrap();
    let [data, maps, out] =
        ["nuplan/data", "nuplan/maps", "run"].map(|name| work.path().join(name));
    let roots = [
        "--data-root",
        data.to_str().unwrap(),
        "--maps-root",
        maps.to_str().unwrap(),
    ];
    let split = ["--split", filter.to_str().unwrap()];

    let flags = [
        "simulate",
        "--planner",
        "log-replay",
        "--out",
        out.to_str().unwrap(),
    ];
    let (code, stdout, stderr) = run(&[&flags[..], &split, &roots].concat());
    assert_eq!(code, 1, "{stderr}");
    assert!(
        stderr.contains("1 of 2 scenarios are missing") && stderr.contains(ABSENT),
        "{stderr}"
    );
    assert!(stdout.contains("log-replay"), "{stdout}");
    let summary = read_json(&out.join("summary.json"));
    assert_eq!(summary["scenarios"].as_array().unwrap().len(), 1);
    assert_eq!(summary["scenarios"][0]["id"], token);
    assert_eq!(simulations(&out).len(), 1);
    let missing = json!([{"split": filter, "wanted": 2, "absent": [ABSENT], "excluded": []}]);
    assert_eq!(summary["missing"], missing);
    let manifest: toml::Table = fs::read_to_string(out.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(
        serde_json::to_value(&manifest["scenarios"]["missing"]).unwrap(),
        missing
    );

    // The run knows where its data lies.
    let (code, _, stderr) = run(&["simulate", "--resume", out.to_str().unwrap()]);
    assert!(
        code == 1 && stderr.contains("1 of 1 simulations are completed, 0 are left"),
        "{stderr}"
    );
    // The summary lists the missing scenarios, and stderr names them even with -q.
    let (code, stdout, stderr) = run(&[
        "simulate",
        "--resume",
        out.to_str().unwrap(),
        "--json",
        "-q",
    ]);
    assert_eq!(
        (code, serde_json::from_str::<Value>(&stdout).unwrap()),
        (1, summary),
        "{stderr}"
    );
    assert!(
        stderr.starts_with("error: not simulated") && stderr.contains(ABSENT),
        "{stderr}"
    );

    let (code, stdout, _) = run(&[&["scenarios", "list"][..], &split, &roots].concat());
    let named = stdout
        .lines()
        .filter(|line| line.contains(&format!("#{token}")))
        .count();
    assert_eq!((code, named), (1, 1), "{stdout}");
    let nowhere = refused(
        &[
            &flags[..2],
            &["log-replay", "--split", filter.to_str().unwrap()],
        ]
        .concat(),
    );
    assert!(
        nowhere.contains("NUPLAN_DATA_ROOT") || nowhere.contains("data-root"),
        "{nowhere}"
    );
}

#[test]
fn the_generated_split_is_listed_whole() {
    let (code, stdout, _) = run(&["scenarios", "list", "--split", "generated"]);
    assert_eq!((code, stdout.lines().count()), (0, 160), "{stdout}");
    let (code, stdout, _) = run(&["scenarios", "list", "--split", "generated-test14-hard"]);
    assert_eq!((code, stdout.lines().count()), (0, 280), "{stdout}");
    let unknown = refused(&["simulate", "--split", "val15"]);
    assert!(
        unknown.contains("val15") && unknown.contains("generated"),
        "{unknown}"
    );
}

/// Scores of a suite are comparable as long as its scenarios stay: the documentation has their
/// digests.
#[test]
fn suites_stay_as_they_are() {
    let listed = include_str!("../../docs/generator.md");
    for (suite, blake3) in [
        (
            Suite::TEST14,
            "a282d3b57337ccfc6577010da7b5841e83df57d235f9e2258f45b3b1c16142eb",
        ),
        (
            Suite::CANDIDATES,
            "4c717b086fa5aafcbc262df4c87058fb7415a801138ab7b8bfab0168defedd19",
        ),
        (
            Suite::TEST14_HARD,
            "f6c66a9381bfbd56e7c86d2dcbea82c0eb9c273b307adb927dd82490d7f37a1c",
        ),
        (
            Suite::TEST14_WIDE,
            "e9f2812d22dee6cfa1631ec4254454eee1f1227b199a9f5c5c56de8b5b3d33cf",
        ),
    ] {
        let names = suite.specs().into_iter().map(|spec| spec.to_string());
        assert_eq!(ScenarioList::digest(names), blake3, "{}", suite.name);
        assert!(
            listed.contains(&format!("`{blake3}`")),
            "docs/generator.md lacks the digest of {}",
            suite.name
        );
    }
}

/// So it is with the interactive suites, whose scenes depend on the files of the kinds too.
#[test]
fn interactive_suites_stay_as_they_are() {
    let page =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/modified.md")).unwrap();
    let digests = [
        ScenarioList::digest(suite_words(GENERATED).unwrap()),
        ScenarioList::digest(suite_words(RECORDED).unwrap()),
        ScenarioList::digest(kind_texts().flat_map(|(_, text)| text.lines())),
    ];
    let missing: Vec<&String> = digests
        .iter()
        .filter(|digest| !page.contains(&format!("`{digest}`")))
        .collect();
    assert!(
        missing.is_empty(),
        "docs/modified.md pins the suites and the kinds; of {digests:?} it lacks {missing:?}"
    );
}

/// The help names the size of every suite.
#[test]
fn the_help_names_the_sizes_of_the_suites() {
    let (_, help, _) = run(&["simulate", "--help"]);
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    for suite in Suite::ALL {
        let specs = suite.specs();
        let types = specs
            .chunk_by(|a, b| a.scenario_type == b.scenario_type)
            .count();
        let (name, seeds) = (suite.name, specs.len() / types);
        let size = format!("{name} ({types} types x {seeds})");
        assert!(help.contains(&size), "the help lacks {size}: {help}");
    }
}
