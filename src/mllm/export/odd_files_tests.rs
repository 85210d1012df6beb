//! GGUF files beside a model that are none.

use super::writer::{Layout, PlannedTensor};
use crate::gguf::{find, open_header, tokenizer, tower_beside};
use crate::source::ModelPlace;
use candle_core::quantized::GgmlDType;
use serde_json::{Value, json};
use std::path::Path;

fn write(path: &Path, metadata: &[(&str, Value)]) {
    let tensors = vec![PlannedTensor {
        name: "a".into(),
        format: GgmlDType::F32,
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
        "m-00001-of-00003.gguf",
        "nothing.gguf: general.architecture: is missing",
        "page.gguf: broken GGUF file: at byte 4: this is a web page",
    ] {
        let said = said.replace("m-00001-of-00003.gguf", "-00001-of-00003.gguf");
        assert!(error.contains(&said), "{said} in {error}");
    }
    assert!(!error.contains("._m.gguf"), "{error}");
    assert!(tower_beside(&path("m.gguf")).is_err());
    write(&path("M.GGUF"), &[("general.architecture", json!("llama"))]);
    write(
        &path("tower.gguf"),
        &[("general.architecture", json!("clip"))],
    );
    assert_eq!(find(folder.path()).unwrap(), Some(path("M.GGUF")));
    assert_eq!(tower_beside(&path("M.GGUF")).unwrap(), path("tower.gguf"));
}

#[test]
fn each_part_of_a_split_model_is_named_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("m-00001-of-00002.gguf");
    let second = folder.path().join("m-00002-of-00002.gguf");
    write(
        &first,
        &[
            ("general.architecture", json!("llama")),
            ("split.no", json!(0)),
            ("split.count", json!(2)),
        ],
    );
    write(
        &second,
        &[("split.no", json!(1)), ("split.count", json!(2))],
    );
    let gguf = |model: &Path| ModelPlace::Gguf {
        model: model.to_path_buf(),
        mmproj: None,
    };
    for place in [
        gguf(&first),
        gguf(&second),
        ModelPlace::Folder(folder.path().to_path_buf()),
    ] {
        let check = crate::LocalModel::check(&place, &crate::Loading::default());
        let said = check.problems.join("\n");
        assert!(
            said.contains("split.count") && said.contains("llama-gguf-split --merge"),
            "{place:?}: {said}"
        );
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
                assert!(note.contains(taken) && note.contains("m.gguf"), "{note}")
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
