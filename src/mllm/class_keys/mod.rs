//! Every key of every class that families read: left out, it has the default of its class, and no
//! key that changes the result is passed over.
//!
//! `tests/fixtures/class_keys.json` has the classes, made by `make_class_keys.py`; `table.toml`
//! says how each key is treated. A new version of transformers with further keys fails here until
//! someone has decided about them.

use crate::checkpoint::{ModelFiles, read_json};
use crate::local::test_reference::fixture;
use crate::{
    MllmError, cogvlm, gemma3, gemma3n, gemma4, internvl, lfm2_vl, llava, llava_next,
    llava_onevision, qwen2_5_vl, qwen2_vl, qwen3_5, qwen3_vl, smolvlm, text_only,
};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// A class in `table.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Class {
    family: String,
    base: String,
    place: String,
    read: Vec<String>,
    #[serde(default)]
    elsewhere: Vec<String>,
    #[serde(default)]
    none: Vec<String>,
    #[serde(default)]
    refused: Vec<String>,
    #[serde(default)]
    by_weights: Vec<String>,
    #[serde(default)]
    others: Map<String, Value>,
}

/// The table, by the names of classes.
fn table() -> BTreeMap<String, Class> {
    toml::from_str(include_str!("table.toml")).unwrap()
}

/// Keys and defaults of all classes, by name.
fn classes() -> BTreeMap<String, Map<String, Value>> {
    let file = read_json(&fixture("class_keys.json")).unwrap();
    serde_json::from_value(file["classes"].clone()).unwrap()
}

/// What is read of a model with `value` at the key, or without the key.
fn read(class: &Class, key: &str, value: Option<&Value>) -> Result<String, MllmError> {
    let mut files: Value = serde_json::from_str(&class.base).unwrap();
    let object = files
        .pointer_mut(&class.place)
        .unwrap()
        .as_object_mut()
        .unwrap();
    match value {
        Some(value) => object.insert(key.to_string(), value.clone()),
        None => object.remove(key),
    };
    let texts = files
        .as_object()
        .unwrap()
        .iter()
        .map(|(name, value)| (name.clone(), value.to_string()));
    let files = ModelFiles::packed(Path::new("model"), texts.collect());
    // One match: the fixture names families, and each has a reader of its own.
    match class.family.as_str() {
        "llava" => llava::read_files(&files),
        "llava-next" => llava_next::read_files(&files),
        "cogvlm" => cogvlm::read_files(&files),
        "smolvlm" => smolvlm::read_files(&files),
        "internvl" => internvl::read_files(&files),
        "qwen2.5-vl" => qwen2_5_vl::read_files(&files),
        "qwen2-vl" => qwen2_vl::read_files(&files),
        "qwen3-vl" => qwen3_vl::read_files(&files),
        "qwen3.5" => qwen3_5::read_files(&files),
        "llava-onevision" => llava_onevision::read_files(&files),
        "gemma3" => gemma3::read_files(&files),
        "gemma3n" => gemma3n::read_files(&files),
        "gemma4" => gemma4::read_files(&files),
        "lfm2-vl" => lfm2_vl::read_files(&files),
        "gemma3_text" | "gemma3n_text" | "gemma4_text" | "lfm2" | "qwen3_5_text" => {
            text_only::read_files(&files)
        }
        other => panic!("{other} is no family"),
    }
}

/// What was read, or the error.
fn told(found: Result<String, MllmError>) -> String {
    found.unwrap_or_else(|error| error.to_string())
}

/// Another value of the same type; the table has those for which it is not enough.
fn another(class: &Class, key: &str, default: &Value) -> Value {
    if let Some(other) = class.others.get(key) {
        return other.clone();
    }
    match default {
        Value::Bool(flag) => json!(!flag),
        Value::Number(number) if number.is_u64() => json!(number.as_u64().unwrap() * 2),
        Value::Number(number) => json!(number.as_f64().unwrap() * 2.0),
        Value::String(_) => json!("relu"),
        Value::Null => json!(7),
        Value::Array(_) | Value::Object(_) => panic!("{key}: the table needs another value"),
    }
}

#[test]
fn the_table_has_all_keys_of_all_classes() {
    let known = classes();
    assert!(known.keys().eq(table().keys()));
    for (name, class) in table() {
        let mut listed = [class.read, class.elsewhere, class.none, class.refused].concat();
        listed.sort_unstable();
        let mut keys: Vec<&String> = known[&name].keys().collect();
        keys.sort_unstable();
        assert!(
            listed.iter().eq(keys.iter().copied()),
            "{name}: {listed:?} instead of {keys:?}"
        );
    }
}

#[test]
fn a_key_that_is_left_out_has_the_default_of_its_class() {
    let mut wrong = Vec::new();
    let known = classes();
    for (name, class) in &table() {
        read(class, "", None).unwrap_or_else(|error| panic!("{name}: {error}"));
        for (key, default) in &known[name] {
            if class.by_weights.contains(key) {
                continue;
            }
            let (without, with) = (
                told(read(class, key, None)),
                told(read(class, key, Some(default))),
            );
            if without != with {
                wrong.push(format!("{name} {key}: {without} instead of {with}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_key_that_is_read_changes_what_is_read() {
    let mut wrong = Vec::new();
    let known = classes();
    for (name, class) in &table() {
        let same = told(read(class, "", None));
        for key in &class.read {
            let other = another(class, key, &known[name][key]);
            if told(read(class, key, Some(&other))) == same {
                wrong.push(format!("{name} {key} = {other}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_key_without_effect_changes_nothing() {
    let mut wrong = Vec::new();
    let known = classes();
    for (name, class) in &table() {
        let same = told(read(class, "", None));
        for key in &class.none {
            let other = match &known[name][key] {
                Value::Array(_) | Value::Object(_) => json!([]),
                default => another(class, key, default),
            };
            if told(read(class, key, Some(&other))) != same {
                wrong.push(format!("{name} {key} = {other}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_key_that_no_code_reads_is_refused_by_name() {
    let mut wrong = Vec::new();
    let known = classes();
    for (name, class) in &table() {
        for key in &class.refused {
            let other = another(class, key, &known[name][key]);
            match read(class, key, Some(&other)) {
                Err(MllmError::Config { key: named, .. })
                    if named.split('.').any(|part| part == key) => {}
                found => wrong.push(format!("{name} {key} = {other}: {}", told(found))),
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
