//! Checkpoints in forms that are not read: one sentence says what to take instead. Checks name all
//! faults at once.

use super::Copy;
use planagent_mllm::{HubAccess, MemoryCheck, ModelRegistry, Trust};
use safetensors::Dtype;
use serde_json::json;
use std::fs;

const POINTER: &str = "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 4\n";

/// The faults that `models check` finds.
fn problems(copy: &Copy) -> Vec<String> {
    let registry = ModelRegistry::new(
        "models",
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    )
    .with_trust(Trust::Caller)
    .with_memory_check(MemoryCheck::Ignore);
    registry
        .check(&registry.find(copy.folder().to_str().unwrap()).unwrap())
        .unwrap()
        .problems
}

#[test]
fn pointers_of_git_lfs_are_recognized() {
    for file in [
        "model.safetensors",
        "tokenizer.json",
        "config.json",
        "chat_template.jinja",
    ] {
        let copy = Copy::new();
        fs::write(copy.path(file), POINTER).unwrap();
        let error = copy.error().to_string();
        assert!(
            error.contains(file) && error.contains("`git lfs pull`"),
            "{error}"
        );
    }
}

#[test]
fn weights_that_are_not_read_are_named_with_what_to_take() {
    let quantized = Copy::new();
    quantized.edit("config.json", |config| {
        config["quantization_config"] = json!({"quant_method": "hqq", "bits": 4});
    });
    quantized.edit_tensors(|tensors| {
        let gate = tensors
            .get_mut("language_model.model.layers.1.mlp.gate_proj.weight")
            .unwrap();
        gate.0 = Dtype::I32;
    });
    let error = quantized.error().to_string();
    assert!(
        error.contains("quantization_config.quant_method") && error.contains("original repository"),
        "{error}"
    );

    let bytes = Copy::new();
    bytes.edit_tensors(|tensors| {
        let gate = tensors
            .get_mut("language_model.model.layers.1.mlp.gate_proj.weight")
            .unwrap();
        (gate.0, gate.2) = (
            Dtype::F8_E4M3,
            gate.2.chunks(4).map(|number| number[3]).collect(),
        );
    });
    let error = bytes.error().to_string();
    assert!(
        error.contains("F8_E4M3") && error.contains("original repository"),
        "{error}"
    );

    let original = Copy::new();
    original.edit("config.json", |config| {
        config["mm_vision_tower"] = json!("openai/clip-vit-large-patch14-336");
    });
    assert!(
        original
            .error()
            .to_string()
            .contains("llava-hf/llava-1.5-7b-hf")
    );

    let adapter = Copy::new();
    fs::write(
        adapter.path("adapter_config.json"),
        r#"{"base_model_name_or_path": "org/base"}"#,
    )
    .unwrap();
    assert!(
        adapter
            .error()
            .to_string()
            .contains("an adapter for 'org/base'")
    );

    let pickled = Copy::new();
    fs::rename(
        pickled.path("model.safetensors"),
        pickled.path("pytorch_model.bin"),
    )
    .unwrap();
    assert!(
        pickled
            .error()
            .to_string()
            .contains("pytorch_model.bin is not read")
    );
}

#[test]
fn a_chat_template_may_lie_in_the_processors_configuration() {
    let copy = Copy::new();
    let template = fs::read_to_string(copy.path("chat_template.jinja")).unwrap();
    fs::remove_file(copy.path("chat_template.jinja")).unwrap();
    let processor = json!({"processor_class": "LlavaProcessor", "chat_template": template});
    fs::write(copy.path("processor_config.json"), processor.to_string()).unwrap();
    assert_eq!(problems(&copy), Vec::<String>::new());
}

#[test]
fn faults_of_all_files_are_named_at_once() {
    let copy = Copy::new();
    fs::write(copy.path("model.safetensors"), POINTER).unwrap();
    fs::remove_file(copy.path("chat_template.jinja")).unwrap();
    copy.edit("generation_config.json", |config| {
        config["eos_token_id"] = json!(70_000);
    });
    let found = problems(&copy);
    assert!(
        found.iter().any(|problem| problem.contains("git-lfs")),
        "{found:?}"
    );
    assert!(
        found
            .iter()
            .any(|problem| problem.contains("chat_template.jinja")),
        "{found:?}"
    );
    assert!(
        found.iter().any(|problem| problem.contains("70000")),
        "{found:?}"
    );

    let copy = Copy::new();
    copy.edit("config.json", |config| {
        config["text_config"]["hidden_act"] = json!("relu");
    });
    fs::remove_file(copy.path("tokenizer.json")).unwrap();
    let found = problems(&copy);
    assert!(
        found.iter().any(|problem| problem.contains("hidden_act")),
        "{found:?}"
    );
    assert!(
        found
            .iter()
            .any(|problem| problem.contains("tokenizer.json")),
        "{found:?}"
    );
    assert_eq!(found.len(), 2, "{found:?}");
}
