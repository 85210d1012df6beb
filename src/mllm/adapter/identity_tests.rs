//! An adapter is a part of what a model is.

use super::AdapterSpec;
use super::test_adapter::{Made, pair, peft};
use crate::local::test_reference::fixture;
use crate::local::{Loading, LocalModel};
use crate::registry::ModelSpec;
use crate::source::ModelPlace;
use crate::{HubAccess, MemoryCheck, Mllm, MllmError, ModelRegistry, Trust};
use serde_json::json;
use std::path::Path;
use tempfile::TempDir;

const Q: &str = "model.language_model.layers.0.self_attn.q_proj";

fn tiny() -> ModelPlace {
    ModelPlace::Folder(fixture("tiny_llava"))
}

/// An adapter of the tiny LLaVA.
fn adapter(alpha: f64) -> TempDir {
    let tensors: [Made; 2] = pair(Q, [32, 32], 4);
    peft(&json!({"lora_alpha": alpha}), &tensors)
}

fn registry(adapter: Option<&Path>) -> ModelRegistry {
    let offline = HubAccess {
        offline: true,
        ..HubAccess::default()
    };
    ModelRegistry::new("nowhere", offline)
        .with_trust(Trust::Caller)
        .with_memory_check(MemoryCheck::Ignore)
        .with_adapter(adapter.map(AdapterSpec::new))
}

fn loaded(adapter: Option<&Path>) -> LocalModel {
    let loading = Loading {
        adapter: adapter.map(AdapterSpec::new),
        ..Loading::default()
    };
    LocalModel::load("tiny", &tiny(), &loading).unwrap()
}

#[test]
fn digests_and_reports_have_the_adapter() {
    let (one, other) = (adapter(6.0), adapter(7.0));
    let digest = |folder: Option<&Path>| {
        let registry = registry(folder);
        let spec = registry
            .find(fixture("tiny_llava").to_str().unwrap())
            .unwrap();
        registry
            .inputs(&spec)
            .unwrap()
            .description
            .get("adapter")
            .cloned()
    };
    assert_eq!(digest(None), None);
    let first = digest(Some(one.path())).unwrap();
    assert_ne!(digest(Some(other.path())).unwrap(), first);
    let moved = adapter(6.0);
    assert_eq!(
        digest(Some(moved.path())).unwrap(),
        first,
        "a moved folder is the same"
    );

    let plain = loaded(None).describe();
    let about = loaded(Some(one.path())).describe();
    assert_ne!(plain.weights_blake3, about.weights_blake3);
    assert_eq!(plain.load.adapter, None);
    let merged = about.load.adapter.unwrap();
    assert_eq!((merged.tensors, merged.kind.as_str()), (1, "LoRA"));
    assert!(
        about
            .load
            .notes
            .iter()
            .any(|note| note.contains("for org/base"))
    );
}

#[test]
fn checks_and_outlines_name_the_adapter_and_its_faults() {
    let folder = adapter(6.0);
    let with = registry(Some(folder.path()));
    let spec = with.find(fixture("tiny_llava").to_str().unwrap()).unwrap();
    let check = with.check(&spec).unwrap();
    assert_eq!(check.problems, Vec::<String>::new());
    assert_eq!(check.load.adapter.map(|adapter| adapter.tensors), Some(1));
    let outline = with.outline(&spec).unwrap();
    assert_eq!(outline.adapter.map(|adapter| adapter.tensors), Some(1));

    let foreign = peft(
        &json!({}),
        &pair("model.layers.40.self_attn.q_proj", [32, 32], 4),
    );
    let with = registry(Some(foreign.path()));
    let check = with.check(&spec).unwrap();
    let [problem] = check.problems.as_slice() else {
        panic!("{:?}", check.problems)
    };
    assert!(
        problem.contains("layers.40") && problem.contains("org/base"),
        "{problem}"
    );
    assert!(with.outline(&spec).is_err());
}

#[test]
fn a_description_names_an_adapter_beside_it() {
    let parse = |text: &str| {
        let whole =
            format!("name = 'n'\nsource = {{ folder = 'f' }}\nprompt_set = 'paper'\n{text}");
        ModelSpec::parse(Path::new("models/x.toml"), &whole)
    };
    let found = |text: &str| parse(text).unwrap().adapter;
    assert_eq!(found(""), None);
    assert_eq!(found("adapter = 'a'"), Some(AdapterSpec::new("models/a")));
    let table = found("adapter = { folder = 'a', changed_base = true }");
    let expected = AdapterSpec {
        changed_base: true,
        ..AdapterSpec::new("models/a")
    };
    assert_eq!(table, Some(expected));
    let written = serde_json::to_value(AdapterSpec::new("a")).unwrap();
    assert_eq!(written, json!("a"));
    for wrong in [
        "adapter = 3",
        "adapter = { path = 'a', scale = 2 }",
        "adapter = {}",
    ] {
        let error = parse(wrong).unwrap_err().to_string();
        assert!(error.contains("expected the path of an adapter"), "{error}");
    }
    let server = "name = 'n'\nsource = { endpoint = 'https://a.b/v1', model = 'm', grammar = 'json_schema' }\n\
        prompt_set = 'paper'\nadapter = 'a'";
    let error = ModelSpec::parse(Path::new("x.toml"), server).unwrap_err();
    assert!(matches!(error, MllmError::Description { problem, .. } if problem.contains("adapter")));
}

#[test]
fn a_folder_with_weights_and_an_adapter_needs_a_choice() {
    let (work, adapter) = (tempfile::tempdir().unwrap(), adapter(6.0));
    let copy = |from: &Path| {
        for entry in std::fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, work.path().join(path.file_name().unwrap())).unwrap();
        }
    };
    copy(&fixture("tiny_llava"));
    copy(adapter.path());
    let open = |spec: Option<AdapterSpec>| {
        let loading = Loading {
            adapter: spec,
            ..Loading::default()
        };
        loading
            .open(&ModelPlace::Folder(work.path().to_path_buf()))
            .map(|_| ())
    };
    let error = open(None).unwrap_err().to_string();
    assert!(error.contains("--adapter"), "{error}");
    assert!(open(Some(AdapterSpec::new(work.path()))).is_ok());
}
