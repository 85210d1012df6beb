//! Chat templates and tokenizers that hang, kill or grow without end. A child process tries them
//! first, within limits.

use super::{Copy, fixture};
use assert_cmd::Command;
use planagent_mllm::trial::Trial;
use planagent_mllm::{GgufPart, HubAccess, MllmError, ModelRegistry, Trust, WeightFormat};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// A check of any model ends within this time.
const MAX_CHECK: Duration = Duration::from_secs(20);
const TEMPLATE: &str = "chat_template.jinja";
/// A template that ends, for those that only tokenizers make hostile.
const DOUBLES: &str = "{% set n = namespace(s='0123456789') %}{% for i in range(40) %}{% set n.s = n.s ~ n.s %}{% endfor %}{{ n.s|length }}";

fn planagent(cache: &Path) -> Command {
    let mut command = Command::cargo_bin("planagent").unwrap();
    command.env("PLANAGENT_CACHE", cache).env("NO_COLOR", "1");
    command
}

/// The problems that a check of a model reports.
fn problems(model: &Path) -> Vec<String> {
    let cache = tempfile::tempdir().unwrap();
    let started = Instant::now();
    let output = planagent(cache.path())
        .args(["models", "check", "--json"])
        .arg(model)
        .output()
        .unwrap();
    let (took, stderr) = (
        started.elapsed(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    assert!(took < MAX_CHECK, "{}: {took:?}", model.display());
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    let row: Value = serde_json::from_slice(&output.stdout).unwrap();
    row["problems"]
        .as_array()
        .unwrap()
        .iter()
        .map(|problem| problem.as_str().unwrap().to_owned())
        .collect()
}

/// The only problem.
fn problem(model: &Path) -> String {
    let problems = problems(model);
    assert_eq!(problems.len(), 1, "{problems:?}");
    problems.into_iter().next().unwrap()
}

/// A copy of the tiny LLaVA with a chat template.
fn with_template(source: &str) -> Copy {
    let copy = Copy::new();
    fs::write(copy.path(TEMPLATE), source).unwrap();
    copy
}

fn with_tokenizer(edit: impl FnOnce(&mut Value)) -> Copy {
    let copy = Copy::new();
    copy.edit("tokenizer.json", edit);
    copy
}

#[test]
fn templates_without_end_are_problems_and_nothing_hangs() {
    let endless = "{% for a in range(99999) %}{% for b in range(99999) %}{% endfor %}{% endfor %}probe<image>";
    for (source, said) in [
        (endless.to_owned(), "more than 500000 steps"),
        (DOUBLES.to_owned(), "child process"),
        (
            format!("{{{{ {}true }}}}", "not ".repeat(10_000)),
            "chat template",
        ),
        (
            format!("{{{{ 1{} }}}}", "+1".repeat(20_000)),
            "chat template",
        ),
        (
            format!("{{{{ {}true }}}}", "not ".repeat(100_000)),
            "chat template",
        ),
        (
            format!("{{{{ 1{} }}}}", "+1".repeat(100_000)),
            "chat template",
        ),
        (" ".repeat(100_000), "at most 65536 are read"),
        (" ".repeat(2_000_000), "at most 1048576 are read"),
    ] {
        let found = problem(with_template(&source).folder());
        assert!(
            found.contains(said),
            "{}: {found}",
            &source[..60.min(source.len())]
        );
    }
}

#[test]
fn tokenizers_without_end_are_problems_and_nothing_hangs() {
    let doubling: Vec<Value> =
        vec![json!({"type": "Replace", "pattern": {"String": "e"}, "content": "ee"}); 40];
    for (key, value) in [
        (
            "normalizer",
            json!({"type": "Sequence", "normalizers": doubling}),
        ),
        (
            "normalizer",
            json!({"type": "Precompiled", "precompiled_charsmap": "/////w=="}),
        ),
    ] {
        let found = problem(with_tokenizer(|tokenizer| tokenizer[key] = value.clone()).folder());
        assert!(
            found.contains("the tokenizer ") && found.contains("child process"),
            "{found}"
        );
        assert!(found.contains("--trust-model"), "{found}");
    }
    let backtracking = json!({
        "type": "Split", "pattern": {"Regex": "(?=(.*))(a|e|.)*\\1(?!.)x"}, "behavior": "Isolated", "invert": false,
    });
    let copy = with_tokenizer(|tokenizer| tokenizer["pre_tokenizer"] = backtracking.clone());
    let cache = tempfile::tempdir().unwrap();
    let started = Instant::now();
    planagent(cache.path())
        .args(["models", "check"])
        .arg(copy.folder())
        .output()
        .unwrap();
    assert!(started.elapsed() < MAX_CHECK, "{:?}", started.elapsed());
    // A pattern that the library backtracks on, where a text has many of the same letter.
    let nested = json!({
        "type": "Split", "pattern": {"Regex": "(a|a|[a-z ]+)*(x+x+)+y"}, "behavior": "Isolated", "invert": false,
    });
    let copy = with_tokenizer(|tokenizer| tokenizer["pre_tokenizer"] = nested);
    let output = planagent(cache.path())
        .args(["models", "check"])
        .arg(copy.folder())
        .timeout(MAX_CHECK)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code().is_some() && !stderr.contains("panicked"),
        "{stderr}"
    );
    let vocabulary = with_tokenizer(|_| {});
    vocabulary.edit("config.json", |config| {
        config["text_config"]["vocab_size"] = json!(1_u64 << 50);
    });
    assert!(!problems(vocabulary.folder()).is_empty());
}

/// A template in the metadata of a GGUF file is tried as one in a folder.
#[test]
fn a_hostile_gguf_file_is_a_problem() {
    let (copy, folder) = (with_template(DOUBLES), tempfile::tempdir().unwrap());
    let file = folder.path().join("m.gguf");
    let registry = ModelRegistry::new("models", HubAccess::default()).with_trust(Trust::Caller);
    let spec = registry.find(copy.folder().to_str().unwrap()).unwrap();
    let mut create = |part: GgufPart| -> std::io::Result<Box<dyn Write>> {
        Ok(Box::new(File::create(part.path(&file))?))
    };
    registry
        .export(&spec, WeightFormat::Q8_0, &mut create, &mut |_, _| {})
        .unwrap();
    let found = problem(&file);
    assert!(
        found.contains("the chat template ") && found.contains("child process"),
        "{found}"
    );
    let cache = tempfile::tempdir().unwrap();
    let output = planagent(cache.path())
        .args(["plan", "--model"])
        .arg(&file)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(2) && stderr.contains("child process"),
        "{stderr}"
    );
}

#[test]
fn files_that_pass_are_tried_once_for_each_content() {
    let (copy, cache) = (Copy::new(), tempfile::tempdir().unwrap());
    let verdicts = || fs::read_dir(cache.path().join("models")).map_or(0, Iterator::count);
    let check = || {
        let output = planagent(cache.path())
            .args(["models", "check"])
            .arg(copy.folder())
            .output()
            .unwrap();
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stdout)
        );
    };
    check();
    assert_eq!(verdicts(), 1);
    check();
    assert_eq!(verdicts(), 1);
    let template = fs::read_to_string(copy.path(TEMPLATE)).unwrap();
    fs::write(copy.path(TEMPLATE), template + "{# another #}").unwrap();
    check();
    assert_eq!(verdicts(), 2);
    // A program that cannot be started cannot have tried a content that is new, and need not for
    // one that is known.
    let trial = |program: &str| Trust::Trial(Trial::by(program, &[], []));
    let registry = ModelRegistry::new("models", HubAccess::default())
        .with_trust(trial("/nonexistent/program"));
    match registry.open(&registry.find(copy.folder().to_str().unwrap()).unwrap()) {
        Err(MllmError::Trial { problem, .. }) => {
            assert!(problem.contains("cannot run"), "{problem}");
        }
        other => panic!("{:?}", other.map(|model| model.name().to_owned())),
    }
}

#[test]
fn without_a_trial_somebody_has_to_vouch_for_a_folder() {
    let folder = fixture("tiny_llava");
    let registry = ModelRegistry::new("models", HubAccess::default());
    let spec = registry.find(folder.to_str().unwrap()).unwrap();
    assert!(matches!(
        registry.open(&spec),
        Err(MllmError::Untrusted { .. })
    ));
    let trusted = registry
        .find(folder.to_str().unwrap())
        .map(|spec| planagent_mllm::ModelSpec {
            trusted: true,
            ..spec
        });
    assert!(registry.open(&trusted.unwrap()).is_ok());
    assert!(
        registry
            .clone()
            .with_trust(Trust::Caller)
            .open(&spec)
            .is_ok()
    );
    let agent = |builder: planagent::AgentBuilder| {
        builder
            .model(folder.to_str().unwrap())
            .prompts("compact")
            .build()
    };
    let error = agent(planagent::Agent::builder()).unwrap_err().to_string();
    assert!(error.contains("trust_model"), "{error}");
    agent(planagent::Agent::builder().trust_model()).unwrap();
}

/// A panic in the library that runs tokenizers is an error of the model, also where it is trusted.
#[test]
fn a_panic_of_a_trusted_tokenizer_is_an_error() {
    let charsmap = json!({"type": "Precompiled", "precompiled_charsmap": "/////w=="});
    let copy = with_tokenizer(|tokenizer| tokenizer["normalizer"] = charsmap);
    let registry = ModelRegistry::new("models", HubAccess::default()).with_trust(Trust::Caller);
    let spec = registry.find(copy.folder().to_str().unwrap()).unwrap();
    assert!(matches!(
        registry.open(&spec),
        Err(MllmError::Panicked { .. })
    ));
    let cache = tempfile::tempdir().unwrap();
    let arguments = ["models", "check", "--trust-model", "--json"];
    let output = planagent(cache.path())
        .args(arguments)
        .arg(copy.folder())
        .output()
        .unwrap();
    let row: Value = serde_json::from_slice(&output.stdout).unwrap();
    let problem = row["problems"][0].as_str().unwrap();
    assert!(
        output.status.code() == Some(1) && problem.contains("opening the model panicked"),
        "{problem}"
    );
}

/// A small file of any size, or a pipe in its place, is refused before it is read.
#[test]
fn small_files_have_limits() {
    for (name, bytes) in [
        ("config.json", 2 << 20),
        ("tokenizer.json", 200 << 20),
        ("tokenizer_config.json", 20 << 20),
    ] {
        let copy = Copy::new();
        File::create(copy.path(name))
            .unwrap()
            .set_len(bytes)
            .unwrap();
        let found = problem(copy.folder());
        assert!(
            found.contains(name) && found.contains("are read"),
            "{found}"
        );
    }
    let copy = Copy::new();
    for number in 0..300 {
        fs::write(copy.path(&format!("{number}.json")), "{}").unwrap();
    }
    assert!(problem(copy.folder()).contains("more than 256 small files"));
}
