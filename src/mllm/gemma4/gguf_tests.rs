//! llama.cpp's files of a decoder alone, and metadata that contradicts itself.

use crate::export::round_trip_tests::edit_metadata;
use crate::local::test_prompts::Prompts;
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;
use serde_json::{Value, json};
use std::path::Path;

const FIXTURE: &str = "tiny_gemma4";

/// Why a folder does not open.
fn problem(folder: &Path) -> String {
    let place = ModelPlace::Folder(folder.to_path_buf());
    let opened = LocalModel::load("tiny", &place, &Loading::default());
    opened.map(|_| ()).unwrap_err().to_string()
}

#[test]
fn a_decoder_without_its_tower_reads_text() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.gguf");
    std::fs::copy(prompts.folder.join("gguf/model.gguf"), &model).unwrap();
    let local = Prompts::open_at(folder.path());
    assert_eq!(local.model().info().architecture, "gemma4_text");
    prompts.check(&local, |run| run == "text_");
}

#[test]
fn what_contradicts_is_named() {
    let prompts = Prompts::from_fixture(FIXTURE);
    // Seven layers of which the last three share keys, and are twice as wide.
    for (key, value) in [
        ("feed_forward_length", json!([24, 24, 24, 24, 48, 48, 24])),
        ("feed_forward_length", json!([24, 24, 24, 48, 48, 48, 48])),
        ("feed_forward_length", json!([24, 48])),
        ("feed_forward_length", json!([])),
        ("feed_forward_length", json!("wide")),
        ("attention.sliding_window_pattern", json!([true])),
        ("attention.sliding_window_pattern", json!(vec![true; 7])),
        ("attention.head_count_kv", json!([2, 1, 1, 1, 2, 2, 1])),
        ("attention.head_count_kv", json!([2, 1])),
        ("attention.head_count_kv", json!(0)),
        ("attention.head_count_kv", json!([2, 3, 2, 3, 2, 2, 3])),
        ("attention.value_length_swa", json!(8)),
        ("rope.dimension_count_swa", json!(8)),
        ("attention.shared_kv_layers", json!(7)),
        ("attention.sliding_window", json!(0)),
        ("embedding_length_per_layer_input", json!(1 << 20)),
        ("rope.freq_base_swa", json!(0)),
        ("final_logit_softcapping", json!(-1)),
    ] {
        let key = format!("gemma4.{key}");
        let folder = prompts.gguf_with("preprocessor_config.json");
        edit_metadata(&folder.path().join("model.gguf"), |metadata| {
            drop(metadata.insert(key.clone(), value.clone()));
        });
        let said = problem(folder.path());
        assert!(said.contains(&key), "{key} = {value}: {said}");
    }
    let scaled: [(&str, Value); 2] = [("type", json!("linear")), ("factor", json!(8.0))];
    let folder = prompts.gguf_with("preprocessor_config.json");
    edit_metadata(&folder.path().join("model.gguf"), |metadata| {
        for (key, value) in scaled {
            metadata.insert(format!("gemma4.rope.scaling.{key}"), value);
        }
    });
    let said = problem(folder.path());
    assert!(said.contains("gemma4.rope.scaling.type"), "{said}");
}
