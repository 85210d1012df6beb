//! Keys that a GGUF file leaves out: what llama.cpp requires is an error with the key, what it has
//! a default for is noted, and the rest says nothing.

use super::round_trip_tests::{edit, export};
use crate::gguf::{FILE, open_header, tower_beside};
use crate::local::test_reference::fixture;
use crate::source::ModelPlace;
use crate::{Loading, LocalModel};
use planagent_kernels::matrix::WeightFormat;
use std::path::{Path, PathBuf};

/// Fixtures with a pair that llama.cpp's writer made.
const PAIRS: [&str; 7] = [
    "tiny_internvl3",
    "tiny_qwen2_vl",
    "tiny_qwen2_5_vl",
    "tiny_qwen3_vl",
    "tiny_gemma3",
    "tiny_gemma4",
    "tiny_smolvlm",
];
/// Keys behind their prefix that say nothing about the result, or what the tensors say too.
const NEUTRAL: [&str; 11] = [
    "has_vision_encoder",
    "has_text_encoder",
    "has_llava_projector",
    "vision.projection_dim",
    "vision.mm_patch_merge_type",
    "vocab_size",
    "rope.dimension_count",
    "attention.value_length",
    "attention.value_length_swa",
    "rope.dimension_count_swa",
    "n_deepstack_layers",
];
/// Keys whose default is the meaning of a file without them in llama.cpp: all dimensions, the only
/// kind of scaling with a factor, as many heads; the projector of LLaVA.
const MEANT: [&str; 4] = [
    "attention.key_length",
    "attention.head_count_kv",
    "rope.scaling.type",
    "projector_type",
];

/// The pairs of all families, as decoders in folders of their own.
fn pairs(folder: &Path) -> Vec<(String, PathBuf)> {
    let copied = PAIRS.map(|name| {
        let own = folder.join(name);
        std::fs::create_dir(&own).unwrap();
        for file in ["model.gguf", "mmproj-model.gguf"] {
            std::fs::copy(fixture(name).join("gguf").join(file), own.join(file)).unwrap();
        }
        (name.to_owned(), own.join("model.gguf"))
    });
    let exported = ["tiny_llava", "tiny_llava_next"].map(|name| {
        let own = folder.join(name);
        std::fs::create_dir(&own).unwrap();
        let model = export(&fixture(name), &own, WeightFormat::F32);
        for path in [model.clone(), tower_beside(&model).unwrap().unwrap()] {
            edit(&path, |header, _| {
                header.metadata.retain(|key, _| !key.starts_with(FILE));
            });
        }
        (name.to_owned(), model)
    });
    copied.into_iter().chain(exported).collect()
}

/// Problems and notes of a model.
fn said(model: &Path) -> (Vec<String>, Vec<String>) {
    let place = ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    };
    let check = LocalModel::check(&place, &Loading::default());
    (check.problems, check.load.notes)
}

#[test]
fn a_key_that_is_left_out_is_an_error_or_a_note_in_all_families() {
    let folder = tempfile::tempdir().unwrap();
    for (name, model) in pairs(folder.path()) {
        assert_eq!(said(&model).0, [] as [&str; 0], "{name}");
        for file in [model.clone(), tower_beside(&model).unwrap().unwrap()] {
            let bytes = std::fs::read(&file).unwrap();
            let (header, _) = open_header(&file).unwrap();
            let prefix = format!("{}.", header.architecture().unwrap());
            for key in header
                .metadata
                .keys()
                .filter(|key| key.starts_with(&prefix))
            {
                edit(&file, |header, _| {
                    header.metadata.remove(key);
                });
                let (problems, notes) = said(&model);
                let own = key.strip_prefix(&prefix).unwrap();
                let is_named = problems
                    .iter()
                    .chain(&notes)
                    .any(|said| said.contains(key.as_str()));
                let is_neutral = NEUTRAL.contains(&own) && problems.is_empty();
                let is_meant =
                    MEANT.contains(&own) && (problems.is_empty() || own != "projector_type");
                assert!(
                    is_named || is_neutral || is_meant,
                    "{name} without {key}: {problems:?} {notes:?}"
                );
                std::fs::write(&file, &bytes).unwrap();
            }
        }
    }
}

/// What a pair without a key says.
fn without(name: &str, is_tower: bool, key: &str) -> (Vec<String>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let pairs = pairs(folder.path());
    let (_, model) = pairs.iter().find(|(known, _)| known == name).unwrap();
    let file = if is_tower {
        tower_beside(model).unwrap().unwrap()
    } else {
        model.clone()
    };
    edit(&file, |header, _| {
        assert!(header.metadata.remove(key).is_some(), "{key}");
    });
    said(model)
}

#[test]
fn what_llama_cpp_requires_is_required_and_its_defaults_are_taken() {
    for (name, is_tower, key) in [
        (
            "tiny_internvl3",
            false,
            "qwen2.attention.layer_norm_rms_epsilon",
        ),
        ("tiny_internvl3", false, "qwen2.attention.head_count_kv"),
        ("tiny_qwen2_vl", false, "qwen2vl.rope.dimension_sections"),
        ("tiny_gemma3", false, "gemma3.attention.sliding_window"),
        ("tiny_gemma4", false, "gemma4.attention.sliding_window"),
        ("tiny_gemma4", false, "gemma4.rope.freq_base_swa"),
        ("tiny_internvl3", true, "clip.vision.image_mean"),
        ("tiny_llava", true, "clip.vision.image_std"),
        (
            "tiny_llava",
            true,
            "clip.vision.attention.layer_norm_epsilon",
        ),
        (
            "tiny_qwen2_5_vl",
            true,
            "clip.vision.attention.layer_norm_epsilon",
        ),
        ("tiny_qwen3_vl", true, "clip.vision.is_deepstack_layers"),
        ("tiny_internvl3", true, "clip.projector_type"),
    ] {
        let (problems, _) = without(name, is_tower, key);
        let told = format!("{key}: is missing from the metadata");
        assert!(
            problems.iter().any(|problem| problem.contains(&told)),
            "{name} {key}: {problems:?}"
        );
    }
    for (name, is_tower, key, taken) in [
        ("tiny_internvl3", false, "qwen2.rope.freq_base", "10000"),
        ("tiny_gemma3", false, "gemma3.rope.freq_base", "10000"),
        ("tiny_gemma3", false, "gemma3.rope.freq_base_swa", "10000"),
        ("tiny_gemma4", false, "gemma4.final_logit_softcapping", "30"),
        ("tiny_gemma3", false, "gemma3.rope.scaling.factor", "1"),
        ("tiny_qwen3_vl", true, "clip.vision.spatial_merge_size", "2"),
        (
            "tiny_gemma3",
            true,
            "clip.vision.projector.scale_factor",
            "4",
        ),
    ] {
        let (_, notes) = without(name, is_tower, key);
        let told = format!("the key {key} is missing; {taken} is taken, as llama.cpp does");
        assert!(
            notes.iter().any(|note| note.contains(&told)),
            "{name} {key}: {notes:?}"
        );
    }
}

#[test]
fn a_processor_beside_the_file_stands_for_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (_, model) = pairs(folder.path()).swap_remove(0);
    edit(&tower_beside(&model).unwrap().unwrap(), |header, _| {
        header.metadata.remove("clip.vision.image_mean");
        header.metadata.remove("clip.vision.image_std");
    });
    assert!(!said(&model).0.is_empty());
    let processor = fixture("tiny_internvl3").join("preprocessor_config.json");
    std::fs::copy(processor, model.with_file_name("preprocessor_config.json")).unwrap();
    assert_eq!(said(&model).0, [] as [&str; 0]);
}

#[test]
fn numbers_that_a_family_has_no_place_for_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (name, model) in pairs(folder.path()) {
        let tower = tower_beside(&model).unwrap().unwrap();
        let key = "clip.vision.attention.layer_norm_epsilon";
        let is_fixed = ["tiny_qwen2_vl", "tiny_qwen2_5_vl"].contains(&name.as_str());
        edit(&tower, |header, _| {
            header
                .metadata
                .insert(key.to_owned(), serde_json::json!(1e-5_f32));
        });
        let (problems, _) = said(&model);
        let is_named = problems.iter().any(|problem| problem.contains(key));
        assert_eq!(is_named, is_fixed, "{name}: {problems:?}");
        edit(&tower, |header, _| {
            header
                .metadata
                .insert(key.to_owned(), serde_json::json!(1e-6_f32));
            header
                .metadata
                .insert("clip.vision.block_count".to_owned(), serde_json::json!(9));
        });
        let (problems, _) = said(&model);
        let told = "clip.vision.block_count: is 9, and the last layer of the file is";
        assert!(
            problems.iter().any(|problem| problem.contains(told)),
            "{name}: {problems:?}"
        );
    }
}
