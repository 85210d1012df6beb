//! Data for trainers of others, and the adapter that comes back.

use super::{SCENE, read_json, refused, run};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Writes a dataset of messages with these states for validation and further arguments.
fn write(out: &Path, validation: &str, more: &[&str]) {
    let arguments = [
        "dataset",
        "--for",
        "messages",
        "--out",
        out.to_str().unwrap(),
        "--states",
        "1",
        "--validation",
        validation,
        "--quiet",
    ];
    let (code, _, stderr) = run(&[&arguments[..], more].concat());
    assert_eq!(code, 0, "{stderr}");
}

fn rows(file: &Path) -> Vec<Value> {
    let text = fs::read_to_string(file).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// All files of a folder with their bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
                continue;
            }
            let name = path.strip_prefix(folder).unwrap().display().to_string();
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

/// The type of a column as a table has it.
fn column_type(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(_) => "bool".to_owned(),
        Value::Number(number) if number.is_f64() => "float".to_owned(),
        Value::Number(_) => "int".to_owned(),
        Value::String(_) => "string".to_owned(),
        Value::Array(list) => {
            let kinds: BTreeSet<String> = list.iter().map(column_type).collect();
            format!("list of {kinds:?}")
        }
        Value::Object(fields) => {
            let fields: Vec<String> = fields
                .iter()
                .map(|(name, value)| format!("{name}: {}", column_type(value)))
                .collect();
            format!("{{{}}}", fields.join(", "))
        }
    }
}

/// Checks that each column has one type in all rows, and none is null: `datasets` reads them so.
fn assert_table(rows: &[Value]) {
    let types: BTreeSet<String> = rows.iter().map(column_type).collect();
    assert_eq!(types.len(), 1, "{types:#?}");
    assert!(!types.first().unwrap().contains("null"), "{types:?}");
}

/// Checks a chat: a system prompt, then turns in turn, and the picture's place in the first.
fn assert_chat(messages: &Value, turns: usize, picture: bool) {
    let messages = messages.as_array().unwrap();
    assert_eq!(messages.len(), 1 + turns);
    for (index, message) in messages.iter().enumerate() {
        let role = match index {
            0 => "system",
            odd if odd % 2 == 1 => "user",
            _ => "assistant",
        };
        assert_eq!(message["role"], role);
        let content = message["content"].as_str().unwrap();
        assert!(!content.is_empty());
        let has_place = content.starts_with("<image>\n");
        assert_eq!(has_place, picture && index == 1, "{content}");
    }
}

#[test]
fn messages_lessons_preferences_and_codes_are_tables_with_pictures_beside() {
    let work = TempDir::new().unwrap();
    let (out, again) = (work.path().join("data"), work.path().join("again"));
    write(&out, "1", &[]);
    write(&again, "1", &[]);
    assert!(
        files(&out) == files(&again),
        "the same seed, the same bytes"
    );
    let messages = rows(&out.join("messages/train/00000.jsonl"));
    assert_table(&messages);
    let mut pictures = BTreeSet::new();
    for row in &messages {
        assert_chat(&row["messages"], 6, true);
        let [picture] = row["images"].as_array().unwrap().as_slice() else {
            panic!("{row}")
        };
        let path = out.join(picture.as_str().unwrap());
        let image = image::open(path).unwrap();
        assert_eq!((image.width(), image.height()), (128, 128));
        pictures.insert(picture.to_string());
    }
    assert_eq!(pictures.len(), messages.len(), "one conversation a state");

    let preferences = rows(&out.join("preferences/train/00000.jsonl"));
    assert_table(&preferences);
    assert!(!preferences.is_empty());
    for row in &preferences {
        let turns = if row["round"] == "code" { 5 } else { 3 };
        assert_chat(&row["prompt"], turns, true);
        assert_chat(&row["messages"], turns + 1, true);
        assert_eq!(row["chosen"][0], row["chosen_message"]);
        assert_eq!(row["rejected"][0], row["rejected_message"]);
        assert_eq!(row["rejected_response"], row["rejected_message"]["content"]);
        assert_ne!(row["chosen"], row["rejected"]);
        assert!(row["feedback"].as_str().unwrap().starts_with("again:"));
    }

    let codes = rows(&out.join("codes/train/00000.jsonl"));
    assert_table(&codes);
    let outcomes: BTreeSet<&str> = codes
        .iter()
        .map(|row| row["outcome"].as_str().unwrap())
        .collect();
    assert_eq!(outcomes, BTreeSet::from(["refused", "scored"]));
    for row in &codes {
        let is_refused = row["outcome"] == "refused";
        assert_eq!(row["reason"].as_str().unwrap().is_empty(), !is_refused);
        assert_chat(&row["prompt"], 5, true);
    }
    let best = codes.iter().filter(|row| row["best"] == true).count();
    assert_eq!(best, messages.len());

    let lessons = rows(&out.join("lessons/train/00000.jsonl"));
    assert_table(&lessons);
    let number = |row: &Value, column: &str| row[column].as_f64().unwrap();
    for row in &messages {
        let of_state = lessons
            .iter()
            .filter(|lesson| lesson["state"] == row["state"]);
        let (mut chances, mut highest) = (0.0, f64::NEG_INFINITY);
        for lesson in of_state {
            assert_chat(&lesson["messages"], 6, true);
            assert_eq!(lesson["images"], row["images"]);
            assert!(number(lesson, "weight") > 0.0, "{lesson}");
            chances += number(lesson, "chance");
            highest = highest.max(number(lesson, "value"));
        }
        assert!((chances - 1.0).abs() < 1e-9, "{chances}");
        let best = codes
            .iter()
            .find(|code| code["state"] == row["state"] && code["best"] == true)
            .unwrap();
        assert!(
            number(best, "value") >= highest,
            "no lesson is worth more than the label"
        );
    }

    let seeds = |split: &str| -> BTreeSet<String> {
        rows(&out.join(format!("messages/{split}/00000.jsonl")))
            .iter()
            .map(|row| row["state"]["scenario"].to_string())
            .collect()
    };
    assert!(seeds("train").is_disjoint(&seeds("validation")));
    let card = fs::read_to_string(out.join("README.md")).unwrap();
    for said in [
        "license: apache-2.0",
        "No recording is in it",
        "| seed | 0 |",
        "| prompt set | compact-2 (BLAKE3",
        "128 x 128 pixels",
        "path: preferences/validation/*.jsonl",
        "10000000 to 19999999",
    ] {
        assert!(card.contains(said), "{said}: {card}");
    }
    let listed = read_json(&out.join("dataset_info.json"));
    for entry in listed.as_object().unwrap().values() {
        assert!(out.join(entry["file_name"].as_str().unwrap()).is_dir());
        let file = out.join(entry["file_name"].as_str().unwrap());
        let first = rows(&file.join("00000.jsonl")).remove(0);
        for column in entry["columns"].as_object().unwrap().values() {
            assert!(!first[column.as_str().unwrap()].is_null(), "{column}");
        }
    }
}

#[test]
fn any_prompt_set_and_described_model_has_its_messages_and_a_shard_is_resumed() {
    let work = TempDir::new().unwrap();
    for (model, set, pixels) in [
        ("smolvlm2-256m", "brief", Some(512)),
        ("tests/fixtures/tiny_lora/base", "paper", None),
    ] {
        let out = work.path().join(set);
        let more = ["--model", model, "--prompt-set", set, "--trust-model"];
        write(&out, "0", &more);
        let before = files(&out);
        let messages = rows(&out.join("messages/train/00000.jsonl"));
        assert_table(&messages);
        assert_chat(&messages[0]["messages"], 6, pixels.is_some());
        let system = messages[0]["messages"][0]["content"].as_str().unwrap();
        assert_eq!(system.contains("Colours:"), pixels.is_some(), "{system}");
        match pixels {
            Some(pixels) => {
                let picture = messages[0]["images"][0].as_str().unwrap();
                assert_eq!(image::open(out.join(picture)).unwrap().width(), pixels);
            }
            None => assert!(messages[0]["images"].is_null() && !out.join("images").exists()),
        }
        // What a killed command leaves: a shard without its last file.
        fs::remove_file(out.join("messages/train/00000.jsonl")).unwrap();
        fs::remove_file(out.join("README.md")).unwrap();
        write(&out, "0", &more);
        assert!(files(&out) == before, "{set}");
        let out = out.to_str().unwrap();
        let other = refused(&["dataset", "--for", "messages", "--out", out]);
        assert!(other.contains("other settings"), "{other}");
    }
    let foreign = refused(&["dataset", "--for", "messages", "--driven", "--out", "x"]);
    assert!(
        foreign.contains("--driven belongs to --for labels"),
        "{foreign}"
    );
}

#[test]
fn other_agents_are_taught_at_the_same_states() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("data");
    write(&out, "0", &["--agents", "gpt-driver,dilu"]);
    let states = |agent: &str| -> BTreeSet<String> {
        let conversations = rows(&out.join(format!("{agent}/train/00000.jsonl")));
        assert_table(&conversations);
        for row in &conversations {
            let turns = if agent == "messages" { 6 } else { 2 };
            assert_chat(&row["messages"], turns, agent == "messages");
        }
        let states = conversations.iter().map(|row| row["state"].to_string());
        states.collect()
    };
    let all = states("messages");
    assert!(all.len() > 20);
    for (agent, says) in [("gpt-driver", "Trajectory: [("), ("dilu", "\n#### ")] {
        // A search near the end of a scene may find no answer.
        let taught = states(agent);
        assert!(taught.is_subset(&all) && taught.len() * 10 > all.len() * 9);
        let conversations = rows(&out.join(format!("{agent}/train/00000.jsonl")));
        let answers: BTreeSet<&str> = conversations
            .iter()
            .filter_map(|row| row["messages"][2]["content"].as_str())
            .collect();
        assert!(answers.len() > 4, "{answers:?}");
        assert!(answers.iter().all(|answer| answer.contains(says)));
    }
    let unknown = refused(&[
        "dataset",
        "--for",
        "messages",
        "--agents",
        "chauffeur",
        "--out",
        "x",
    ]);
    assert!(unknown.contains("gpt-driver"), "{unknown}");
    let foreign = refused(&["dataset", "--agents", "dilu", "--out", "x"]);
    assert!(
        foreign.contains("--agents belongs to --for messages"),
        "{foreign}"
    );
}

#[test]
fn an_adapter_that_trl_wrote_drives_a_scene() {
    let work = TempDir::new().unwrap();
    let calls = |adapter: &[&str], out: &str| -> Vec<Value> {
        let out = work.path().join(out);
        let arguments = [
            "simulate",
            "--scenario",
            SCENE,
            "--model",
            "tests/fixtures/tiny_lora/base",
            "--prompt-set",
            "compact",
            "--trust-model",
            "--out",
            out.to_str().unwrap(),
        ];
        let (code, _, stderr) = run(&[&arguments[..], adapter].concat());
        assert_eq!(code, 0, "{stderr}");
        let manifest = fs::read_to_string(out.join("manifest.toml")).unwrap();
        assert_eq!(
            manifest.contains("[model.load.adapter]"),
            !adapter.is_empty()
        );
        rows(&out.join("calls.jsonl"))
    };
    let with = calls(&["--adapter", "tests/fixtures/tiny_lora/adapter"], "with");
    let without = calls(&[], "without");
    assert!(with.len() > 3);
    for call in &with {
        assert!(call["attempts"][0]["code"]["text"].is_string(), "{call}");
    }
    let answers = |calls: &[Value]| -> Vec<Value> {
        let rounds = calls[0]["attempts"][0]["rounds"].as_array().unwrap();
        rounds.iter().map(|round| round["answer"].clone()).collect()
    };
    assert_ne!(answers(&with), answers(&without));
    for round in with[0]["attempts"][0]["rounds"].as_array().unwrap() {
        assert!(round["log_probability"].as_f64().unwrap() <= 0.0, "{round}");
    }
}
