//! Broken checkpoints give typed errors that name the cause, and never a panic.

use super::{Copy, FIRST, free, prefix};
use planagent_mllm::{Mllm, MllmError};
use proptest::prelude::*;
use safetensors::Dtype;
use serde_json::{Value, json};

const GATE: &str = "language_model.model.layers.1.mlp.gate_proj.weight";

#[test]
fn every_file_that_is_needed_is_missed() {
    let all = [
        "config.json",
        "model.safetensors",
        "tokenizer.json",
        "preprocessor_config.json",
        "chat_template.jinja",
    ];
    for (name, files) in [
        ("tiny_llava", &all[..]),
        ("tiny_llava_next", &all),
        ("tiny_cogvlm", &all[..3]),
    ] {
        for file in files {
            let copy = Copy::from_fixture(name);
            std::fs::remove_file(copy.path(file)).unwrap();
            match copy.error() {
                MllmError::MissingFile { file: missing, .. } => {
                    assert!(missing.contains(file), "{missing}");
                }
                other => panic!("{name}, {file}: {other}"),
            }
        }
    }
    let nowhere = planagent_mllm::LocalModel::open("x", std::path::Path::new("/nonexistent/model"));
    assert!(matches!(nowhere, Err(MllmError::MissingFile { .. })));
}

#[test]
fn a_missing_tensor_is_named() {
    for name in [
        GATE,
        "vision_tower.encoder.layers.2.mlp.fc2.bias",
        "multi_modal_projector.linear_1.bias",
    ] {
        let copy = Copy::new();
        copy.edit_tensors(|tensors| {
            tensors.remove(name).unwrap();
        });
        match copy.error() {
            MllmError::MissingTensor { name: missing, .. } => {
                assert_eq!(missing, name.replace(".model.", "."));
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn a_missing_or_misshapen_tensor_of_any_family_is_named() {
    for (folder, name) in [
        ("tiny_llava_next", "image_newline"),
        (
            "tiny_llava_next_mistral",
            "language_model.model.layers.0.self_attn.k_proj.weight",
        ),
        ("tiny_cogvlm", "model.vision.boi"),
        ("tiny_cogvlm", "model.vision.patch_embedding.proj.bias"),
        (
            "tiny_cogvlm",
            "model.vision.transformer.layers.2.attention.query_key_value.weight",
        ),
        ("tiny_cogvlm", "model.vision.linear_proj.gate_proj.weight"),
        (
            "tiny_cogvlm",
            "model.layers.1.self_attn.vision_expert_query_key_value.weight",
        ),
        (
            "tiny_cogvlm",
            "model.layers.1.mlp.language_mlp.down_proj.weight",
        ),
    ] {
        let copy = Copy::from_fixture(folder);
        copy.edit_tensors(|tensors| drop(tensors.remove(name).unwrap()));
        let canonical = name
            .replacen("model.", "", usize::from(name.starts_with("model.")))
            .replace("_model.model.", "_model.");
        assert!(
            matches!(copy.error(), MllmError::MissingTensor { name, .. } if name == canonical),
            "{name}"
        );

        let copy = Copy::from_fixture(folder);
        copy.edit_tensors(|tensors| tensors.get_mut(name).unwrap().1.push(1));
        assert!(
            matches!(copy.error(), MllmError::TensorShape { name: found, .. } if found == name),
            "{name}"
        );
    }
}

#[test]
fn wrong_keys_of_other_families_are_named() {
    for (folder, key, value, named) in [
        (
            "tiny_llava_next",
            "model_type",
            json!("vipllava"),
            "model_type",
        ),
        (
            "tiny_llava_next",
            "image_grid_pinpoints",
            json!([[32, 33]]),
            "image_grid_pinpoints",
        ),
        (
            "tiny_llava_next",
            "image_grid_pinpoints",
            json!([[64, 64]]),
            "image_grid_pinpoints",
        ),
        (
            "tiny_llava_next",
            "vision_feature_select_strategy",
            json!("full"),
            "vision_feature_select_strategy",
        ),
        (
            "tiny_llava_next_mistral",
            "text_config.sliding_window",
            json!(0),
            "text_config.sliding_window",
        ),
        (
            "tiny_llava_next_mistral",
            "text_config.model_type",
            json!("mixtral"),
            "text_config.model_type",
        ),
        (
            "tiny_cogvlm",
            "architectures",
            json!(["CogVLMVideoForCausalLM"]),
            "architectures",
        ),
        ("tiny_cogvlm", "architectures", json!([]), "model_type"),
        (
            "tiny_cogvlm",
            "num_multi_query_heads",
            json!(8),
            "num_multi_query_heads",
        ),
        (
            "tiny_cogvlm",
            "template_version",
            json!("base"),
            "template_version",
        ),
        ("tiny_cogvlm", "bos_token_id", json!(344), "bos_token_id"),
        ("tiny_cogvlm", "hidden_act", json!("gelu"), "hidden_act"),
        (
            "tiny_cogvlm",
            "hidden_size",
            json!(1_u64 << 50),
            "hidden_size",
        ),
        (
            "tiny_cogvlm",
            "num_attention_heads",
            json!(5),
            "hidden_size",
        ),
        (
            "tiny_cogvlm",
            "max_position_embeddings",
            json!(-1),
            "max_position_embeddings",
        ),
        (
            "tiny_cogvlm",
            "vision_config.num_positions",
            json!(18),
            "vision_config.num_positions",
        ),
        (
            "tiny_cogvlm",
            "vision_config.num_heads",
            json!(7),
            "vision_config.hidden_size",
        ),
        (
            "tiny_cogvlm",
            "vision_config.in_channels",
            json!(1),
            "vision_config.in_channels",
        ),
        (
            "tiny_cogvlm",
            "vision_config.patch_size",
            json!(57),
            "vision_config.patch_size",
        ),
        (
            "tiny_cogvlm",
            "vision_config.image_size",
            json!(100_000),
            "vision_config.image_size",
        ),
    ] {
        let copy = Copy::from_fixture(folder);
        copy.edit("config.json", |config| set(config, key, value.clone()));
        match copy.error() {
            MllmError::Config { key: found, .. } => {
                assert_eq!(found, named, "{folder}: {key} = {value}");
            }
            other => panic!("{folder}: {key} = {value}: {other}"),
        }
    }
}

#[test]
fn preprocessors_of_another_kind_or_size_are_named() {
    for (key, value) in [
        ("image_processor_type", json!("CLIPImageProcessor")),
        ("size", json!({"shortest_edge": 48})),
        ("crop_size", json!(64)),
        ("image_grid_pinpoints", json!([[32, 64]])),
        ("resample", json!(9)),
        ("image_std", json!([0, 1, 1])),
    ] {
        let copy = Copy::from_fixture("tiny_llava_next");
        copy.edit("preprocessor_config.json", |config| config[key] = value);
        assert!(
            matches!(copy.error(), MllmError::Config { key: found, .. } if found == key),
            "{key}"
        );
    }
}

#[test]
fn a_misshapen_tensor_is_named_with_both_shapes() {
    let copy = Copy::new();
    copy.edit_tensors(|tensors| tensors.get_mut(GATE).unwrap().1 = vec![32, 64]);
    match copy.error() {
        MllmError::TensorShape {
            name,
            expected,
            found,
            ..
        } => {
            assert_eq!(
                (name.as_str(), expected, found),
                (GATE, vec![64, 32], vec![32, 64])
            );
        }
        other => panic!("{other}"),
    }
}

#[test]
fn weights_that_are_no_numbers_are_named() {
    for (value, element) in [
        (f32::NAN, 0),
        (f32::INFINITY, 77),
        (f32::NEG_INFINITY, 2047),
    ] {
        let copy = Copy::new();
        copy.edit_tensors(|tensors| {
            tensors.get_mut(GATE).unwrap().2[4 * element..4 * element + 4]
                .copy_from_slice(&value.to_le_bytes());
        });
        match copy.error() {
            MllmError::NonFiniteWeight {
                name,
                element: found,
                ..
            } => {
                assert_eq!((name.as_str(), found), (GATE, element));
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn another_number_format_is_named() {
    let copy = Copy::new();
    copy.edit_tensors(|tensors| tensors.get_mut(GATE).unwrap().0 = Dtype::I32);
    assert!(matches!(copy.error(), MllmError::TensorType { name, .. } if name == GATE));
}

#[test]
fn truncated_weights_are_an_error() {
    let whole = std::fs::read(Copy::new().path("model.safetensors")).unwrap();
    for length in [0, 7, 8, 100, 5000, whole.len() - 1] {
        let copy = Copy::new();
        std::fs::write(copy.path("model.safetensors"), &whole[..length]).unwrap();
        match copy.error() {
            MllmError::Safetensors { path, .. } => assert!(path.ends_with("model.safetensors")),
            other => panic!("{length}: {other}"),
        }
    }
}

#[test]
fn logits_that_overflow_are_an_error() {
    let copy = Copy::new();
    copy.edit_tensors(|tensors| {
        for name in [
            "language_model.lm_head.weight",
            "language_model.model.norm.weight",
        ] {
            for bytes in tensors.get_mut(name).unwrap().2.as_chunks_mut::<4>().0 {
                *bytes = 3e38f32.to_le_bytes();
            }
        }
    });
    let model = copy.open().unwrap();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    assert!(matches!(
        conversation.ask(FIRST, &free(3)),
        Err(MllmError::NonFiniteLogits { .. })
    ));
}

/// Sets the value at a dotted path.
fn set(config: &mut Value, path: &str, value: Value) {
    let mut place = config;
    for key in path.split('.') {
        place = &mut place[key];
    }
    *place = value;
}

#[test]
fn wrong_configuration_keys_are_named() {
    for (key, value) in [
        ("model_type", json!("blip")),
        ("text_config.model_type", json!("gemma")),
        ("text_config.hidden_size", json!("wide")),
        ("text_config.hidden_size", json!(-32)),
        ("text_config.num_attention_heads", json!(0)),
        ("text_config.num_key_value_heads", json!(3)),
        ("text_config.head_dim", json!(7)),
        ("text_config.vocab_size", json!(9e18)),
        ("text_config.num_hidden_layers", json!(1.5)),
        ("text_config.max_position_embeddings", json!(1_u64 << 40)),
        ("text_config.rms_norm_eps", json!(0)),
        ("text_config.attention_bias", json!("yes")),
        ("text_config.hidden_act", json!("gelu")),
        ("text_config.rope_parameters.rope_type", json!("longrope")),
        ("text_config.rope_parameters.rope_theta", json!(-1)),
        ("vision_config.model_type", json!("dinov2")),
        ("vision_config.patch_size", json!(64)),
        ("vision_config.image_size", json!(1_000_000)),
        ("vision_config.num_attention_heads", json!(5)),
        ("vision_config.num_channels", json!(4)),
        ("vision_config.hidden_act", json!("sine")),
        ("vision_feature_layer", json!(4)),
        ("vision_feature_layer", json!(-5)),
        ("vision_feature_layer", json!([])),
        ("vision_feature_select_strategy", json!("best")),
        ("image_token_index", json!(352)),
        ("projector_hidden_act", json!(3)),
    ] {
        let copy = Copy::new();
        copy.edit("config.json", |config| set(config, key, value.clone()));
        match copy.error() {
            MllmError::Config {
                path, key: named, ..
            } => {
                assert!(path.ends_with("config.json"));
                let expected = if key.ends_with("num_attention_heads") && value != json!(0) {
                    "hidden_size"
                } else {
                    key
                };
                assert!(named.ends_with(expected), "{key} = {value}: {named}");
            }
            other => panic!("{key} = {value}: {other}"),
        }
    }
}

/// Whether an error is about a tensor, or about a size beyond all models.
fn is_of_size(error: &MllmError) -> bool {
    matches!(
        error,
        MllmError::TensorShape { .. } | MllmError::MissingTensor { .. } | MllmError::Config { .. }
    )
}

#[test]
fn sizes_that_the_weights_do_not_have_are_errors_before_anything_is_built() {
    for (key, value) in [
        ("text_config.hidden_size", json!(33)),
        ("text_config.vocab_size", json!(4_000_000)),
        ("text_config.intermediate_size", json!(4_000_000)),
        ("text_config.num_hidden_layers", json!(4_000_000)),
        ("vision_config.num_hidden_layers", json!(4_000_000)),
        ("vision_config.patch_size", json!(1)),
    ] {
        let copy = Copy::new();
        copy.edit("config.json", |config| set(config, key, value));
        let error = copy.error();
        assert!(is_of_size(&error), "{key}: {error}");
    }
    for (key, value) in [
        ("vocab_size", json!(4_000_000)),
        ("num_hidden_layers", json!(4_000_000)),
        ("intermediate_size", json!(4_000_000)),
        ("vision_config.num_hidden_layers", json!(4_000_000)),
        ("vision_config.hidden_size", json!(3_000_000)),
    ] {
        let copy = Copy::from_fixture("tiny_cogvlm");
        copy.edit("config.json", |config| set(config, key, value));
        let error = copy.error();
        assert!(is_of_size(&error), "{key}: {error}");
    }
}

#[test]
fn broken_json_says_where() {
    for file in [
        "config.json",
        "tokenizer.json",
        "tokenizer_config.json",
        "preprocessor_config.json",
        "generation_config.json",
    ] {
        let copy = Copy::new();
        std::fs::write(copy.path(file), "{\n  \"a\": ").unwrap();
        match copy.error() {
            MllmError::Json { path, source } => assert!(path.ends_with(file) && source.line() == 2),
            other => panic!("{file}: {other}"),
        }
        std::fs::write(copy.path(file), "[]").unwrap();
        let error = copy.error();
        assert!(
            matches!(
                error,
                MllmError::Config { .. } | MllmError::Tokenizer { .. }
            ),
            "{file}: {error}"
        );
    }
}

#[test]
fn a_tokenizer_that_does_not_fit_the_model_is_an_error() {
    let copy = Copy::new();
    copy.edit("tokenizer.json", |tokenizer| {
        tokenizer["model"]["vocab"]["far"] = json!(9999);
    });
    match copy.error() {
        MllmError::Vocabulary {
            token,
            id,
            vocabulary,
        } => {
            assert_eq!((token.as_str(), id, vocabulary), ("far", 9999, 352));
        }
        other => panic!("{other}"),
    }

    let copy = Copy::new();
    copy.edit("config.json", |config| {
        config["image_token_index"] = json!(351);
    });
    assert!(
        matches!(copy.error(), MllmError::Tokenizer { problem, .. } if problem.contains("351"))
    );

    let copy = Copy::new();
    copy.edit("config.json", |config| {
        config["image_token_index"] = json!(2);
    });
    assert!(
        matches!(copy.error(), MllmError::ChatTemplate { .. }),
        "the template writes another placeholder"
    );

    let copy = Copy::new();
    copy.edit("tokenizer.json", |tokenizer| {
        tokenizer["decoder"] = json!(null);
    });
    copy.edit("tokenizer.json", |tokenizer| {
        tokenizer["pre_tokenizer"] = json!(null);
    });
    assert!(matches!(copy.error(), MllmError::Tokenizer { .. }));
}

#[test]
fn end_tokens_outside_of_the_vocabulary_are_named() {
    for value in [json!(352), json!([2, 400]), json!("</s>")] {
        let copy = Copy::new();
        copy.edit("generation_config.json", |config| {
            config["eos_token_id"] = value;
        });
        assert!(matches!(copy.error(), MllmError::Config { key, .. } if key == "eos_token_id"));
    }
}

#[test]
fn a_preprocessor_for_another_size_is_an_error() {
    let copy = Copy::new();
    copy.edit("preprocessor_config.json", |config| {
        config["crop_size"] = json!(48);
    });
    assert!(matches!(copy.error(), MllmError::Config { key, .. } if key == "crop_size"));
}

#[test]
fn a_template_that_fails_at_run_time_is_an_error() {
    let copy = Copy::new();
    let template = std::fs::read_to_string(copy.path("chat_template.jinja")).unwrap();
    let guard = "{% if messages[0]['role'] == 'system' %}{{ raise_exception('no system prompt, please') }}{% endif %}";
    std::fs::write(
        copy.path("chat_template.jinja"),
        format!("{guard}{template}"),
    )
    .unwrap();
    let model = copy.open().unwrap();
    match model.converse(&prefix(), 0).map(|_| ()) {
        Err(MllmError::ChatTemplate { problem, .. }) => {
            assert!(problem.contains("no system prompt"), "{problem}");
        }
        other => panic!("{other:?}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_configuration_makes_it_panic(
        key in prop_oneof![
            Just("text_config.hidden_size"), Just("text_config.num_attention_heads"), Just("text_config.head_dim"),
            Just("text_config.num_key_value_heads"), Just("text_config.vocab_size"), Just("text_config.rope_parameters"),
            Just("text_config.max_position_embeddings"), Just("vision_config.image_size"), Just("vision_config.patch_size"),
            Just("vision_config.num_attention_heads"), Just("vision_feature_layer"), Just("image_token_index"),
            Just("vision_config"), Just("text_config"), Just("tie_word_embeddings"),
        ],
        value in prop_oneof![
            any::<i64>().prop_map(Value::from), (0i64..70).prop_map(Value::from), any::<f64>().prop_map(Value::from),
            any::<bool>().prop_map(Value::from), "[a-z]{0,4}".prop_map(Value::from), Just(json!([1, -1])),
            Just(json!({})), Just(Value::Null),
        ],
    ) {
        let copy = Copy::new();
        copy.edit("config.json", |config| set(config, key, value));
        if let Ok(model) = copy.open() {
            let _ = model.converse(&prefix(), 0).and_then(|mut conversation| conversation.ask(FIRST, &free(2)));
        }
    }

    #[test]
    fn no_configuration_of_another_family_makes_it_panic(
        (folder, key) in prop_oneof![
            Just(("tiny_llava_next", "image_grid_pinpoints")), Just(("tiny_llava_next", "vision_config.image_size")),
            Just(("tiny_llava_next", "vision_config.patch_size")),
            Just(("tiny_llava_next_mistral", "text_config.sliding_window")),
            Just(("tiny_cogvlm", "hidden_size")), Just(("tiny_cogvlm", "num_attention_heads")),
            Just(("tiny_cogvlm", "max_position_embeddings")), Just(("tiny_cogvlm", "vocab_size")),
            Just(("tiny_cogvlm", "vision_config.image_size")), Just(("tiny_cogvlm", "vision_config.patch_size")),
            Just(("tiny_cogvlm", "vision_config")), Just(("tiny_cogvlm", "bos_token_id")),
        ],
        value in prop_oneof![
            any::<i64>().prop_map(Value::from), (0i64..120).prop_map(Value::from), any::<f64>().prop_map(Value::from),
            Just(json!([[32, 32]])), Just(json!([[1, 1], [32]])), Just(json!({})), Just(json!([])), Just(Value::Null),
        ],
    ) {
        let copy = Copy::from_fixture(folder);
        copy.edit("config.json", |config| set(config, key, value));
        if let Ok(model) = copy.open() {
            let _ = model.converse(&prefix(), 0).and_then(|mut conversation| conversation.ask(FIRST, &free(2)));
        }
    }

    #[test]
    fn no_flipped_byte_makes_it_panic(place in 0usize..12_000, bits in 1u8..=255) {
        let copy = Copy::new();
        let mut bytes = std::fs::read(copy.path("model.safetensors")).unwrap();
        bytes[place] ^= bits;
        std::fs::write(copy.path("model.safetensors"), bytes).unwrap();
        let _ = copy.open();
    }
}
