//! The TOML and JSON blocks of README.md and docs are whole files of the program: each is parsed,
//! alone and as printed, by the types that the program reads it with. The model of a description is
//! opened, with a tiny model in the place of its files.

use super::text::{Block, blocks};
use super::{docs, name, read, root};
use planagent_lab::study;
use planagent_mllm::{HubAccess, ModelRegistry, ModelSource, ModelSpec, Trust};
use planagent_runs::runner::Config;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The tiny model of a family.
fn tiny(architecture: &str) -> PathBuf {
    let folder = match architecture {
        "smolvlm" => "tiny_smolvlm",
        "internvl" => "tiny_internvl3",
        "qwen2.5-vl" => "tiny_qwen2_5_vl",
        "qwen2-vl" => "tiny_qwen2_vl",
        "llava-onevision" => "tiny_llava_onevision",
        "gemma3" => "tiny_gemma3",
        "gemma3n" => "tiny_gemma3n_vision",
        "gemma4" => "tiny_gemma4",
        "qwen3-vl" => "tiny_qwen3_vl",
        "cogvlm" => "tiny_cogvlm",
        "llava-next" => "tiny_llava_next",
        _ => "tiny_llava",
    };
    root().join("tests/fixtures").join(folder)
}

/// Parses a description and opens its model.
fn open(place: &str, text: &str) {
    let mut spec = ModelSpec::parse(Path::new("models/x.toml"), text)
        .unwrap_or_else(|error| panic!("{place}: {error}"));
    let registry = ModelRegistry::new(
        "models",
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let architecture = spec
        .architecture
        .map_or("llava", |architecture| architecture.name());
    let here = || ModelSource::Folder {
        folder: tiny(architecture),
    };
    match &mut spec.source {
        // The key is the reader's.
        ModelSource::Endpoint(settings) => settings.key_env = None,
        // A decoder alone is one of llama.cpp's files.
        files if !spec.vision => {
            *files = ModelSource::File {
                file: root().join("tests/fixtures/tiny_qwen2_5_vl/gguf/model.gguf"),
                mmproj: None,
            }
        }
        files => *files = here(),
    }
    // No tiny model can think.
    spec.generation.thinking = None;
    for source in [&mut spec.tokenizer, &mut spec.draft_model]
        .into_iter()
        .flatten()
    {
        *source = here();
    }
    let opened = registry.with_trust(Trust::Caller).open(&spec);
    opened.unwrap_or_else(|error| panic!("{place}: {error}"));
}

/// Parses a study as `planagent study FILE.toml` does.
fn parse_study(place: &str, text: &str) {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("study.toml");
    fs::write(&file, text).unwrap();
    study::find(file.to_str().unwrap()).unwrap_or_else(|error| panic!("{place}: {error}"));
}

/// Parses settings as those of `planagent.toml`.
fn parse_settings(place: &str, text: &str) {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("planagent.toml");
    fs::write(&file, text).unwrap();
    Config::load(Some(&file)).unwrap_or_else(|error| panic!("{place}: {error}"));
}

#[test]
fn toml_blocks_are_files_of_the_program() {
    let mut found = 0;
    for page in docs().into_iter().chain([root().join("README.md")]) {
        for Block {
            line,
            language,
            text,
        } in blocks(&read(&page))
        {
            if language != "toml" {
                continue;
            }
            let place = format!("{}:{line}", name(&page));
            let table: toml::Table = text
                .parse()
                .unwrap_or_else(|error| panic!("{place}: {error}"));
            match table {
                table if table.contains_key("source") => open(&place, &text),
                table if table.contains_key("variants") => parse_study(&place, &text),
                _ => parse_settings(&place, &text),
            }
            found += 1;
        }
    }
    assert!(found >= 5, "{found} blocks");
}

#[test]
fn json_blocks_are_json() {
    for page in docs().into_iter().chain([root().join("README.md")]) {
        for Block { line, text, .. } in blocks(&read(&page))
            .into_iter()
            .filter(|block| block.language == "json")
        {
            let parsed = serde_json::from_str::<serde_json::Value>(&text);
            assert!(parsed.is_ok(), "{}:{line}: {parsed:?}", name(&page));
        }
    }
}
