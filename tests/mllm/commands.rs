//! `planagent models`.

use super::fixture;
use assert_cmd::Command;
use serde_json::Value;

fn planagent(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("planagent").unwrap();
    command
        .args(arguments)
        .env_remove("HF_HUB_CACHE")
        .env("HF_HOME", "/nonexistent/cache");
    command.env(
        "PLANAGENT_CACHE",
        concat!(env!("CARGO_TARGET_TMPDIR"), "/cache"),
    );
    command
}

fn lines(arguments: &[&str], code: i32) -> Vec<Value> {
    let output = planagent(arguments)
        .assert()
        .code(code)
        .get_output()
        .stdout
        .clone();
    String::from_utf8(output)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn described_models_are_listed() {
    let listed = lines(&["models", "list", "--json"], 0);
    let row = |name: &str| listed.iter().find(|row| row["model"] == name).unwrap();
    assert_eq!(
        (
            row("nano")["family"].as_str(),
            row("nano")["problem"].as_str()
        ),
        (Some("llava"), None)
    );
    assert!(row("nano")["bytes"].as_u64().unwrap() > 8_000_000);
    assert_eq!(row("llava-1.5-7b")["source"], "llava-hf/llava-1.5-7b-hf");
    assert!(row("llava-1.5-7b")["place"].is_null());
    assert!(
        row("llava-1.5-7b")["problem"]
            .as_str()
            .unwrap()
            .contains("planagent models fetch llava-1.5-7b")
    );
    assert_eq!(
        (
            row("nano")["prompt_set"].as_str(),
            row("openai")["prompt_set"].as_str()
        ),
        (Some("compact-2"), Some("paper"))
    );
    let text = String::from_utf8(
        planagent(&["models", "list"])
            .assert()
            .success()
            .get_output()
            .stdout
            .clone(),
    )
    .unwrap();
    assert_eq!(
        text.lines()
            .next()
            .map(|head| head.contains("license") && head.contains("kv")),
        Some(true),
        "{text}"
    );
    let models = text
        .lines()
        .skip(1)
        .take_while(|line| !line.contains(" prompts in "));
    assert_eq!(models.count(), listed.len(), "a model takes a line: {text}");
    assert!(
        text.lines().all(|line| line.chars().count() <= 80),
        "{text}"
    );
}

#[test]
fn a_list_says_what_a_model_takes() {
    let listed = lines(&["models", "list", "--json"], 0);
    let row = |name: &str| listed.iter().find(|row| row["model"] == name).unwrap();
    let number = |name: &str, keys: &str| row(name).pointer(keys).and_then(Value::as_f64).unwrap();
    // One view of the drawn map, not the 17 of the processor's default.
    assert_eq!(row("smolvlm2-500m")["image_tokens"], 64);
    assert_eq!(
        (
            row("qwen3-vl-2b")["image_size"].as_u64(),
            row("qwen3-vl-2b")["image_tokens"].as_u64()
        ),
        (Some(448), Some(196))
    );
    assert_eq!(row("internvl3-1b")["license"], "MIT, decoder Apache-2.0");
    assert!((number("llava-1.5-7b", "/parameters") / 7.06e9 - 1.0).abs() < 0.01);
    // 32 layers of 4096 keys and values in 16 bits, for 4096 tokens.
    assert!(
        (number("llava-1.5-7b", "/memory/q4_k/cache") - 2.0 * 2.0 * 4096.0 * 4096.0 * 32.0).abs()
            < 0.5
    );
    let weights = |format: &str| number("llava-1.5-7b", &format!("/memory/{format}/weights"));
    assert!(
        weights("q4_k") < weights("q8_0")
            && weights("q8_0") < weights("f16")
            && weights("f16") < weights("f32")
    );
    assert!(row("openai").get("memory").is_none());
    for name in listed.iter().filter(|row| row["server"] == false) {
        assert!(
            name["license"].is_string() && name["parameters"].is_u64(),
            "{name}"
        );
    }
}

#[test]
fn a_model_is_shown() {
    let show = |name: &str| {
        let output = planagent(&["models", "show", name])
            .assert()
            .success()
            .get_output()
            .clone();
        let [text, notes] =
            [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        (text, notes)
    };
    let (text, notes) = show("smolvlm2-500m");
    for said in [
        "Apache-2.0",
        "512 pixels, 64 tokens",
        "planagent models fetch smolvlm2-500m",
        "q8_0",
        "GiB",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    assert!(notes.contains("planagent bench smolvlm2-500m"), "{notes}");
    let (text, _) = show(fixture("tiny_cogvlm").to_str().unwrap());
    assert!(
        text.contains("18 tokens of the drawn BEV map") && text.contains("cogvlm"),
        "{text}"
    );
    assert!(!text.contains("description"), "a folder has none: {text}");
    planagent(&["models", "show", "no-such-model"])
        .assert()
        .code(2);
}

#[test]
fn a_model_is_checked_quantised_and_checked_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tiny.gguf");
    let (from, to) = (fixture("tiny_llava"), file.to_str().unwrap());
    let from = from.to_str().unwrap();
    let before = &lines(&["models", "check", from, "--json"], 0)[0];
    assert_eq!(
        (
            before["architecture"].as_str(),
            before["problems"].as_array().map(Vec::len)
        ),
        (Some("llava"), Some(0))
    );
    let made = &lines(
        &[
            "models", "quantize", from, "--to", "q8_0", "--out", to, "--json",
        ],
        0,
    )[0];
    assert_eq!(made["files"].as_array().map(Vec::len), Some(2));
    assert!(folder.path().join("mmproj-tiny.gguf").is_file());
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        2,
        "nothing unfinished is left"
    );
    let after = &lines(&["models", "check", to, "--json"], 0)[0];
    assert!(after["memory"]["weights"].as_u64() < before["memory"]["weights"].as_u64());
    // An existing file is not overwritten without --force.
    let again = planagent(&["models", "quantize", from, "--to", "q8_0", "--out", to])
        .assert()
        .code(2);
    assert!(String::from_utf8_lossy(&again.get_output().stderr).contains("--force overwrites it"));
    planagent(&[
        "models", "quantize", from, "--to", "f32", "--out", to, "--force", "--quiet",
    ])
    .assert()
    .success();
}

#[test]
fn what_cannot_be_done_says_why() {
    for (arguments, code, expected) in [
        (
            &[
                "models", "quantize", "nano", "--to", "q2_k", "--out", "x.gguf",
            ][..],
            2,
            "choose one of f32, f16, q8_0, q6_k, q5_1, q5_k, q5_0, q4_1, q4_k, q4_0, q3_k",
        ),
        (
            &[
                "models", "quantize", "nano", "--to", "q4_k", "--out", "x.bin",
            ],
            2,
            "must end in .gguf",
        ),
        (
            &["models", "fetch", "no-such-model"],
            2,
            "unknown model 'no-such-model'",
        ),
        (
            &["models", "fetch", "llava-1.5-7b", "--offline"],
            2,
            "not in the cache",
        ),
        (
            &["plan", "--model", "nowhere.gguf"],
            2,
            "there is no model file or folder nowhere.gguf",
        ),
    ] {
        let output = planagent(arguments)
            .assert()
            .code(code)
            .get_output()
            .stderr
            .clone();
        let text = String::from_utf8_lossy(&output).into_owned();
        assert!(text.contains(expected), "{arguments:?}: {text}");
    }
    let checked = lines(&["models", "check", "no-such-model", "--json"], 1);
    assert!(
        checked[0]["missing"]
            .as_str()
            .unwrap()
            .contains("no-such-model")
    );
}

#[test]
fn what_says_how_a_model_is_asked_is_checked_too() {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture("tiny_llava")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    let place = folder.path().to_str().unwrap();
    for (settings, expected) in [
        ("{\"prompts\": \"compact\"}", "planagent.json"),
        ("{\"prompt_set\": \"no-such-set\"}", "no-such-set"),
    ] {
        std::fs::write(folder.path().join("planagent.json"), settings).unwrap();
        let checked = &lines(&["models", "check", place, "--json"], 1)[0];
        let problems = checked["problems"].as_array().unwrap();
        assert!(
            problems.len() == 1 && problems[0].as_str().unwrap().contains(expected),
            "{checked}"
        );
    }
}

#[test]
fn an_error_of_a_description_names_its_file_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.toml");
    std::fs::write(&file, "name = \"wrong\"\nfoo = 1\n").unwrap();
    let place = file.to_str().unwrap();
    let checked = planagent(&["models", "check", place]).assert().code(1);
    let said = String::from_utf8_lossy(&checked.get_output().stdout).into_owned();
    assert!(
        said.matches(place).count() == 1 && said.contains("unknown field `foo`"),
        "{said}"
    );
}

#[test]
fn a_refused_file_says_what_it_is_and_how_large() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tiny.gguf");
    let (from, to) = (fixture("tiny_llava"), file.to_str().unwrap());
    let quantize = ["models", "quantize", from.to_str().unwrap(), "--to", "f16"];
    planagent(&[&quantize[..], &["--out", to]].concat())
        .assert()
        .success();
    // A decoder that shows itself as part of a vision model is not opened without its tower.
    std::fs::remove_file(folder.path().join("mmproj-tiny.gguf")).unwrap();
    let checked = planagent(&["models", "check", to]).assert().code(1);
    let said = String::from_utf8_lossy(&checked.get_output().stdout).into_owned();
    assert!(
        said.contains("GGUF of architecture llama") && said.contains(" K parameters"),
        "{said}"
    );
    assert!(
        said.contains("by its token <image>") && said.contains("`vision = false`"),
        "{said}"
    );
    let shown = planagent(&["models", "show", to]).assert().code(1);
    let said = String::from_utf8_lossy(&shown.get_output().stdout).into_owned();
    assert!(
        said.contains("GGUF of architecture llama") && said.contains("K\n"),
        "{said}"
    );
}

#[test]
fn a_plan_with_quantised_weights_says_how_they_are_held() {
    let output = planagent(&[
        "plan",
        "--model",
        "nano",
        "--quantize",
        "q8_0",
        "--verbose",
        "--json",
    ])
    .assert()
    .success();
    let text = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
    assert!(text.contains("q8_0: 56 tensors"), "{text}");
}
