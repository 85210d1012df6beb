//! Parity with Hugging Face transformers: the decoders of the tiny vision models, read alone, give
//! the numbers of their chats without an image (`tests/fixtures/make_modern.py`).
//! `tests/mllm/text_only.rs` has those of language models and llama.cpp's files of them.

use crate::checkpoint::read_json;
use crate::family::{Chat, ImageSettings};
use crate::local::test_prompts::Prompts;
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;
use crate::{Constraint, Deadline, Mllm, MllmError, PromptPrefix, Request, Sampling};
use candle_core::{Device, Tensor};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Tiny vision models, the prefix of their decoders' tensors, the family of the decoder, and what
/// shows it as part of a vision model.
const MODELS: [(&str, &str, &str, &str); 6] = [
    ("tiny_smolvlm", "model.text_model.", "llama", "<image>"),
    (
        "tiny_internvl3",
        "language_model.model.",
        "qwen2",
        "<IMG_CONTEXT>",
    ),
    ("tiny_qwen2_5_vl", "model.", "qwen2", "architecture qwen2vl"),
    ("tiny_qwen2_vl", "model.", "qwen2", "architecture qwen2vl"),
    (
        "tiny_qwen3_vl",
        "model.language_model.",
        "qwen3",
        "architecture qwen3vl",
    ),
    (
        "tiny_qwen3_5",
        "model.language_model.",
        "qwen3_5_text",
        "architecture qwen35",
    ),
];

/// A folder of the decoder of a tiny vision model, as transformers saves a language model.
fn decoder_folder(prompts: &Prompts, prefix: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in [
        "tokenizer.json",
        "tokenizer_config.json",
        "generation_config.json",
        "chat_template.jinja",
    ] {
        std::fs::copy(prompts.folder.join(name), folder.path().join(name)).unwrap();
    }
    let config = read_json(&prompts.folder.join("config.json")).unwrap();
    let mut text = config["text_config"].clone();
    text["tie_word_embeddings"] = config["tie_word_embeddings"].clone();
    write(&folder.path().join("config.json"), &text);
    let all =
        candle_core::safetensors::load(prompts.folder.join("model.safetensors"), &Device::Cpu)
            .unwrap();
    let decoder: HashMap<String, Tensor> = all
        .into_iter()
        .filter_map(|(name, tensor)| {
            if name == "lm_head.weight" {
                return Some((name, tensor));
            }
            Some((format!("model.{}", name.strip_prefix(prefix)?), tensor))
        })
        .collect();
    candle_core::safetensors::save(&decoder, folder.path().join("model.safetensors")).unwrap();
    folder
}

fn write(path: &Path, value: &Value) {
    std::fs::write(path, value.to_string()).unwrap();
}

fn load(place: &ModelPlace) -> Result<LocalModel, MllmError> {
    LocalModel::load("tiny", place, &Loading::default())
}

#[test]
fn logits_and_greedy_tokens_of_folders_are_those_of_transformers() {
    for (fixture, prefix, family, _) in MODELS {
        let prompts = Prompts::from_fixture(fixture);
        let folder = decoder_folder(&prompts, prefix);
        let local = load(&ModelPlace::Folder(folder.path().to_path_buf())).unwrap();
        let described = local.describe();
        assert_eq!(described.architecture, family);
        assert_eq!((described.image_size, described.image_tokens), (None, 0));
        prompts.check(&local, |name| name == "text_");
    }
}

#[test]
fn a_decoder_of_a_vision_model_is_opened_alone_only_when_asked_for() {
    for (fixture, _, family, mark) in MODELS {
        let prompts = Prompts::from_fixture(fixture);
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.gguf");
        std::fs::copy(prompts.folder.join("gguf/model.gguf"), &model).unwrap();
        let place = ModelPlace::Gguf {
            model: model.clone(),
            mmproj: None,
        };
        let error = load(&place).unwrap_err().to_string();
        assert!(
            error.contains(mark) && error.contains("`vision = false`"),
            "{fixture}: {error}"
        );
        assert!(place.weight_bytes().is_err());
        let alone = ModelPlace::Decoder(model);
        let local = load(&alone).unwrap();
        assert_eq!(local.describe().architecture, family);
        let notes = &local.describe().load.notes;
        assert!(
            notes.iter().any(|note| note.contains("sees no picture")),
            "{notes:?}"
        );
        assert!(alone.weight_bytes().unwrap() > 0);
        prompts.check(&local, |name| name == "text_");
    }
}

#[test]
fn a_picture_is_refused_and_image_settings_are_too() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    let folder = decoder_folder(&prompts, "model.text_model.");
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let local = load(&place).unwrap();
    let shown = PromptPrefix {
        system: String::new(),
        image: Some(Arc::new(image::RgbImage::new(8, 8))),
    };
    let error = local.converse(&shown, 0).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("takes no picture"), "{error}");
    let loading = Loading {
        image: ImageSettings {
            size: Some(64),
            tiles: None,
        },
        ..Loading::default()
    };
    let error = LocalModel::load("tiny", &place, &loading).unwrap_err();
    assert!(error.to_string().contains("takes no picture"), "{error}");
    let check = LocalModel::check(&place, &Loading::default());
    assert_eq!(check.problems, Vec::<String>::new());
    assert_eq!(check.memory.unwrap().picture, 0);
}

#[test]
fn a_template_that_can_think_is_rendered_without_thoughts() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let folder = decoder_folder(&prompts, "model.language_model.");
    let template = "{%- for m in messages -%}{{- '<|im_start|>' + m.role + '\\n' + m.content + '<|im_end|>\\n' -}}{%- endfor -%}\
        {{- '<|im_start|>assistant\\n' -}}\
        {%- if enable_thinking is defined and enable_thinking is false -%}{{- 'no thinking' -}}{%- endif -%}";
    std::fs::write(folder.path().join("chat_template.jinja"), template).unwrap();
    let local = load(&ModelPlace::Folder(folder.path().to_path_buf())).unwrap();
    let chat = Chat {
        system: "",
        images: &[],
        turns: &[],
        prompt: "Which lane?",
    };
    let ids = local.prompt_ids(&chat).unwrap();
    let read = local.tokenizer.decode_verbatim(&ids);
    assert!(read.ends_with("no thinking"), "{read}");
}

/// A folder whose vocabulary has the token that ends thinking, and whose template knows it.
fn thinking_folder() -> tempfile::TempDir {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let folder = decoder_folder(&prompts, "model.language_model.");
    let path = folder.path().join("tokenizer.json");
    let mut tokenizer = read_json(&path).unwrap();
    let added = tokenizer["added_tokens"].as_array_mut().unwrap();
    let last = added.last_mut().unwrap();
    let (id, old) = (
        last["id"].clone(),
        last["content"].as_str().unwrap().to_owned(),
    );
    last["content"] = json!("</think>");
    last["special"] = json!(false);
    if let Some(vocabulary) = tokenizer["model"]["vocab"].as_object_mut()
        && vocabulary.remove(&old).is_some()
    {
        vocabulary.insert("</think>".to_owned(), id);
    }
    write(&path, &tokenizer);
    let template = "{%- for m in messages -%}{{- '<|im_start|>' + m.role + '\\n' + m.content + '<|im_end|>\\n' -}}{%- endfor -%}\
        {{- '<|im_start|>assistant\\n' -}}{%- if not enable_thinking -%}{{- 'x' -}}{%- endif -%}";
    std::fs::write(folder.path().join("chat_template.jinja"), template).unwrap();
    folder
}

#[test]
fn thoughts_have_a_limit_of_their_own_and_are_no_part_of_an_answer() {
    let folder = thinking_folder();
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let answer = |thinking, draft: Option<Vec<u32>>| {
        let loading = Loading {
            thinking,
            ..Loading::default()
        };
        let local = LocalModel::load("tiny", &place, &loading).unwrap();
        let prefix = PromptPrefix::default();
        let mut conversation = local.converse(&prefix, 1).unwrap();
        let request = Request {
            constraint: Constraint::Choice(vec!["yes".into(), "no".into()]),
            max_new_tokens: 8,
            sampling: Sampling::Greedy,
            deadline: Deadline::NONE,
            draft,
        };
        let mut asked = || conversation.ask("Go?", &request).unwrap();
        [asked(), asked()]
    };
    for round in answer(Some(5), None) {
        assert!(
            ["yes", "no"].contains(&round.text.as_str()),
            "{}",
            round.text
        );
        assert!(round.tokens.sampled >= 5, "{:?}", round.tokens);
    }
    let [plain, _] = answer(None, None);
    assert!(plain.tokens.sampled < 5, "{:?}", plain.tokens);
    let texts = |answers: [crate::Answer; 2]| answers.map(|answer| answer.ids);
    assert_eq!(
        texts(answer(Some(5), None)),
        texts(answer(Some(5), Some(vec![3, 4])))
    );
    // Neither a vocabulary without the mark nor a template without thinking is taken.
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let without = decoder_folder(&prompts, "model.language_model.");
    let loading = Loading {
        thinking: Some(5),
        ..Loading::default()
    };
    let place = ModelPlace::Folder(without.path().to_path_buf());
    let error = LocalModel::load("tiny", &place, &loading).unwrap_err();
    assert!(error.to_string().contains("</think>"), "{error}");
    std::fs::copy(
        without.path().join("chat_template.jinja"),
        folder.path().join("chat_template.jinja"),
    )
    .unwrap();
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    let error = LocalModel::load("tiny", &place, &loading).unwrap_err();
    assert!(error.to_string().contains("enable_thinking"), "{error}");
}

#[test]
fn what_is_wrong_with_a_folder_is_named() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    let folder = decoder_folder(&prompts, "model.text_model.");
    let path = folder.path().join("config.json");
    let right = read_json(&path).unwrap();
    let place = ModelPlace::Folder(folder.path().to_path_buf());
    for (key, value, said) in [
        ("model_type", json!("llama4"), "'llama4' is not supported"),
        ("hidden_act", json!("relu"), "hidden_act"),
        ("num_hidden_layers", json!(1 << 20), "num_hidden_layers"),
        ("num_attention_heads", json!(0), "num_attention_heads"),
        ("num_key_value_heads", json!(3), "num_key_value_heads"),
        ("head_dim", json!(15), "head_dim"),
        (
            "max_position_embeddings",
            json!(1_u64 << 30),
            "max_position_embeddings",
        ),
        ("rms_norm_eps", json!(-1), "rms_norm_eps"),
        ("vocab_size", json!(7), "has shape"),
        ("partial_rotary_factor", json!(0.5), "partial_rotary_factor"),
        (
            "rope_scaling",
            json!({"type": "odd", "factor": 2}),
            "rope_scaling.type",
        ),
    ] {
        let mut wrong = right.clone();
        wrong[key] = value;
        write(&path, &wrong);
        let error = load(&place).unwrap_err().to_string();
        assert!(error.contains(said), "{key}: {error}");
    }
    write(&path, &right);
    std::fs::remove_file(folder.path().join("chat_template.jinja")).unwrap();
    let error = load(&place).unwrap_err().to_string();
    assert!(error.contains("chat_template"), "{error}");
}
