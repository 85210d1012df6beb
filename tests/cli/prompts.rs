//! Where prompts come from: the model's own files, its description, a flag, a folder on disk.

use super::{SCENE, planagent, read_json, refused};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const PROMPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/prompts");

/// Runs in a folder without models and prompts on disk.
fn in_folder(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = planagent()
        .env_remove("PLANAGENT_MODELS")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

fn manifest(run: &Path) -> toml::Table {
    fs::read_to_string(run.join("manifest.toml"))
        .unwrap()
        .parse()
        .unwrap()
}

fn copy_prompts(set: &str, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(Path::new(PROMPTS).join(set)).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
    }
}

#[test]
fn nano_as_gguf_and_as_a_folder_is_asked_as_it_was_trained() {
    let work = TempDir::new().unwrap();
    let (code, _, stderr) = in_folder(
        work.path(),
        &[
            "models",
            "quantize",
            "nano",
            "--to",
            "f32",
            "--out",
            "nano.gguf",
        ],
    );
    assert_eq!(code, 0, "{stderr}");
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/models/nano");
    let mut answers = Vec::new();
    for (out, model) in [("a", "nano"), ("b", "nano.gguf"), ("c", folder)] {
        let (code, _, stderr) = in_folder(
            work.path(),
            &[
                "simulate",
                "--scenario",
                SCENE,
                "--model",
                model,
                "--out",
                out,
            ],
        );
        assert_eq!(code, 0, "{model}: {stderr}");
        let prompts = manifest(&work.path().join(out))["prompts"]
            .as_table()
            .unwrap()
            .clone();
        assert_eq!(
            (prompts["set"].as_str(), prompts["place"].as_str()),
            (Some("compact-2"), Some("built in")),
            "{model}"
        );
        let named_by = if model == "nano" {
            "the model's description"
        } else {
            "planagent.json of the model"
        };
        assert_eq!(prompts["named_by"].as_str(), Some(named_by));
        let row = &read_json(&work.path().join(out).join("summary.json"))["scenarios"][0];
        assert!(row["succeeded"].as_bool().unwrap(), "{row}");
        answers.push(row["score"].clone());
    }
    // f32 holds nano's weights exactly.
    assert!(
        answers.iter().all(|score| score == &answers[0]),
        "{answers:?}"
    );
    let (code, stdout, _) = in_folder(work.path(), &["config", "--model", "nano.gguf"]);
    assert!(
        code == 0 && stdout.contains("compact-2 (planagent.json of the model): built in"),
        "{stdout}"
    );
}

#[test]
fn a_prompt_set_is_chosen_by_a_flag() {
    let work = TempDir::new().unwrap();
    copy_prompts("compact", &work.path().join("own"));
    let out = work.path().join("run");
    let flags = [
        "simulate",
        "--scenario",
        SCENE,
        "--prompt-set",
        "./own",
        "--out",
        "run",
    ];
    let (code, _, stderr) = in_folder(work.path(), &flags);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stderr.contains("prompts ") && stderr.contains("(reasoning.prompt_set)"),
        "{stderr}"
    );
    let manifest = manifest(&out);
    assert_eq!(
        manifest["prompts"]["named_by"].as_str(),
        Some("reasoning.prompt_set")
    );
    assert_eq!(manifest["prompts"]["built_in"].as_bool(), Some(false));
    assert!(Path::new(manifest["prompts"]["place"].as_str().unwrap()).is_absolute());
    // Edited prompts are other prompts: the run is not resumed with them.
    fs::write(work.path().join("own/system.jinja"), "drive well").unwrap();
    fs::remove_file(out.join("summary.json")).unwrap();
    let (code, _, stderr) = in_folder(work.path(), &["simulate", "--resume", "run"]);
    assert!(
        code == 2 && stderr.contains("prompt set changed: own/system.jinja"),
        "{stderr}"
    );
    let unknown = refused(&["plan", "--prompt-set", "long"]);
    assert!(
        unknown.contains("prompt set 'long' is neither built in"),
        "{unknown}"
    );
}

#[test]
fn edited_prompts_are_used_and_shown() {
    let work = TempDir::new().unwrap();
    let text = |arguments: &[&str]| {
        let (code, stdout, stderr) = in_folder(work.path(), arguments);
        assert_eq!(code, 0, "{stderr}");
        stdout
    };
    assert!(
        text(&["config"]).contains("# compact-2 (the model's description): built in"),
        "{}",
        text(&["config"])
    );
    let listed = text(&["models", "list", "--json"]);
    let mut models = listed
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let listed = models.find(|model| model["model"] == "nano").unwrap();
    let said = |key: &str| listed[key].as_str().map(str::to_owned);
    assert_eq!(
        (said("model"), said("source")),
        (Some("nano".into()), Some("built in".into()))
    );
    assert_eq!(
        (said("description"), said("prompts")),
        (Some("built in".into()), Some("built in".into()))
    );

    let prompts = work.path().join("prompts/compact-2");
    copy_prompts("compact-2", &prompts);
    fs::write(
        prompts.join("understanding.jinja"),
        "{{ scene_text }}\nEDITED scene?",
    )
    .unwrap();
    assert!(
        text(&["config"]).contains("# compact-2 (the model's description): prompts/compact-2"),
        "{}",
        text(&["config"])
    );
    assert!(text(&["models", "list"]).contains("prompts in prompts/compact-2"));
    let (code, stdout, stderr) = in_folder(work.path(), &["plan", "--scenario", SCENE]);
    assert!(code == 0 && stdout.contains("EDITED scene?"), "{stdout}");
    assert!(
        stderr.contains("prompts compact-2 (the model's description): prompts/compact-2")
            || stderr.contains("/prompts/compact-2"),
        "{stderr}"
    );

    // Half a set is no set.
    fs::remove_file(prompts.join("code.jinja")).unwrap();
    let (code, _, stderr) = in_folder(work.path(), &["plan", "--scenario", SCENE]);
    assert!(
        code == 2 && stderr.contains("prompts/compact-2/code.jinja"),
        "{stderr}"
    );
}

#[test]
fn a_description_names_prompts_beside_it() {
    let work = TempDir::new().unwrap();
    let folder = work.path().join("described");
    copy_prompts("compact-2", &folder.join("my_prompts"));
    let nano = concat!(env!("CARGO_MANIFEST_DIR"), "/models/nano");
    fs::write(
        folder.join("mine.toml"),
        format!("name = 'mine'\nsource = {{ folder = '{nano}' }}\nprompt_set = 'my_prompts'\n"),
    )
    .unwrap();
    let flags = ["--scenario", SCENE, "--json", "--model"];
    let plan = |model: &str| {
        let (code, stdout, stderr) =
            in_folder(work.path(), &[&["plan"], &flags[..], &[model]].concat());
        assert_eq!(code, 0, "{stderr}");
        let record: Value = serde_json::from_str(&stdout).unwrap();
        (record["attempts"][0]["rounds"].clone(), stderr)
    };
    let (rounds, stderr) = plan("described/mine.toml");
    assert!(
        stderr.contains("my_prompts (the model's description)"),
        "{stderr}"
    );
    assert_eq!(rounds, plan("nano").0);
}

#[test]
fn a_context_that_is_too_small_names_the_sets_that_fit() {
    let flags = ["plan", "--scenario", SCENE, "--model", "nano"];
    let small = ["--prompt-set", "paper", "--context", "600"];
    let error = refused(&[&flags[..], &small].concat());
    assert!(
        error.contains("context 600")
            && error.contains("prompt sets that fit: compact, compact-2 (--prompt-set compact)"),
        "{error}"
    );
    let error = refused(&[&flags[..], &["--context", "100"]].concat());
    assert!(
        error.contains("no built-in prompt set fits this context"),
        "{error}"
    );
}

#[test]
fn templates_of_a_stranger_end_and_say_why() {
    let loops = "{% for i in range(10000) %}".repeat(3) + &"{% endfor %}".repeat(3);
    for (file, text, problem) in [
        ("code.jinja", loops.as_str(), "more than 10000 steps"),
        (
            "system.jinja",
            "{% set a = 'x' * 1000000 %}{{ a | replace('x', a) | length }}",
            "does not multiply",
        ),
        (
            "understanding.jinja",
            "{% macro m() %}{{ m() }}{% endmacro %}{{ m() }}",
            "no statement macro",
        ),
        (
            "system.jinja",
            "{% for i in range(9999) %}{{ legend }}{{ legend }}{% endfor %}",
            "the rendered text has more than",
        ),
    ] {
        let work = TempDir::new().unwrap();
        copy_prompts("compact-2", &work.path().join("set"));
        fs::write(work.path().join("set").join(file), text).unwrap();
        let flags = ["simulate", "--scenario", SCENE, "--prompt-set", "./set"];
        let output = planagent()
            .args([&flags[..], &["--out", "run"]].concat())
            .current_dir(work.path())
            .timeout(std::time::Duration::from_mins(2))
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            [Some(1), Some(2)].contains(&output.status.code()) && said.contains(problem),
            "{file}: {:?}: {said}",
            output.status
        );
    }
}
