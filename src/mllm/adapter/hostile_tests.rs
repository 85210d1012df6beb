//! Broken and hostile adapters are errors that name the fault.

use super::test_adapter::{Made, embedding_pair, made, merge, pair, peft, weights};
use super::{Adapter, AdapterSpec};
use crate::checkpoint::Weights;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::path::Path;

const Q: &str = "model.layers.0.self_attn.q_proj";

fn base() -> Weights {
    weights(&[
        made(&format!("{Q}.weight"), &[6, 10]),
        made("model.embed_tokens.weight", &[12, 10]),
    ])
}

fn problem(folder: &Path) -> String {
    merge(folder, &mut base()).unwrap_err().to_string()
}

#[test]
fn settings_with_another_result_are_refused_with_their_key() {
    let tensors = pair(Q, [6, 10], 4);
    for (settings, said) in [
        (json!({"peft_type": "IA3"}), ["peft_type", "'IA3'"]),
        (
            json!({"peft_type": "PROMPT_TUNING"}),
            ["peft_type", "PROMPT_TUNING"],
        ),
        (json!({"peft_type": null}), ["peft_type", "missing"]),
        (
            json!({"peft_type": null, "fine_tune_type": "lora"}),
            ["mlx-lm", "fine_tune_type"],
        ),
        (
            json!({"layer_replication": [[0, 1]]}),
            ["layer_replication", "repeats"],
        ),
        (
            json!({"alora_invocation_tokens": [1]}),
            ["alora_invocation_tokens", "token sequence"],
        ),
        (json!({"use_qalora": true}), ["use_qalora", "not supported"]),
        (
            json!({"use_bdlora": {"a": 1}}),
            ["use_bdlora", "not supported"],
        ),
        (
            json!({"use_new_thing": 3}),
            ["use_new_thing", "merge_and_unload"],
        ),
        (json!({"newer": true}), ["newer", "may change"]),
        (
            json!({"init_lora_weights": "loftq"}),
            ["init_lora_weights", "changed_base"],
        ),
        (
            json!({"init_lora_weights": "corda"}),
            ["init_lora_weights", "corda"],
        ),
        (json!({"r": 8}), ["lora_A", "rank 8"]),
        (json!({"r": -1}), ["adapter_config.json", "r:"]),
        (
            json!({"rank_pattern": {"q_proj": "x"}}),
            ["rank_pattern.q_proj", "adapter_config.json"],
        ),
        (json!({"rank_pattern": {"(": 4}}), ["rank_pattern", "("]),
        (
            json!({"target_modules": "(?P<"}),
            ["target_modules", "adapter_config.json"],
        ),
        (
            json!({"target_modules": [1]}),
            ["target_modules", "adapter_config.json"],
        ),
        (json!({"use_dora": true}), ["magnitude", "q_proj"]),
        (
            json!({"use_dora": true, "target_parameters": ["mlp.experts.down_proj"]}),
            ["use_dora", "experts"],
        ),
        (
            json!({"layers_to_transform": "x"}),
            ["layers_to_transform", "adapter_config.json"],
        ),
        (
            json!({"trainable_token_indices": {"a": [-1]}}),
            ["trainable_token_indices.a", "adapter_config.json"],
        ),
    ] {
        let folder = peft(&settings, &tensors);
        let found = problem(folder.path());
        assert!(
            said.iter().all(|said| found.contains(said)),
            "{settings}: {found}"
        );
    }
    // With the base that its trainer changed, an adapter is an ordinary one.
    let folder = peft(&json!({"init_lora_weights": "loftq"}), &tensors);
    let spec = AdapterSpec {
        changed_base: true,
        ..AdapterSpec::new(folder.path())
    };
    assert!(Adapter::open(&spec).is_ok());
}

#[test]
fn tensors_that_do_not_belong_are_refused_by_name() {
    let whole = pair(Q, [6, 10], 4);
    let other =
        |name: &str, shape: &[usize]| vec![whole[0].clone(), whole[1].clone(), made(name, shape)];
    let tokens = "base_model.model.model.embed_tokens.token_adapter.trainable_tokens_delta";
    let cases: Vec<(Value, Vec<Made>, [&str; 2])> = vec![
        (json!({}), whole[..1].to_vec(), ["q_proj", "only one"]),
        (
            json!({}),
            pair("model.layers.7.self_attn.q_proj", [6, 10], 4).to_vec(),
            ["layers.7", "'test' model"],
        ),
        (
            json!({}),
            pair(Q, [10, 6], 4).to_vec(),
            ["does not fit", "org/base"],
        ),
        (json!({}), pair(Q, [6, 10], 0).to_vec(), ["q_proj", "rank"]),
        (
            json!({}),
            other("lora_A", &[4]),
            ["lora_A", "base_model.model."],
        ),
        (
            json!({}),
            other("base_model.model.a.lora_A.default.weight", &[4, 4]),
            ["default", "base_model.model."],
        ),
        (
            json!({"modules_to_save": ["score"]}),
            other("base_model.model.score.weight", &[2, 10]),
            ["score", "match no tensor"],
        ),
        (
            json!({}),
            other("base_model.model.model.embed_tokens.weight", &[13, 10]),
            ["embed_tokens", "does not fit"],
        ),
        (
            json!({}),
            other(&format!("base_model.model.{Q}.lora_magnitude_vector"), &[6]),
            ["magnitude", "use_dora is not set"],
        ),
        (
            json!({"use_dora": true}),
            other(&format!("base_model.model.{Q}.lora_magnitude_vector"), &[5]),
            ["does not fit", "q_proj"],
        ),
        (
            json!({"lora_bias": true}),
            other(&format!("base_model.model.{Q}.lora_B.bias"), &[6]),
            ["lora_B.bias", "match no tensor"],
        ),
        (
            json!({}),
            other(tokens, &[1, 10]),
            ["trainable_token_indices", "token_adapter"],
        ),
        (
            json!({"trainable_token_indices": [1, 2]}),
            other(tokens, &[1, 10]),
            ["2 tokens", "token_adapter"],
        ),
        (
            json!({"trainable_token_indices": [12]}),
            other(tokens, &[1, 10]),
            ["does not fit", "token_adapter"],
        ),
        (
            json!({"trainable_token_indices": [2]}),
            other(tokens, &[1, 9]),
            ["does not fit", "token_adapter"],
        ),
        (
            json!({}),
            embedding_pair("model.embed_tokens", [13, 10], 4).to_vec(),
            ["does not fit", "embed_tokens"],
        ),
        (json!({}), Vec::new(), ["no tensors", "adapter"]),
    ];
    for (settings, tensors, said) in cases {
        let folder = peft(&settings, &tensors);
        let found = problem(folder.path());
        let said = said.map(|said| said.replace("'test'", "test"));
        assert!(
            said.iter().all(|said| found.contains(said.as_str())),
            "{said:?}: {found}"
        );
    }
}

#[test]
fn numbers_that_are_not_finite_are_found_when_they_are_merged() {
    for (value, alpha) in [(f32::NAN, 6.0), (f32::INFINITY, 6.0), (1e30, 1e30)] {
        let mut tensors = pair(Q, [6, 10], 4);
        tensors[1].2[3] = value;
        let folder = peft(&json!({"lora_alpha": alpha}), &tensors);
        let mut weights = base();
        merge(folder.path(), &mut weights).unwrap();
        let error = weights
            .take(&format!("{Q}.weight"), &[6, 10])
            .unwrap_err()
            .to_string();
        assert!(error.contains("q_proj"), "{error}");
    }
}

#[test]
fn folders_without_an_adapter_say_what_they_lack() {
    let folder = tempfile::tempdir().unwrap();
    let found = problem(folder.path());
    assert!(found.contains("adapter_config.json"), "{found}");
    std::fs::write(folder.path().join("adapters.safetensors"), "").unwrap();
    assert!(problem(folder.path()).contains("mlx-lm"));
    let folder = peft(&json!({}), &pair(Q, [6, 10], 4));
    std::fs::remove_file(folder.path().join("adapter_model.safetensors")).unwrap();
    assert!(problem(folder.path()).contains("adapter_model.safetensors"));
    std::fs::write(folder.path().join("adapter_model.bin"), "").unwrap();
    assert!(problem(folder.path()).contains("may run code"));
    assert!(problem(&folder.path().join("nowhere")).contains("no such adapter"));
    std::fs::write(folder.path().join("adapter_config.json"), "[1]").unwrap();
    assert!(problem(folder.path()).contains("expected an object"));
}

#[test]
fn an_expression_that_takes_too_long_ends() {
    let module = format!("{}{Q}", "a".repeat(60));
    let folder = peft(
        &json!({"target_modules": "(?=(a+)+$)(a+)+b", "rank_pattern": {"(a|a)*\\1c": 4}}),
        &pair(&module, [6, 10], 4),
    );
    assert!(problem(folder.path()).contains("match no tensor"));
}

proptest! {
    #[test]
    fn any_settings_and_shapes_are_errors_or_merged(
        rank in 0_usize..6,
        a in proptest::collection::vec(0_usize..7, 1..4),
        b in proptest::collection::vec(0_usize..7, 1..4),
        key in proptest::sample::select(vec!["use_dora", "use_rslora", "fan_in_fan_out", "lora_bias", "ensure_weight_tying"]),
        init in proptest::sample::select(vec!["pissa", "olora", "eva"]),
        module in proptest::sample::select(vec![Q, "model.embed_tokens", "lm_head", "a.experts.base_layer"]),
        embedding in any::<bool>(),
    ) {
        let [left, right] = if embedding { ["lora_embedding_A", "lora_embedding_B"] } else { ["lora_A.weight", "lora_B.weight"] };
        let tensors = [
            made(&format!("base_model.model.{module}.{left}"), &a),
            made(&format!("base_model.model.{module}.{right}"), &b),
        ];
        let mut settings = json!({"r": rank, "init_lora_weights": init, "target_parameters": ["experts.x", "experts.down"]});
        settings[key] = json!(true);
        let folder = peft(&settings, &tensors);
        let mut weights = base();
        if merge(folder.path(), &mut weights).is_ok() {
            let shapes: Vec<(String, Vec<usize>)> =
                weights.shapes().map(|(name, shape)| (name.to_owned(), shape.to_vec())).collect();
            for (name, shape) in shapes {
                let _ = weights.take(&name, &shape);
            }
        }
    }
}
