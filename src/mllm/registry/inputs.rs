//! Digests of what determines a model's answers besides its weights.

use super::{ModelRegistry, ModelSource, ModelSpec};
use crate::adapter::Adapter;
use crate::trial::{hash_file, small_files};
use crate::{AdapterSpec, MllmError, ModelPlace};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Fields of a server's description that determine how long a request may take, and no answer.
const WITHOUT_EFFECT: [&str; 6] = [
    "key_env",
    "stream",
    "connect_timeout_ms",
    "timeout_ms",
    "retries",
    "first_wait_ms",
];

/// BLAKE3 digests, hexadecimal.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ModelInputs {
    /// Of the small files, by path: configurations, tokenizer, chat template.
    pub files: BTreeMap<String, String>,
    /// Of the values of the description, by key; those of a server begin with `server.`.
    pub description: BTreeMap<String, String>,
}

impl ModelRegistry {
    /// Digests of a model's small files on this machine, and of its description.
    pub fn inputs(&self, spec: &ModelSpec) -> Result<ModelInputs, MllmError> {
        let description = description(spec);
        // A server's files are out of reach; its description is all that can be compared.
        if matches!(spec.source, ModelSource::Endpoint(_)) {
            return Ok(ModelInputs {
                files: BTreeMap::new(),
                description,
            });
        }
        let mut files = BTreeMap::new();
        match self.place_here(spec)? {
            ModelPlace::Embedded(model) => {
                let digest = |&(name, text): &(&str, &str)| {
                    (
                        format!("{}/{name} (in the program)", model.name),
                        digest(text.as_bytes()),
                    )
                };
                files.extend(model.texts().iter().map(digest));
            }
            ModelPlace::Random { .. } => {}
            ModelPlace::Folder(folder) => add(&folder, &mut files)?,
            ModelPlace::Gguf { model, .. } | ModelPlace::Decoder(model) => {
                add(folder_of(&model), &mut files)?;
            }
        }
        let loading = self.loading(spec)?;
        if let Some(folder) = loading.tokenizer {
            add(&folder, &mut files)?;
        }
        let mut description = description;
        if let Some(adapter) = &loading.adapter {
            description.insert("adapter".to_owned(), adapter_digest(adapter)?);
        }
        Ok(ModelInputs { files, description })
    }
}

/// The digest of an adapter's files. The path is no part of it, so that a folder can be moved.
fn adapter_digest(spec: &AdapterSpec) -> Result<String, MllmError> {
    let mut hasher = blake3::Hasher::new();
    Adapter::open(spec)?.hash(&mut hasher)?;
    Ok(hasher.finalize().to_hex().to_string())
}

fn folder_of(file: &Path) -> &Path {
    file.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Adds the small files of a folder.
fn add(folder: &Path, files: &mut BTreeMap<String, String>) -> Result<(), MllmError> {
    for path in small_files(folder)? {
        let mut hasher = blake3::Hasher::new();
        hash_file(&path, &mut hasher)?;
        let shown: PathBuf = std::path::absolute(&path).unwrap_or(path);
        files.insert(
            shown.display().to_string(),
            hasher.finalize().to_hex().to_string(),
        );
    }
    Ok(())
}

fn description(spec: &ModelSpec) -> BTreeMap<String, String> {
    let mut values = BTreeMap::from([
        ("generation".to_owned(), digest_of(&spec.generation)),
        ("prompt_set".to_owned(), digest_of(&spec.prompt_set)),
    ]);
    if spec.quantize.is_some() {
        values.insert("quantize".to_owned(), digest_of(&spec.quantize));
    }
    if !spec.image.is_default() {
        values.insert("image".to_owned(), digest_of(&spec.image));
    }
    if !spec.vision {
        values.insert("vision".to_owned(), digest_of(&spec.vision));
    }
    if let ModelSource::Endpoint(settings) = &spec.source
        && let Ok(Value::Object(fields)) = serde_json::to_value(settings)
    {
        let with_effect = fields
            .iter()
            .filter(|(field, _)| !WITHOUT_EFFECT.contains(&field.as_str()));
        // A digest of `extra`, which may hold what nobody else should read.
        values.extend(
            with_effect.map(|(field, value)| (format!("server.{field}"), digest_of(value))),
        );
    }
    values
}

fn digest_of(value: &impl Serialize) -> String {
    digest(
        serde_json::to_string(value)
            .expect("settings can be written as JSON")
            .as_bytes(),
    )
}

fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}
