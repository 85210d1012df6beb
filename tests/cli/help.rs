//! The help of every command, short and long.

use super::{planagent, refused, run};
use std::path::Path;
use tempfile::TempDir;

/// Every command with its own help.
pub(super) const COMMANDS: [&str; 29] = [
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
    "card",
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
            "simulate", "plan", "ask", "dataset", "study", "card", "bench", "config",
        ]
        .contains(&command);
        assert_eq!(text.contains("--model <MODEL>"), uses, "{command}");
    }
}

/// The words that the program offers to bash for the last word of a line, in a working directory.
fn offered(work: &Path, line: &[&str]) -> Vec<String> {
    let mut words = vec!["planagent"];
    words.extend(line);
    let last = (words.len() - 1).to_string();
    let output = planagent()
        .env("PLANAGENT_COMPLETE", "bash")
        .env("_CLAP_COMPLETE_INDEX", last)
        // The models of the working directory, as a user has them.
        .env_remove("PLANAGENT_MODELS")
        .arg("--")
        .args(words)
        .current_dir(work)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn scripts_of_completions_ask_the_program() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let (code, script, stderr) = run(&["completions", shell]);
        assert_eq!(code, 0, "{stderr}");
        assert!(script.contains("PLANAGENT_COMPLETE"), "{shell}: {script}");
        assert!(script.contains("planagent"), "{shell}: {script}");
    }
}

#[test]
fn completions_know_commands_options_and_the_names_of_registries() {
    let work = TempDir::new().unwrap();
    let lines: [(&[&str], &str); 12] = [
        (&["sim"], "simulate"),
        (&["simulate", "--retry"], "--retry-failed"),
        (&["simulate", "--planner", "pdm-c"], "pdm-closed"),
        (&["simulate", "--planner", "idm,pdm-c"], "idm,pdm-closed"),
        (
            &["simulate", "--split", "generated-test14-h"],
            "generated-test14-hard",
        ),
        (
            &["simulate", "--split", "interactive-g"],
            "interactive-generated",
        ),
        (&["simulate", "--type", "near_m"], "near_multiple_vehicles"),
        (&["study", "inter"], "interactive"),
        (&["simulate", "--model", "smolvlm2-5"], "smolvlm2-500m"),
        (&["models", "check", "nan"], "nano"),
        (&["simulate", "--prompt-set", "compact-"], "compact-2"),
        (
            &["simulate", "--set", "reflection.thr"],
            "reflection.threshold=",
        ),
    ];
    for (line, name) in lines {
        let found = offered(work.path(), line);
        assert!(found.iter().any(|one| one == name), "{line:?}: {found:?}");
    }
    // Values that are not offered stay possible.
    let error = refused(&["simulate", "--planner", "nobody"]);
    assert!(error.contains("nobody"), "{error}");
}

#[test]
fn completions_know_what_the_user_wrote_since() {
    let work = TempDir::new().unwrap();
    let models = |begun: &str| offered(work.path(), &["simulate", "--model", begun]);
    assert!(models("mine").is_empty());
    let folder = work.path().join("models");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("mine-7b.toml"), "").unwrap();
    std::fs::write(folder.join("mine $(touch x).toml"), "").unwrap();
    assert_eq!(models("mine"), ["mine-7b"]);
    let settings = "[mllm]\nmodel = \"ours\"\n";
    std::fs::write(work.path().join("planagent.toml"), settings).unwrap();
    assert_eq!(models("our"), ["ours"]);
    // A broken file of settings takes no names away.
    std::fs::write(work.path().join("planagent.toml"), "[").unwrap();
    assert_eq!(models("nan"), ["nano"]);
    // Paths, but none that a shell would run.
    std::fs::write(work.path().join("run-a.gguf"), "").unwrap();
    std::fs::write(work.path().join("run-$(touch x).gguf"), "").unwrap();
    assert_eq!(models("run"), ["run-a.gguf"]);
}
