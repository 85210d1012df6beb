//! The help of every command, short and long.

use super::{planagent, refused, run};

/// Every command with its own help.
pub(super) const COMMANDS: [&str; 28] = [
    "",
    "simulate",
    "plan",
    "ask",
    "report",
    "serve",
    "render",
    "compare",
    "merge",
    "scenarios",
    "scenarios list",
    "scenarios show",
    "scenarios statistics",
    "scenarios generate",
    "scenarios export",
    "scenarios hard",
    "models",
    "models list",
    "models show",
    "models check",
    "models fetch",
    "models families",
    "models quantize",
    "dataset",
    "study",
    "bench",
    "config",
    "completions",
];

#[test]
fn help_is_as_reviewed() {
    for command in COMMANDS {
        let name = if command.is_empty() {
            "planagent".to_owned()
        } else {
            command.replace(' ', "_")
        };
        for (form, flag) in [("short", "-h"), ("long", "--help")] {
            let words = command.split_whitespace().chain([flag]);
            let output = planagent()
                .args(words)
                .env("COLUMNS", "80")
                .output()
                .unwrap();
            assert!(output.status.success(), "{command}");
            let text = String::from_utf8(output.stdout).unwrap();
            insta::with_settings!({prepend_module_to_snapshot => false}, {
                insta::assert_snapshot!(format!("help_{name}_{form}"), text);
            });
        }
    }
}

/// Lines of a short help at most: what a small terminal shows at once.
const MAX_SHORT: usize = 32;

/// The name of an option in a line of help.
fn option(line: &str) -> Option<&str> {
    line.split_whitespace()
        .find(|word| word.starts_with("--"))
        .map(|word| word.trim_end_matches(','))
}

#[test]
fn the_short_help_fits_a_screen_and_the_long_one_is_complete() {
    for command in COMMANDS {
        let help = |flag: &str| {
            let words = command.split_whitespace().chain([flag]);
            let output = planagent()
                .args(words)
                .env("COLUMNS", "80")
                .output()
                .unwrap();
            String::from_utf8(output.stdout).unwrap()
        };
        let (short, long) = (help("-h"), help("--help"));
        let lines = short.lines().count();
        assert!(lines <= MAX_SHORT, "{command}: {lines} lines");
        let shown = short
            .lines()
            .filter(|line| line.trim_start().starts_with('-'))
            .filter_map(option);
        for option in shown.filter(|option| *option != "--help") {
            assert!(long.contains(option), "{command}: no {option} in --help");
        }
        assert!(
            long.contains("\nExample:\n") || long.contains("\nExamples:\n"),
            "{command}: no example"
        );
        assert!(
            long.contains("--threads") && long.contains("--verbose"),
            "{command}: {long}"
        );
    }
}

#[test]
fn options_about_models_stand_only_where_a_model_is_used() {
    for command in COMMANDS {
        let words: Vec<&str> = command.split_whitespace().chain(["--help"]).collect();
        let text = run(&words).1;
        let uses = [
            "simulate", "plan", "ask", "dataset", "study", "bench", "config",
        ]
        .contains(&command);
        assert_eq!(text.contains("--model <MODEL>"), uses, "{command}");
    }
}

#[test]
fn completions_name_commands_and_options() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let (code, script, stderr) = run(&["completions", shell]);
        assert_eq!(code, 0, "{stderr}");
        for word in ["simulate", "--planner", "--retry-failed", "completions"] {
            let bare = word.trim_start_matches("--");
            assert!(script.contains(bare), "{shell}: no {word}");
        }
    }
}

#[test]
fn completions_know_the_names_of_registries() {
    for shell in ["bash", "zsh", "fish"] {
        let (code, script, stderr) = run(&["completions", shell]);
        assert_eq!(code, 0, "{stderr}");
        for name in [
            "pdm-closed",
            "generated-test14-hard",
            "interactive-generated",
            "changing_lane",
            "interactive",
            "smolvlm2-500m",
            "compact-2",
            "reflection.threshold",
        ] {
            assert!(script.contains(name), "{shell}: no {name}");
        }
    }
    // Values that the script does not know stay possible.
    let error = refused(&["simulate", "--planner", "nobody"]);
    assert!(error.contains("nobody"), "{error}");
}
