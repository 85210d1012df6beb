//! Help and tables fit a terminal of 80 columns; lists stay whole in a pipe.

use super::help::COMMANDS;
use super::{planagent, run};
use tempfile::TempDir;

/// The scenario type with the longest name.
const LONGEST: &str = "starting_straight_traffic_light_intersection_traversal";

/// Fails if a line is too wide.
fn assert_narrow(what: &str, text: &str) {
    let wide: Vec<&str> = text
        .lines()
        .filter(|line| line.chars().count() > 80)
        .collect();
    assert!(wide.is_empty(), "{what}:\n{}", wide.join("\n"));
}

#[test]
fn help_is_wrapped() {
    for command in COMMANDS {
        for help in ["-h", "--help"] {
            for columns in ["80", "200"] {
                let words = command.split_whitespace().chain([help]);
                let output = planagent()
                    .args(words)
                    .env("COLUMNS", columns)
                    .output()
                    .unwrap();
                let text = String::from_utf8(output.stdout).unwrap();
                assert!(
                    output.status.success() && text.contains("Usage:"),
                    "{command}: {text}"
                );
                assert_narrow(command, &text);
            }
        }
    }
}

#[test]
fn a_piped_list_has_a_line_for_each_scenario() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("exported");
    let longest = format!("generated/{LONGEST}/0");
    let commands: [&[&str]; 4] = [
        &["scenarios", "list"],
        &["scenarios", "list", "--split", "generated"],
        &["scenarios", "generate", "--type", LONGEST],
        &[
            "scenarios",
            "export",
            "--format",
            "nuplan",
            "--out",
            out.to_str().unwrap(),
            &longest,
        ],
    ];
    for command in commands {
        let (code, stdout, stderr) = run(command);
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains(LONGEST), "{stdout}");
        assert!(
            stdout.lines().all(|line| !line.starts_with(' ')),
            "{command:?}: {stdout}"
        );
    }
    let (code, stdout, stderr) = run(&["scenarios", "list", out.join("data").to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let [line] = stdout.lines().collect::<Vec<_>>()[..] else {
        panic!("{stdout}")
    };
    assert!(
        line.contains(".db#") && line.ends_with(&format!("  {LONGEST}")),
        "{line}"
    );
}

#[test]
fn a_scenario_is_shown_in_80_columns() {
    for scenario in [
        format!("generated/{LONGEST}/0"),
        "generated/traversing_roundabout/1".to_owned(),
    ] {
        let (code, stdout, stderr) = run(&["scenarios", "show", &scenario]);
        assert_eq!(code, 0, "{stderr}");
        assert!(
            stdout.contains("roadblocks:") && stdout.contains("of them connectors"),
            "{stdout}"
        );
        assert_narrow(&scenario, &stdout);
    }
}
