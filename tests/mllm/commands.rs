//! `planagent models`.

use assert_cmd::Command;
use serde_json::Value;

use super::fixture;

fn planagent(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("planagent").unwrap();
    command.args(arguments).env_remove("HF_HUB_CACHE").env("HF_HOME", "/nonexistent/cache");
    command
}

fn lines(arguments: &[&str], code: i32) -> Vec<Value> {
    let output = planagent(arguments).assert().code(code).get_output().stdout.clone();
    String::from_utf8(output).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn described_models_are_listed() {
    let listed = lines(&["models", "list", "--json"], 0);
    let row = |name: &str| listed.iter().find(|row| row["model"] == name).unwrap();
    assert_eq!((row("nano")["family"].as_str(), row("nano")["problem"].as_str()), (Some("llava"), None));
    assert!(row("nano")["bytes"].as_u64().unwrap() > 8_000_000);
    assert_eq!(row("llava-1.5-7b")["source"], "llava-hf/llava-1.5-7b-hf");
    assert!(row("llava-1.5-7b")["place"].is_null());
    assert!(row("llava-1.5-7b")["problem"].as_str().unwrap().contains("planagent models fetch llava-1.5-7b"));
    assert_eq!(
        (row("nano")["prompt_set"].as_str(), row("openai")["prompt_set"].as_str()),
        (Some("compact"), Some("paper"))
    );
    let text =
        String::from_utf8(planagent(&["models", "list"]).assert().success().get_output().stdout.clone()).unwrap();
    assert_eq!(text.lines().count(), listed.len(), "piped, a model takes a line: {text}");
}

#[test]
fn a_model_is_checked_quantised_and_checked_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tiny.gguf");
    let (from, to) = (fixture("tiny_llava"), file.to_str().unwrap());
    let from = from.to_str().unwrap();
    let before = &lines(&["models", "check", from, "--json"], 0)[0];
    assert_eq!(
        (before["architecture"].as_str(), before["problems"].as_array().map(Vec::len)),
        (Some("llava"), Some(0))
    );
    let made = &lines(&["models", "quantize", from, "--to", "q8_0", "--out", to, "--json"], 0)[0];
    assert_eq!(made["files"].as_array().map(Vec::len), Some(2));
    assert!(folder.path().join("mmproj-tiny.gguf").is_file());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing unfinished is left");
    let after = &lines(&["models", "check", to, "--json"], 0)[0];
    assert!(after["memory"]["weights"].as_u64() < before["memory"]["weights"].as_u64());
    // An existing file is not overwritten without --force.
    let again = planagent(&["models", "quantize", from, "--to", "q8_0", "--out", to]).assert().code(2);
    assert!(String::from_utf8_lossy(&again.get_output().stderr).contains("--force overwrites it"));
    planagent(&["models", "quantize", from, "--to", "f32", "--out", to, "--force", "--quiet"]).assert().success();
}

#[test]
fn what_cannot_be_done_says_why() {
    for (arguments, code, expected) in [
        (
            &["models", "quantize", "nano", "--to", "q5_k", "--out", "x.gguf"][..],
            2,
            "choose one of f32, f16, q8_0, q6_k, q4_k",
        ),
        (&["models", "quantize", "nano", "--to", "q4_k", "--out", "x.bin"], 2, "must end in .gguf"),
        (&["models", "fetch", "no-such-model"], 2, "unknown model 'no-such-model'"),
        (&["models", "fetch", "llava-1.5-7b", "--offline"], 2, "not in the cache"),
        (&["plan", "--model", "nowhere.gguf"], 2, "unknown model 'nowhere.gguf'"),
    ] {
        let output = planagent(arguments).assert().code(code).get_output().stderr.clone();
        let text = String::from_utf8_lossy(&output).into_owned();
        assert!(text.contains(expected), "{arguments:?}: {text}");
    }
    let checked = lines(&["models", "check", "no-such-model", "--json"], 1);
    assert!(checked[0]["missing"].as_str().unwrap().contains("no-such-model"));
}

#[test]
fn a_plan_with_quantised_weights_says_how_they_are_held() {
    let output =
        planagent(&["plan", "--model", "nano", "--quantize", "q8_0", "--verbose", "--json"]).assert().success();
    let text = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(text.contains("q8_0: 56 tensors"), "{text}");
}
