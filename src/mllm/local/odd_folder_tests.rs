//! Folders as they lie on disks: edited, incomplete or hostile.

use super::test_reference::fixture;
use super::{Loading, LocalModel};
use crate::checkpoint::read_json;
use crate::source::ModelPlace;
use serde_json::{Value, json};
use std::path::Path;

/// A copy of a fixture's files.
fn copy(name: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture(name)).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    folder
}

fn change(folder: &Path, file: &str, pointer: &str, value: Value) {
    let mut json = read_json(&folder.join(file)).unwrap();
    let (object, key) = pointer.rsplit_once('/').unwrap();
    json.pointer_mut(object).unwrap()[key] = value;
    std::fs::write(folder.join(file), json.to_string()).unwrap();
}

/// What opening says, and the problems of a check.
fn told(folder: &Path) -> (String, Vec<String>) {
    let place = ModelPlace::Folder(folder.to_path_buf());
    let opened = LocalModel::load("m", &place, &Loading::default());
    let said = opened.map_or_else(
        |error| error.to_string(),
        |model| model.load.notes.join("\n"),
    );
    (
        said,
        LocalModel::check(&place, &Loading::default()).problems,
    )
}

const CONFIG: &str = "config.json";
const PROCESSOR: &str = "preprocessor_config.json";

/// Sizes that would take gigabytes, or more memory than there is. None fits the weights, and none
/// gets as far.
#[test]
#[allow(clippy::too_many_lines, reason = "a table of sizes")]
fn sizes_are_bounded_before_memory_is_taken() {
    let most = json!(1_u64 << 22);
    for (model, file, pointer, value) in [
        (
            "tiny_llava",
            CONFIG,
            "/text_config/num_attention_heads",
            most.clone(),
        ),
        ("tiny_llava", CONFIG, "/text_config/head_dim", most.clone()),
        (
            "tiny_llava",
            CONFIG,
            "/text_config/num_hidden_layers",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/text_config/intermediate_size",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/text_config/hidden_size",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/text_config/max_position_embeddings",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/vision_config/hidden_size",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/vision_config/num_hidden_layers",
            most.clone(),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/vision_config/image_size",
            json!(65_536),
        ),
        (
            "tiny_llava",
            CONFIG,
            "/vision_feature_layer",
            json!(vec![-1; 40_000]),
        ),
        (
            "tiny_llava",
            PROCESSOR,
            "/size",
            json!({"height": 65_536, "width": 65_536}),
        ),
        (
            "tiny_llava",
            PROCESSOR,
            "/size",
            json!({"shortest_edge": 65_536}),
        ),
        ("tiny_llava", PROCESSOR, "/crop_size", json!(65_536)),
        (
            "tiny_llava_next",
            CONFIG,
            "/image_grid_pinpoints",
            json!([[16_384, 16_384]]),
        ),
        (
            "tiny_cogvlm",
            CONFIG,
            "/vision_config/image_size",
            json!(65_536),
        ),
        ("tiny_cogvlm", CONFIG, "/num_attention_heads", most.clone()),
        ("tiny_smolvlm", CONFIG, "/scale_factor", json!(1 << 20)),
        (
            "tiny_smolvlm",
            PROCESSOR,
            "/size",
            json!({"longest_edge": 65_536}),
        ),
        ("tiny_internvl3", PROCESSOR, "/max_patches", json!(1 << 20)),
        ("tiny_internvl3", PROCESSOR, "/size", json!(65_536)),
        (
            "tiny_qwen2_5_vl",
            CONFIG,
            "/vision_config/patch_size",
            most.clone(),
        ),
        (
            "tiny_qwen2_5_vl",
            CONFIG,
            "/vision_config/temporal_patch_size",
            most.clone(),
        ),
        (
            "tiny_qwen2_5_vl",
            CONFIG,
            "/vision_config/spatial_merge_size",
            most.clone(),
        ),
        (
            "tiny_llava_onevision",
            CONFIG,
            "/vision_aspect_ratio",
            json!("anyres_max_99999999"),
        ),
        (
            "tiny_llava_onevision",
            CONFIG,
            "/image_grid_pinpoints",
            json!([[16_384, 16_384]]),
        ),
        ("tiny_gemma3", CONFIG, "/mm_tokens_per_image", most.clone()),
        (
            "tiny_gemma3n_vision",
            CONFIG,
            "/vision_config/vocab_size",
            most.clone(),
        ),
        (
            "tiny_gemma3n_vision",
            CONFIG,
            "/vision_config/model_args/stem_size",
            most.clone(),
        ),
        (
            "tiny_gemma3n_vision",
            CONFIG,
            "/vision_config/model_args/block_args/2/0/out_chs",
            json!(1 << 20),
        ),
        (
            "tiny_gemma3n_vision",
            CONFIG,
            "/vision_config/model_args/block_args/2/0/exp_ratio",
            json!(1e6),
        ),
        (
            "tiny_gemma3n_vision",
            PROCESSOR,
            "/size",
            json!({"height": 65_520, "width": 65_520}),
        ),
        (
            "tiny_gemma4",
            CONFIG,
            "/vision_config/position_embedding_size",
            most.clone(),
        ),
        (
            "tiny_gemma4",
            CONFIG,
            "/text_config/hidden_size_per_layer_input",
            most.clone(),
        ),
        ("tiny_gemma4", PROCESSOR, "/max_soft_tokens", most.clone()),
        (
            "tiny_gemma3",
            PROCESSOR,
            "/size",
            json!({"height": 65_536, "width": 65_536}),
        ),
        (
            "tiny_qwen2_vl",
            CONFIG,
            "/vision_config/embed_dim",
            most.clone(),
        ),
        (
            "tiny_qwen2_vl",
            CONFIG,
            "/vision_config/mlp_ratio",
            json!(1e30),
        ),
        (
            "tiny_qwen3_vl",
            CONFIG,
            "/vision_config/num_position_embeddings",
            most.clone(),
        ),
        (
            "tiny_qwen3_vl",
            CONFIG,
            "/vision_config/depth",
            most.clone(),
        ),
        (
            "tiny_qwen3_vl",
            PROCESSOR,
            "/size",
            json!({"shortest_edge": 1, "longest_edge": 1_u64 << 40}),
        ),
    ] {
        let folder = copy(model);
        change(folder.path(), file, pointer, value);
        let (said, problems) = told(folder.path());
        let key = pointer.trim_start_matches('/').rsplit('/').next().unwrap();
        assert!(said.contains(file), "{model} {pointer}: {said}");
        assert!(
            said.contains(key) || key == "size" && said.contains("max_pixels"),
            "{model} {pointer}: {said}"
        );
        assert!(
            problems.iter().any(|problem| problem.contains(file)),
            "{model} {pointer}: {problems:?}"
        );
    }
}

#[test]
fn heads_and_widths_that_are_both_allowed_are_bounded_by_their_product() {
    let folder = copy("tiny_llava");
    change(
        folder.path(),
        CONFIG,
        "/text_config/num_attention_heads",
        json!(4096),
    );
    change(
        folder.path(),
        CONFIG,
        "/text_config/num_key_value_heads",
        json!(1),
    );
    change(folder.path(), CONFIG, "/text_config/head_dim", json!(4096));
    let (said, problems) = told(folder.path());
    assert!(
        said.contains("text_config.num_attention_heads: 4096 times 4096"),
        "{said}"
    );
    assert!(problems.contains(&said), "{problems:?}");
}

#[test]
fn a_picture_that_no_question_could_have_is_a_problem() {
    let folder = copy("tiny_llava");
    change(folder.path(), PROCESSOR, "/do_center_crop", json!(false));
    change(
        folder.path(),
        PROCESSOR,
        "/size",
        json!({"shortest_edge": 40}),
    );
    let (_, problems) = told(folder.path());
    assert!(
        problems
            .iter()
            .any(|problem| problem.contains("the vision tower takes 32 x 32")),
        "{problems:?}"
    );
    let folder = copy("tiny_llava");
    change(
        folder.path(),
        CONFIG,
        "/text_config/max_position_embeddings",
        json!(16),
    );
    let (_, problems) = told(folder.path());
    assert!(
        problems
            .iter()
            .any(|problem| problem.contains("becomes 16 tokens")),
        "{problems:?}"
    );
}

/// Templates that write the first question, and no second one, or no system prompt.
#[test]
fn a_template_is_checked_for_all_rounds() {
    let own = "{% for m in messages %}{{ m.role }}: {% for part in m.content %}{% if part.type == 'image' %}<image>\n\
               {% else %}{{ part.text }}{% endif %}{% endfor %}{% endfor %}{% if add_generation_prompt %}assistant:{% endif %}";
    for (before, said) in [
        ("", None),
        (
            "{% if messages | length > 3 %}{{ raise_exception('one question only') }}{% endif %}",
            Some("one question only"),
        ),
        (
            "{% if messages | length > 5 %}{{ raise_exception('two questions only') }}{% endif %}",
            Some("two questions only"),
        ),
    ] {
        let folder = copy("tiny_llava");
        std::fs::write(
            folder.path().join("chat_template.jinja"),
            format!("{before}{own}"),
        )
        .unwrap();
        let (_, problems) = told(folder.path());
        match said {
            None => assert_eq!(problems, [] as [&str; 0]),
            Some(said) => assert!(
                problems.len() == 1 && problems[0].contains(said),
                "{said}: {problems:?}"
            ),
        }
    }
}

#[test]
fn a_refused_folder_says_what_it_is_and_many_faults_are_one_line() {
    let folder = copy("tiny_llava");
    change(folder.path(), CONFIG, "/model_type", json!("next_year"));
    let check = |folder: &Path| {
        LocalModel::check(
            &ModelPlace::Folder(folder.to_path_buf()),
            &Loading::default(),
        )
    };
    let refused = check(folder.path());
    assert_eq!(refused.kind.as_deref(), Some("next_year"));
    assert!(refused.parameters > 70_000, "{}", refused.parameters);
    let folder = copy("tiny_llava");
    change(
        folder.path(),
        CONFIG,
        "/text_config/num_hidden_layers",
        json!(100),
    );
    let problems = check(folder.path()).problems;
    assert!(
        problems.len() == 1 && problems[0].contains("tensors are missing"),
        "{problems:?}"
    );
}

#[test]
fn a_byte_order_mark_changes_nothing() {
    let folder = copy("tiny_smolvlm");
    let before = told(folder.path());
    assert_eq!(before.1, [] as [String; 0]);
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        if path
            .extension()
            .is_some_and(|ending| ending == "json" || ending == "jinja")
        {
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(&path, format!("\u{feff}{text}")).unwrap();
        }
    }
    assert_eq!(told(folder.path()), before);
    let text = std::fs::read_to_string(fixture("tiny_smolvlm").join(CONFIG)).unwrap();
    let utf16: Vec<u8> = format!("\u{feff}{text}")
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(folder.path().join(CONFIG), utf16).unwrap();
    let (said, _) = told(folder.path());
    assert!(
        said.contains("config.json") && said.contains("save it as UTF-8"),
        "{said}"
    );
}

#[test]
fn a_web_page_in_place_of_a_file_is_called_one() {
    for file in [CONFIG, "tokenizer.json", "model.safetensors"] {
        for (text, what) in [
            ("<!doctype html>\n<html>", "a web page"),
            ("Entry not found", "a server's answer"),
        ] {
            let folder = copy("tiny_llava");
            std::fs::write(folder.path().join(file), text).unwrap();
            let (said, problems) = told(folder.path());
            for said in [&said, &problems.join("\n")] {
                assert!(
                    said.contains(file) && said.contains(what) && said.contains("again"),
                    "{file}: {said}"
                );
            }
        }
    }
}

/// A check has tensors without numbers, some of them without a side.
#[test]
fn folders_of_all_families_have_no_problem() {
    for model in [
        "tiny_llava",
        "tiny_llava_next",
        "tiny_cogvlm",
        "tiny_smolvlm",
        "tiny_internvl3",
        "tiny_qwen2_vl",
        "tiny_qwen2_5_vl",
        "tiny_qwen3_vl",
        "tiny_qwen3_5",
        "tiny_llava_onevision",
        "tiny_lfm2_vl",
        "tiny_gemma3",
        "tiny_gemma3n_vision",
        "tiny_gemma4",
    ] {
        let place = ModelPlace::Folder(fixture(model));
        let problems = LocalModel::check(&place, &Loading::default()).problems;
        assert!(problems.is_empty(), "{model}: {problems:?}");
    }
}

/// One rule for all families: the embedding stands in for an output layer that the files lack.
#[test]
fn a_missing_output_layer_is_the_embedding_and_is_noted() {
    for (model, tied) in [
        ("tiny_llava", false),
        ("tiny_llava_next", false),
        ("tiny_cogvlm", false),
        ("tiny_llava", true),
    ] {
        let folder = copy(model);
        let path = folder.path().join("model.safetensors");
        let mut tensors = candle_core::safetensors::load(&path, &candle_core::Device::Cpu).unwrap();
        tensors.retain(|name, _| !name.contains("lm_head"));
        candle_core::safetensors::save(&tensors, &path).unwrap();
        change(folder.path(), CONFIG, "/tie_word_embeddings", json!(tied));
        let place = ModelPlace::Folder(folder.path().to_path_buf());
        let check = LocalModel::check(&place, &Loading::default());
        let missing: Vec<&String> = check
            .problems
            .iter()
            .filter(|problem| problem.contains("lm_head"))
            .collect();
        assert!(missing.is_empty(), "{model}: {missing:?}");
        assert_eq!(
            check
                .load
                .notes
                .iter()
                .any(|note| note.contains("lm_head.weight")),
            !tied,
            "{:?}",
            check.load.notes
        );
    }
}
