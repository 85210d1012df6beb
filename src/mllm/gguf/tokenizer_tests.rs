//! SentencePiece tokenizers in GGUF metadata, there and back.

use super::header::Header;
use super::tokenizer;
use crate::export::tokenizer_metadata;
use proptest::prelude::*;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::path::Path;
use tokenizers::Tokenizer;

/// Words whose pieces overlap in many ways.
const WORDS: [&str; 24] = [
    "\u{2581}lane",
    "\u{2581}left",
    "\u{2581}keep",
    "\u{2581}the",
    "\u{2581}there",
    "there",
    "here",
    "lane",
    "keep",
    "eep",
    "anea",
    "\u{2581}\u{2581}",
    "\u{2581}\u{2581}\u{2581}\u{2581}",
    "ing",
    "king",
    "\u{2581}king",
    "aaa",
    "aaaa",
    "ab",
    "ba",
    "abab",
    "1",
    "12",
    "über",
];

/// A tokenizer like Llama 2's: bytes, a space before every text, `▁` for spaces; merges in the
/// order of the words.
fn llama(prefix: bool) -> Json {
    made(prefix, ('!'..='~').chain(['\u{2581}', 'ü']), &WORDS)
}

/// One with few tokens.
pub(crate) fn small() -> Json {
    made(
        true,
        ('a'..='z').chain(['\u{2581}', ':', '<', '>']),
        &["\u{2581}lane", "\u{2581}keep", "\u{2581}left"],
    )
}

fn made(prefix: bool, characters: impl Iterator<Item = char>, words: &[&str]) -> Json {
    let mut tokens: Vec<String> = ["<unk>", "<s>", "</s>"].map(String::from).to_vec();
    tokens.extend((0..256).map(|byte| format!("<0x{byte:02X}>")));
    tokens.extend(characters.map(String::from));
    let mut merges = Vec::new();
    for word in words {
        let characters: Vec<char> = word.chars().collect();
        for end in 2..=characters.len() {
            let piece: String = characters[..end].iter().collect();
            if !tokens.contains(&piece) {
                // Like SentencePiece, with every pair of pieces that makes the piece.
                for at in 1..end {
                    let (left, right): (String, String) = (
                        characters[..at].iter().collect(),
                        characters[at..end].iter().collect(),
                    );
                    if tokens.contains(&left) && tokens.contains(&right) {
                        merges.push(json!([left, right]));
                    }
                }
                tokens.push(piece);
            }
        }
    }
    let vocabulary: serde_json::Map<_, _> = tokens
        .iter()
        .enumerate()
        .map(|(id, token)| (token.clone(), json!(id)))
        .collect();
    let special = |id: u32, content: &str| {
        json!({"id": id, "content": content, "single_word": false, "lstrip": false, "rstrip": false, "normalized": false,
            "special": true})
    };
    let space = json!({"type": "Replace", "pattern": {"String": " "}, "content": "\u{2581}"});
    let prepend = json!({"type": "Prepend", "prepend": "\u{2581}"});
    let mut decoders = vec![
        json!({"type": "Replace", "pattern": {"String": "\u{2581}"}, "content": " "}),
        json!({"type": "ByteFallback"}),
        json!({"type": "Fuse"}),
    ];
    if prefix {
        decoders.push(json!({"type": "Strip", "content": " ", "start": 1, "stop": 0}));
    }
    json!({
        "version": "1.0", "truncation": null, "padding": null,
        "added_tokens": [special(0, "<unk>"), special(1, "<s>"), special(2, "</s>")],
        "normalizer": {"type": "Sequence", "normalizers": if prefix { vec![prepend, space] } else { vec![space] }},
        "pre_tokenizer": null,
        "post_processor": {"type": "TemplateProcessing",
            "single": [{"SpecialToken": {"id": "<s>", "type_id": 0}}, {"Sequence": {"id": "A", "type_id": 0}}],
            "pair": [{"Sequence": {"id": "A", "type_id": 0}}, {"Sequence": {"id": "B", "type_id": 1}}],
            "special_tokens": {"<s>": {"id": "<s>", "ids": [1], "tokens": ["<s>"]}}},
        "decoder": {"type": "Sequence", "decoders": decoders},
        "model": {"type": "BPE", "dropout": null, "unk_token": "<unk>", "continuing_subword_prefix": null,
            "end_of_word_suffix": null, "fuse_unk": true, "byte_fallback": true, "ignore_merges": false,
            "vocab": vocabulary, "merges": merges},
    })
}

/// Rows of the embedding of the tests' models: more than there are tokens.
const VOCABULARY: usize = 512;

/// GGUF's metadata of a tokenizer for a model of `vocabulary` rows.
pub(crate) fn metadata(json: &Json, vocabulary: usize) -> BTreeMap<String, Json> {
    let special = [
        ("bos_token", "<s>"),
        ("eos_token", "</s>"),
        ("unk_token", "<unk>"),
    ];
    let special: BTreeMap<_, _> = special
        .map(|(role, token)| (role.to_string(), token.to_string()))
        .into();
    tokenizer_metadata::metadata(json, &special, vocabulary)
        .unwrap()
        .into_iter()
        .collect()
}

fn header(json: &Json) -> Header {
    let metadata = metadata(json, VOCABULARY);
    Header::new(Path::new("m.gguf"), metadata, BTreeMap::new())
}

/// A tokenizer before and after GGUF.
fn both(prefix: bool) -> [Tokenizer; 2] {
    let json = llama(prefix);
    let read = tokenizer::read(&header(&json), VOCABULARY).unwrap();
    assert_eq!(
        (
            read.ends.first().copied(),
            read.config["bos_token"].as_str()
        ),
        (Some(2), Some("<s>"))
    );
    [json, read.tokenizer].map(|json| serde_json::from_value(json).unwrap())
}

fn ids(tokenizer: &Tokenizer, text: &str, special: bool) -> Vec<u32> {
    tokenizer.encode(text, special).unwrap().get_ids().to_vec()
}

#[test]
fn the_same_texts_become_the_same_tokens() {
    for prefix in [true, false] {
        let [ours, back] = both(prefix);
        for text in [
            "",
            " ",
            "keep the lane",
            "  there  is\u{2581}a king\n",
            "Überholen über 12 \u{1f697}!",
            "<s>left</s> here<unk>",
            "abababab aaaaaaa",
            "\t\0",
            "<0x0A>",
        ] {
            for special in [true, false] {
                let expected = ids(&ours, text, special);
                assert_eq!(ids(&back, text, special), expected, "{text:?}");
                assert_eq!(
                    back.decode(&expected, true).unwrap(),
                    ours.decode(&expected, true).unwrap()
                );
            }
        }
        assert!(
            ids(&back, "keep the lane", false).len() <= 4,
            "words are whole"
        );
    }
}

proptest! {
    #[test]
    fn any_text_becomes_the_same_tokens(text in "([a-eghiklnprt ▁ü1-3]{0,12}|\\PC{0,6}){0,4}", prefix: bool) {
        let [ours, back] = both(prefix);
        prop_assert_eq!(ids(&back, &text, true), ids(&ours, &text, true));
    }
}

/// Files of Gemma 4 have the merges in the place of scores that order them.
#[test]
fn merges_that_a_file_names_are_taken_as_they_are() {
    let json = llama(false);
    let mut header = header(&json);
    let merges: Vec<String> = json["model"]["merges"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pair| {
            format!(
                "{} {}",
                pair[0].as_str().unwrap(),
                pair[1].as_str().unwrap()
            )
        })
        .collect();
    let mut set = |key: &str, value: Json| {
        header
            .metadata
            .insert(format!("tokenizer.ggml.{key}"), value)
    };
    set("model", json!("gemma4"));
    set("merges", json!(merges));
    header.metadata.remove("tokenizer.ggml.scores");
    header.metadata.remove("tokenizer.ggml.add_space_prefix");
    let read = tokenizer::read(&header, VOCABULARY).unwrap();
    let back: Tokenizer = serde_json::from_value(read.tokenizer).unwrap();
    let ours: Tokenizer = serde_json::from_value(json).unwrap();
    for text in [
        "keep the lane",
        " there  is a king\n\n",
        "Über \u{1f697}!",
        "<s>left",
    ] {
        assert_eq!(ids(&back, text, true), ids(&ours, text, true), "{text:?}");
    }
    for wrong in [
        json!(["a"]),
        json!(["zz zz"]),
        json!(["a ", "b"]),
        json!(7),
        Json::Null,
    ] {
        header
            .metadata
            .insert("tokenizer.ggml.merges".into(), wrong.clone());
        let problem = tokenizer::read(&header, VOCABULARY)
            .err()
            .unwrap()
            .to_string();
        assert!(
            problem.contains("tokenizer.ggml.merges"),
            "{wrong}: {problem}"
        );
    }
}

#[test]
fn a_placeholder_of_images_is_found_or_added_behind_all_tokens() {
    let mut json = llama(true);
    let tokens = json["model"]["vocab"].as_object().unwrap().len() as u64;
    assert_eq!(tokenizer::image_token(&mut json).unwrap(), tokens);
    assert_eq!(tokenizer::image_token(&mut json).unwrap(), tokens, "once");
    let made: Tokenizer = serde_json::from_value(json).unwrap();
    let ids = ids(&made, "USER: <image>\nkeep", false);
    assert_eq!(
        ids.iter().filter(|id| u64::from(**id) == tokens).count(),
        1,
        "{ids:?}"
    );
}

#[test]
fn what_is_no_tokenizer_is_named() {
    let broken = |change: &dyn Fn(&mut BTreeMap<String, Json>)| {
        let mut header = header(&llama(true));
        change(&mut header.metadata);
        match tokenizer::read(&header, VOCABULARY) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("it is read"),
        }
    };
    let set = |key: &'static str, value: Json| {
        move |metadata: &mut BTreeMap<String, Json>| {
            drop(metadata.insert(format!("tokenizer.ggml.{key}"), value.clone()));
        }
    };
    for (error, expected) in [
        (
            broken(&|metadata| metadata.clear()),
            "tokenizer.json beside",
        ),
        (
            broken(&set("model", json!("bert"))),
            "tokenizer.json beside",
        ),
        (broken(&set("model", json!(3))), "expected a text, found 3"),
        (broken(&set("tokens", json!(vec!["a"; 513]))), "512 rows"),
        (
            broken(&set("tokens", json!(vec!["a"; 3]))),
            "types of 3 tokens",
        ),
        (
            broken(&set("tokens", json!(["a".repeat(2000)]))),
            "2000 bytes",
        ),
        (
            broken(&set("scores", json!(vec![f32::NAN; 512]))),
            "expected",
        ),
        (broken(&set("token_type", json!([1]))), "1 types"),
        (broken(&set("bos_token_id", json!(70_000))), "70000 is none"),
    ] {
        assert!(error.contains(expected), "{expected}: {error}");
    }
    let header = header(&llama(true));
    let error = tokenizer::read(&header, 100).err().unwrap().to_string();
    assert!(error.contains("100 rows"), "{error}");
}
