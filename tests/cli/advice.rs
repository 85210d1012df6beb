//! What messages tell the user to type works as it stands.

use super::{SCENE, planagent, refused};
use regex::Regex;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use tempfile::TempDir;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Commands in the texts of the program, as its sources have them, and what shows that they work.
/// Placeholders stand in braces or capital letters.
const ADVICE: [(&str, &str); 22] = [
    ("planagent {command}", "renamed"),
    ("planagent config", "config"),
    // `a_configuration_file_is_not_overwritten_and_the_command_it_names_works`.
    ("planagent config --explain", "config"),
    ("planagent scenarios list", "types"),
    ("planagent bench MODEL", "models"),
    ("planagent models show MODEL", "models"),
    ("planagent models check MODEL", "families"),
    ("planagent models check {}", "models"),
    ("planagent models families --markdown", "families"),
    ("planagent models quantize --adapter", "models"),
    ("planagent bench {}", "models"),
    ("planagent simulate --resume {run}", "damaged"),
    ("planagent simulate --resume {}", "damaged"),
    ("planagent simulate --resume {folder}", "merge"),
    // The hub is not asked by tests: the command line is read, and `--offline` ends it.
    ("planagent models fetch {model}", "fetch"),
    ("planagent models fetch {id}", "fetch"),
    ("planagent models fetch {}", "fetch"),
    ("planagent models fetch", "fetch"),
    // Made of the words of the process: `again.rs` and tests/cli/interrupt.rs.
    ("{command}", "interrupt"),
    ("{}", "interrupt"),
    ("planagent merge", "help"),
    ("planagent dataset --for messages", "teach"),
];

/// Files of the program with its texts.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs")
            && !path.to_string_lossy().contains("test")
        {
            found.push(path);
        }
    }
}

/// A new command in a message needs a row of the table, and a test.
#[test]
fn each_command_in_a_message_is_known() {
    let mut files = Vec::new();
    sources(&Path::new(ROOT).join("src"), &mut files);
    let command = Regex::new(r"`(planagent [^`\\]*|\{(?:command)?\}`? goes on)").unwrap();
    let mut missing = Vec::new();
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        for line in text.lines().map(str::trim) {
            // Comments are for readers of the code, or help that clap prints.
            if line.starts_with("//") {
                continue;
            }
            for found in command.captures_iter(line) {
                let said = found[1]
                    .trim_end_matches(" goes on")
                    .trim_end_matches('`')
                    .trim();
                if !ADVICE.iter().any(|(known, _)| *known == said) {
                    missing.push(format!("{}: {said}", file.display()));
                }
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
}

/// Runs a line of a message in a folder, as a shell does.
fn typed(folder: &Path, line: &str) -> Output {
    let words = line
        .strip_prefix("planagent ")
        .expect("the program's own name");
    let script = format!("\"$0\" {words}");
    let mut command = assert_cmd::Command::new("sh");
    for (name, value) in planagent().get_envs() {
        if let Some(value) = value {
            command.env(name, value);
        }
    }
    command
        .current_dir(folder)
        .args(["-c", &script])
        .arg(planagent().get_program())
        .output()
        .unwrap()
}

/// The first command between backticks of a text.
fn command_in(text: &str) -> String {
    let command = Regex::new("`(planagent [^`]*)`").unwrap();
    let found = command.captures(text);
    found.unwrap_or_else(|| panic!("no command in {text}"))[1].to_owned()
}

/// Types the command of a text; gives what it said.
fn follow(folder: &Path, text: &str) -> String {
    let line = command_in(text);
    let output = typed(folder, &line);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{line}: {stderr}");
    stderr
}

fn begin(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = planagent()
        .current_dir(folder)
        .args(arguments)
        .output()
        .unwrap();
    (
        output.status.code(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

#[test]
fn the_new_name_of_a_command_is_one() {
    let said = refused(&["experiment"]);
    let line = command_in(&said);
    let work = TempDir::new().unwrap();
    let output = typed(work.path(), &format!("{line} --help"));
    assert_eq!(output.status.code(), Some(0), "{line}");
}

#[test]
fn lists_that_errors_name_exist() {
    let work = TempDir::new().unwrap();
    follow(work.path(), &refused(&["simulate", "--set", "telepathy=1"]));
    follow(
        work.path(),
        &refused(&["simulate", "--scenario", "generated/telepathy/1"]),
    );
    let output = typed(work.path(), "planagent models list");
    let said =
        String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("`planagent models show MODEL`"), "{said}");
    let output = typed(work.path(), "planagent models show nano");
    let said =
        String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
    assert_eq!(command_in(&said), "planagent bench nano");
    let bench = "planagent bench nano --iterations 1 --warm-up 0";
    assert_eq!(typed(work.path(), bench).status.code(), Some(0));
    let output = typed(work.path(), "planagent models quantize --help");
    let help = String::from_utf8(output.stdout).unwrap();
    assert!(help.contains("--adapter"), "{help}");
}

#[test]
fn the_page_of_families_is_written_as_it_says() {
    let work = TempDir::new().unwrap();
    let output = typed(work.path(), "planagent models families --markdown");
    let page = String::from_utf8(output.stdout).unwrap();
    assert!(page.starts_with("# Supported models\n"), "{page}");
    let output = typed(work.path(), "planagent models check nano");
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn a_damaged_simulation_is_repeated_as_the_message_says() {
    let work = TempDir::new().unwrap();
    let out = "my runs/it's one";
    let flags = [
        "simulate",
        "--scenario",
        SCENE,
        "--planner",
        "log-replay,simple",
        "--out",
        out,
    ];
    assert_eq!(begin(work.path(), &flags).0, Some(0));
    let simulation = crate::runner::simulations(&work.path().join(out)).remove(0);
    fs::write(simulation.join("metrics.toml"), "").unwrap();
    let (_, said) = begin(work.path(), &["report", out]);
    assert!(said.contains("damaged"), "{said}");
    follow(work.path(), &said);
    let (_, said) = begin(work.path(), &["report", out]);
    assert!(!said.contains("damaged"), "{said}");
}

#[test]
fn an_incomplete_merge_is_completed_as_the_message_says() {
    let work = TempDir::new().unwrap();
    let flags = [
        "simulate",
        "--split",
        "generated",
        "--limit",
        "4",
        "--planner",
        "log-replay",
    ];
    for shard in ["1/2", "2/2"] {
        let out = format!("part {}", &shard[..1]);
        let more = ["--shard", shard, "--out", &out];
        assert_eq!(begin(work.path(), &[&flags[..], &more].concat()).0, Some(0));
    }
    let parts = ["part 1", "part 2"];
    let whole = parts.map(|part| crate::runner::simulations(&work.path().join(part)));
    let simulation = whole.iter().flatten().next().unwrap();
    fs::remove_dir_all(simulation).unwrap();
    let merge = ["merge", "part 1", "part 2", "--out", "whole"];
    let (code, said) = begin(work.path(), &merge);
    assert_eq!(code, Some(2), "{said}");
    follow(work.path(), &said);
    assert_eq!(begin(work.path(), &merge).0, Some(0));
}

#[test]
fn a_model_that_is_not_here_is_fetched_by_a_command_that_is_read() {
    let work = TempDir::new().unwrap();
    let output = typed(work.path(), "planagent models check smolvlm2-256m");
    let said =
        String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
    if said.contains("`planagent models fetch") {
        let line = command_in(&said);
        let output = typed(work.path(), &format!("{line} --offline"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(!stderr.contains("unexpected argument"), "{line}: {stderr}");
    }
}

#[test]
fn a_configuration_file_is_not_overwritten_and_the_command_it_names_works() {
    let work = TempDir::new().unwrap();
    assert_eq!(begin(work.path(), &["config", "--init"]).0, Some(0));
    let (code, said) = begin(work.path(), &["config", "--init"]);
    assert_eq!(code, Some(2), "{said}");
    follow(work.path(), &said);
}
