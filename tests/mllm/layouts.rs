//! The same checkpoint gives the same answers in every layout of transformers.

use super::{Copy, FIRST, Tensors, free, open, prefix};
use half::{bf16, f16};
use planagent_mllm::{LocalModel, Mllm};
use safetensors::Dtype;
use serde_json::json;

fn answer(model: &LocalModel) -> String {
    model
        .converse(&prefix(), 0)
        .unwrap()
        .ask(FIRST, &free(12))
        .unwrap()
        .text
}

fn assert_same(copy: &Copy) {
    assert_eq!(answer(&copy.open().unwrap()), answer(&open()));
}

fn renamed(rename: impl Fn(&str) -> String) -> Copy {
    let copy = Copy::new();
    copy.edit_tensors(|tensors| {
        *tensors = std::mem::take(tensors)
            .into_iter()
            .map(|(name, tensor)| (rename(&name), tensor))
            .collect();
    });
    copy
}

#[test]
fn names_of_older_and_newer_files_are_read() {
    assert_same(&renamed(|name| {
        name.replace("vision_tower.", "vision_tower.vision_model.")
    }));
    assert_same(&renamed(|name| {
        let name = name
            .replace("language_model.model.", "language_model.")
            .replace("language_model.lm_head", "lm_head");
        if name.starts_with("lm_head") {
            name
        } else {
            format!("model.{name}")
        }
    }));
}

#[test]
fn names_of_llava_next_are_read_in_every_layout() {
    let renamed = |rename: &dyn Fn(&str) -> String| {
        let copy = Copy::from_fixture("tiny_llava_next");
        copy.edit_tensors(|tensors| {
            *tensors = std::mem::take(tensors)
                .into_iter()
                .map(|(name, tensor)| (rename(&name), tensor))
                .collect();
        });
        answer(&copy.open().unwrap())
    };
    let as_it_is = renamed(&str::to_string);
    assert_eq!(
        renamed(&|name| name.replace("vision_tower.", "vision_tower.vision_model.")),
        as_it_is
    );
    let newest = |name: &str| match name.strip_prefix("language_model.") {
        Some("lm_head.weight") => "lm_head.weight".to_string(),
        Some(rest) => format!("model.language_model.{}", rest.trim_start_matches("model.")),
        None => format!("model.{name}"),
    };
    assert_eq!(renamed(&newest), as_it_is);
}

#[test]
fn shards_are_joined_by_their_index() {
    for name in ["tiny_llava", "tiny_cogvlm"] {
        let copy = Copy::from_fixture(name);
        let whole = answer(&copy.open().unwrap());
        let tensors = copy.tensors();
        let names: Vec<&String> = tensors.keys().collect();
        let (front, back) = names.split_at(names.len() / 2);
        let mut map = serde_json::Map::new();
        for (file, part) in [
            ("model-00001-of-00002.safetensors", front),
            ("model-00002-of-00002.safetensors", back),
        ] {
            let shard: Tensors = part
                .iter()
                .map(|name| ((*name).clone(), tensors[*name].clone()))
                .collect();
            copy.write_tensors(file, &shard);
            map.extend(part.iter().map(|name| ((*name).clone(), json!(file))));
        }
        std::fs::remove_file(copy.path("model.safetensors")).unwrap();
        std::fs::write(
            copy.path("model.safetensors.index.json"),
            json!({ "weight_map": map }).to_string(),
        )
        .unwrap();
        assert_eq!(answer(&copy.open().unwrap()), whole);
        std::fs::remove_file(copy.path("model-00002-of-00002.safetensors")).unwrap();
        assert!(
            copy.error()
                .to_string()
                .contains("model-00002-of-00002.safetensors")
        );
    }
}

/// Rewrites every tensor in another number format.
fn converted(dtype: Dtype, convert: impl Fn(f32) -> Vec<u8>) -> Copy {
    let copy = Copy::new();
    copy.edit_tensors(|tensors| {
        for (format, _, bytes) in tensors.values_mut() {
            *format = dtype;
            *bytes = bytes
                .as_chunks::<4>()
                .0
                .iter()
                .flat_map(|bytes| convert(f32::from_le_bytes(*bytes)))
                .collect();
        }
    });
    copy
}

#[test]
fn half_precision_weights_are_widened() {
    // The values change with the format, so the reference is the same checkpoint with rounded f32
    // weights.
    let half = converted(Dtype::F16, |value| {
        f16::from_f32(value).to_le_bytes().to_vec()
    });
    let rounded = converted(Dtype::F32, |value| {
        f16::from_f32(value).to_f32().to_le_bytes().to_vec()
    });
    assert_eq!(
        answer(&half.open().unwrap()),
        answer(&rounded.open().unwrap())
    );
    let brain = converted(Dtype::BF16, |value| {
        bf16::from_f32(value).to_le_bytes().to_vec()
    });
    let rounded = converted(Dtype::F32, |value| {
        bf16::from_f32(value).to_f32().to_le_bytes().to_vec()
    });
    assert_eq!(
        answer(&brain.open().unwrap()),
        answer(&rounded.open().unwrap())
    );
}

#[test]
fn a_tied_head_is_the_embedding() {
    let copied = Copy::new();
    copied.edit_tensors(|tensors| {
        let embedding = tensors["language_model.model.embed_tokens.weight"].clone();
        tensors.insert("language_model.lm_head.weight".into(), embedding);
    });
    let tied = Copy::new();
    tied.edit_tensors(|tensors| {
        tensors.remove("language_model.lm_head.weight");
    });
    assert_eq!(
        answer(&tied.open().unwrap()),
        answer(&copied.open().unwrap()),
        "a missing head is the embedding"
    );
    tied.edit("config.json", |config| {
        config["text_config"]["tie_word_embeddings"] = json!(true);
    });
    assert_eq!(
        answer(&tied.open().unwrap()),
        answer(&copied.open().unwrap())
    );
}

#[test]
fn other_places_of_template_and_preprocessor_are_read() {
    let copy = Copy::new();
    let template = std::fs::read_to_string(copy.path("chat_template.jinja")).unwrap();
    std::fs::remove_file(copy.path("chat_template.jinja")).unwrap();
    copy.edit("tokenizer_config.json", |config| {
        config["chat_template"] = json!(template);
    });
    let preprocessor = std::fs::read_to_string(copy.path("preprocessor_config.json")).unwrap();
    std::fs::remove_file(copy.path("preprocessor_config.json")).unwrap();
    let nested = format!(r#"{{"image_processor": {preprocessor}, "patch_size": 8}}"#);
    std::fs::write(copy.path("processor_config.json"), nested).unwrap();
    assert_same(&copy);
    copy.edit("tokenizer_config.json", |config| {
        config["chat_template"] = json!([{"name": "default", "template": template}]);
        config["bos_token"] = json!({"content": "<s>", "lstrip": false});
    });
    assert_same(&copy);
    copy.edit("tokenizer_config.json", |config| {
        config["chat_template"] = json!({"tool_use": "none", "default": template});
    });
    assert_same(&copy);
}

/// Writes a number of the language model as Python's json does what is no number.
fn write_word(copy: &Copy, key: &str, word: &str) {
    copy.edit("config.json", |config| {
        config["text_config"][key] = json!("@");
    });
    let text = std::fs::read_to_string(copy.path("config.json")).unwrap();
    std::fs::write(copy.path("config.json"), text.replace("\"@\"", word)).unwrap();
}

#[test]
fn what_python_writes_for_no_number_counts_only_where_it_is_read() {
    for word in ["NaN", "Infinity", "-Infinity"] {
        let copy = Copy::new();
        write_word(&copy, "initializer_range", word);
        assert_same(&copy);
        let copy = Copy::new();
        write_word(&copy, "rms_norm_eps", word);
        let error = copy.error().to_string();
        assert!(
            error.contains("config.json: text_config.rms_norm_eps") && error.contains(word),
            "{error}"
        );
    }
}

#[test]
fn the_vision_layer_may_be_counted_from_either_end() {
    for (layer, same) in [
        (json!(-2), true),
        (json!(2), true),
        (json!([2]), true),
        (json!(-1), false),
        (json!(0), false),
    ] {
        let copy = Copy::new();
        copy.edit("config.json", |config| {
            config["vision_feature_layer"] = layer.clone();
        });
        assert_eq!(
            answer(&copy.open().unwrap()) == answer(&open()),
            same,
            "{layer}"
        );
    }
}

#[test]
fn rope_theta_stands_in_either_place() {
    let copy = Copy::new();
    copy.edit("config.json", |config| {
        config["text_config"]["rope_parameters"] = json!(null);
        config["text_config"]["rope_theta"] = json!(10_000);
    });
    assert_same(&copy);
    copy.edit("config.json", |config| {
        config["text_config"]["rope_theta"] = json!(10);
    });
    assert_ne!(answer(&copy.open().unwrap()), answer(&open()));
}
