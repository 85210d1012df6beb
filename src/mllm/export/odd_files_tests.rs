//! GGUF files beside a model that are none.

use super::round_trip_tests::{edit, export};
use super::writer::{Layout, PlannedTensor};
use crate::gguf::{FILE, find, open_header, tokenizer, tower_beside};
use crate::local::test_reference::fixture;
use crate::source::ModelPlace;
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::WeightFormat;
use serde_json::{Value, json};
use std::path::Path;

fn write(path: &Path, metadata: &[(&str, Value)]) {
    let tensors = vec![PlannedTensor {
        name: "a".into(),
        format: GgmlDType::F32.into(),
        shape: vec![2, 2],
    }];
    let metadata = metadata
        .iter()
        .map(|(key, value)| ((*key).to_owned(), value.clone()))
        .collect();
    let layout = Layout { metadata, tensors };
    let mut bytes = Vec::new();
    layout.write_header(&mut bytes).unwrap();
    Layout::write_data(&mut bytes, &[0; 16]).unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn what_is_no_model_does_not_hide_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(
        &path("imatrix.gguf"),
        &[
            ("general.type", json!("imatrix")),
            ("imatrix.chunk_count", json!(3)),
        ],
    );
    write(
        &path("m-00002-of-00003.gguf"),
        &[("split.no", json!(1)), ("split.count", json!(3))],
    );
    write(&path("nothing.gguf"), &[]);
    std::fs::write(path("page.gguf"), "<html>moved</html>").unwrap();
    std::fs::write(path("._m.gguf"), "\0\x05\x16\x07").unwrap();
    let error = find(folder.path()).unwrap_err().to_string();
    for said in [
        "imatrix.gguf: general.type: 'imatrix' is no model",
        "m-00002-of-00003.gguf: split.count: this is part 2 of 3",
        "the part m-00001-of-00003.gguf is not beside it",
        "nothing.gguf: general.architecture: is missing",
        "page.gguf: broken GGUF file: at byte 4: this is a web page",
    ] {
        assert!(error.contains(said), "{said} in {error}");
    }
    assert!(!error.contains("._m.gguf"), "{error}");
    assert_eq!(tower_beside(&path("m.gguf")).unwrap(), None);
    std::fs::write(path("mmproj-x.gguf"), "<html>moved</html>").unwrap();
    let broken = tower_beside(&path("m.gguf")).unwrap_err().to_string();
    assert!(broken.contains("mmproj-x.gguf: broken"), "{broken}");
    write(&path("M.GGUF"), &[("general.architecture", json!("llama"))]);
    write(
        &path("tower.gguf"),
        &[("general.architecture", json!("clip"))],
    );
    assert_eq!(find(folder.path()).unwrap(), Some(path("M.GGUF")));
    assert_eq!(
        tower_beside(&path("M.GGUF")).unwrap(),
        Some(path("tower.gguf"))
    );
}

/// Cuts a file into two parts as `gguf-split` does, and gives their paths.
fn split(path: &Path) -> [std::path::PathBuf; 2] {
    let bytes = std::fs::read(path).unwrap();
    let (header, _) = open_header(path).unwrap();
    let total = header.tensors.len();
    let names: Vec<&String> = header.tensors.keys().collect();
    let (first, second) = names.split_at(total / 2);
    let part = |number: u64, names: &[&String]| {
        let mut metadata = vec![
            ("split.no".to_owned(), json!(number)),
            ("split.count".to_owned(), json!(2)),
            ("split.tensors.count".to_owned(), json!(total)),
        ];
        if number == 0 {
            metadata.extend(header.metadata.clone());
        }
        let planned = names.iter().map(|name| {
            let place = &header.tensors[*name];
            PlannedTensor {
                name: (*name).clone(),
                format: place.format,
                shape: place.shape.clone(),
            }
        });
        let layout = Layout {
            metadata,
            tensors: planned.collect(),
        };
        let mut out = Vec::new();
        layout.write_header(&mut out).unwrap();
        for name in names {
            let place = &header.tensors[*name];
            let data = &bytes[place.begin as usize..][..place.bytes as usize];
            Layout::write_data(&mut out, data).unwrap();
        }
        let own = format!("m-{:05}-of-00002.gguf", number + 1);
        let path = path.with_file_name(own);
        std::fs::write(&path, out).unwrap();
        path
    };
    [part(0, first), part(1, second)]
}

#[test]
fn a_split_model_is_opened_by_any_part_and_by_its_folder() {
    let source = fixture("tiny_llava");
    let (whole, parts) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let model = export(&source, whole.path(), WeightFormat::F16);
    let tower = tower_beside(&model).unwrap().unwrap();
    let copied = parts.path().join("m.gguf");
    std::fs::copy(&model, &copied).unwrap();
    std::fs::copy(&tower, parts.path().join("mmproj-m.gguf")).unwrap();
    let [first, second] = split(&copied);
    std::fs::remove_file(&copied).unwrap();
    let gguf = |model: &Path| ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    };
    let load = |place: &ModelPlace| {
        crate::LocalModel::load("m", place, &crate::Loading::default()).map(|model| {
            let described = crate::Mllm::describe(&model);
            (described.parameters, described.load.weight_formats)
        })
    };
    let expected = load(&gguf(&model)).unwrap();
    let folder = ModelPlace::Folder(parts.path().to_path_buf());
    for place in [gguf(&first), gguf(&second), folder.clone()] {
        assert_eq!(load(&place).unwrap(), expected, "{place:?}");
        let check = crate::LocalModel::check(&place, &crate::Loading::default());
        assert_eq!(check.problems, [] as [&str; 0]);
        let bytes: u64 = [&first, &second]
            .map(|path| std::fs::metadata(path).unwrap().len())
            .iter()
            .sum();
        assert!(place.weight_bytes().unwrap() > bytes);
    }
    let said = |place: &ModelPlace| load(place).unwrap_err().to_string();
    let away = parts.path().join("x-00002-of-00002.gguf");
    std::fs::rename(&second, &away).unwrap();
    let missing = "the part m-00002-of-00002.gguf is not beside it";
    assert!(said(&gguf(&first)).contains(missing));
    assert!(said(&gguf(&away)).contains("the part x-00001-of-00002.gguf is not beside it"));
    std::fs::rename(&away, parts.path().join("second.gguf")).unwrap();
    let error = said(&gguf(&parts.path().join("second.gguf")));
    assert!(
        error.contains("must end in -00002-of-00002.gguf"),
        "{error}"
    );
    // A part of another model, under the name of this one's.
    write(
        &second,
        &[("split.no", json!(1)), ("split.count", json!(2))],
    );
    let error = said(&gguf(&first));
    assert!(
        error.contains("split.tensors.count") && error.contains("another model"),
        "{error}"
    );
    write(
        &second,
        &[("split.no", json!(0)), ("split.count", json!(2))],
    );
    let error = said(&gguf(&first));
    assert!(error.contains("its name is that of part 2 of 2"), "{error}");
    write(
        &first,
        &[("split.no", json!(0)), ("split.count", json!(1_u64 << 40))],
    );
    let error = said(&gguf(&first));
    assert!(error.contains("at most 1024 are supported"), "{error}");
}

/// The pair of a LLaVA, as llama.cpp writes it, with a further key in one of its files.
fn with_key(is_tower: bool, key: &str, value: &Value) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let model = export(&fixture("tiny_llava"), folder.path(), WeightFormat::F16);
    let tower = tower_beside(&model).unwrap().unwrap();
    for path in [&model, &tower] {
        edit(path, |header, _| {
            header.metadata.retain(|key, _| !key.starts_with(FILE));
            if (*path == tower) == is_tower {
                header.metadata.insert(key.to_owned(), value.clone());
            }
        });
    }
    let place = ModelPlace::Gguf {
        model,
        mmproj: None,
    };
    let check = crate::LocalModel::check(&place, &crate::Loading::default());
    [check.problems, check.load.notes].concat()
}

#[test]
fn a_key_that_changes_the_result_and_is_not_read_is_named() {
    for (is_tower, key, value, is_refused) in [
        (false, "llama.logit_scale", json!(2.0), true),
        (false, "llama.logit_scale", json!(1.0), false),
        (false, "llama.attention.scale", json!(0.5), true),
        (false, "llama.attention.causal", json!(false), true),
        (false, "llama.attention.causal", json!(true), false),
        (false, "llama.final_logit_softcapping", json!(30.0), true),
        (false, "llama.ssm.state_size", json!(16), true),
        (
            false,
            "llama.rope.scaling.yarn_beta_fast",
            json!(32.0),
            false,
        ),
        (true, "clip.vision.n_wa_pattern", json!(8), true),
        (true, "clip.vision.image_max_pixels", json!(4096), true),
        (
            true,
            "clip.vision.is_deepstack_layers",
            json!([false, false]),
            false,
        ),
        (true, "clip.vision.projection_dim", json!(64), false),
    ] {
        let said = with_key(is_tower, key, &value).join("\n");
        let named = said.contains(&format!("{key}: {value} changes the result"));
        assert_eq!(named, is_refused, "{key} = {value}: {said}");
        assert_eq!(said.contains(key), is_refused, "{key} = {value}: {said}");
    }
    for (is_tower, key) in [(false, "llama.next_year"), (true, "clip.vision.next_year")] {
        let said = with_key(is_tower, key, &json!(3)).join("\n");
        assert!(
            said.contains(&format!("the key {key} is not known")),
            "{said}"
        );
    }
}

#[test]
fn an_error_about_metadata_names_the_key_of_the_file() {
    for (is_tower, key, value) in [
        (false, "llama.attention.head_count", json!(5000)),
        (true, "clip.vision.attention.head_count", json!(5000)),
    ] {
        let said = with_key(is_tower, key, &value).join("\n");
        assert!(said.contains(&format!(".gguf: {key}: ")), "{key}: {said}");
    }
}

#[test]
fn a_file_that_does_not_say_how_texts_are_split_is_noted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.gguf");
    for (architecture, pre, taken) in [
        ("llama", None, Some("the split of GPT-2")),
        ("llama", Some("default"), Some("the split of GPT-2")),
        ("qwen2", None, Some("the split of qwen2")),
        ("qwen2", Some("default"), Some("the split of GPT-2")),
        ("qwen2", Some("qwen2"), None),
    ] {
        let mut metadata = vec![
            ("general.architecture", json!(architecture)),
            ("tokenizer.ggml.model", json!("gpt2")),
        ];
        metadata.extend(pre.map(|pre| ("tokenizer.ggml.pre", json!(pre))));
        write(&path, &metadata);
        let note = tokenizer::note(&open_header(&path).unwrap().0).unwrap();
        match (taken, note) {
            (None, None) => {}
            (Some(taken), Some(note)) => {
                assert!(note.contains(taken) && note.contains("m.gguf"), "{note}");
            }
            other => panic!("{architecture} {pre:?}: {other:?}"),
        }
    }
    std::fs::write(folder.path().join("tokenizer.json"), "{}").unwrap();
    write(
        &path,
        &[
            ("general.architecture", json!("llama")),
            ("tokenizer.ggml.model", json!("gpt2")),
        ],
    );
    assert_eq!(
        tokenizer::note(&open_header(&path).unwrap().0).unwrap(),
        None
    );
}
