//! Models of the Hugging Face hub, through the cache that the `huggingface_hub` tools share.

use std::path::{Path, PathBuf};

use hf_hub::HFClientSync;

use crate::mllm::MllmError;

/// Either of these holds the weights, or says which files do.
const WEIGHTS: [&str; 2] = ["model.safetensors", "model.safetensors.index.json"];

/// What of a repository is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HubFiles {
    /// Everything that a model is opened from.
    Model,
    /// The same, of a repository that has no tokenizer.
    ModelWithoutTokenizer,
    /// The tokenizer alone.
    Tokenizer,
}

impl HubFiles {
    /// The files that are downloaded, if they are there.
    fn patterns(self) -> &'static [&'static str] {
        match self {
            Self::Model | Self::ModelWithoutTokenizer => &["*.json", "*.jinja", "*.safetensors"],
            Self::Tokenizer => &["tokenizer.json", "tokenizer_config.json"],
        }
    }

    /// The files without which a snapshot is taken for incomplete.
    fn required(self) -> &'static [&'static str] {
        match self {
            Self::Model => &["config.json", "tokenizer.json"],
            Self::ModelWithoutTokenizer => &["config.json"],
            Self::Tokenizer => &["tokenizer.json"],
        }
    }
}

/// How the hub may be used.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HubAccess {
    /// Whether to take what is in the cache only.
    pub offline: bool,
    /// The cache folder; none for the usual one (`HF_HUB_CACHE`, `HF_HOME`, `~/.cache/huggingface/hub`).
    pub cache: Option<PathBuf>,
    /// The hub's address; none for the usual one (`HF_ENDPOINT`, <https://huggingface.co>).
    pub endpoint: Option<String>,
}

impl HubAccess {
    /// The folder with the files of a repository, downloaded if need be and allowed.
    ///
    /// # Errors
    /// When the id is no id, the hub refuses, or (offline) a file is not in the cache.
    pub fn fetch(&self, id: &str, revision: &str, files: HubFiles) -> Result<PathBuf, MllmError> {
        let failed = |problem: String| MllmError::Hub { id: id.to_string(), revision: revision.to_string(), problem };
        let (owner, name) = split_id(id).ok_or_else(|| failed("a hub id is written organisation/name".into()))?;
        let mut builder = hf_hub::HFClient::builder();
        if let Some(cache) = &self.cache {
            builder = builder.cache_dir(cache.clone());
        }
        if let Some(endpoint) = &self.endpoint {
            builder = builder.endpoint(endpoint.clone());
        }
        let client = builder.build().map_err(|error| failed(error.to_string()))?;
        let cache = client.cache_dir().to_path_buf();
        let client = HFClientSync::from_inner(client).map_err(|error| failed(error.to_string()))?;
        let repository = client.model(owner, name);
        let snapshot = |local_only: bool| {
            repository
                .snapshot_download()
                .revision(revision.to_string())
                .allow_patterns(files.patterns().iter().map(ToString::to_string).collect::<Vec<_>>())
                .local_files_only(local_only)
                .send()
        };
        // A commit never changes, so a complete snapshot of it needs no network.
        let pinned = revision.len() == 40 && revision.bytes().all(|byte| byte.is_ascii_hexdigit());
        if self.offline || pinned {
            let missing = match snapshot(true) {
                Ok(folder) => match missing_file(&folder, files) {
                    None => return Ok(folder),
                    Some(file) => file,
                },
                Err(_) => files.required().first().map(ToString::to_string).unwrap_or_default(),
            };
            if self.offline {
                return Err(MllmError::NotInCache {
                    id: id.to_string(),
                    revision: revision.to_string(),
                    file: missing,
                    cache,
                });
            }
        }
        let folder = snapshot(false).map_err(|error| failed(error.to_string()))?;
        match missing_file(&folder, files) {
            None => Ok(folder),
            Some(file) => Err(failed(format!("the repository has no {file}"))),
        }
    }
}

/// Splits `organisation/name`; none if it cannot be an id.
pub(super) fn split_id(id: &str) -> Option<(&str, &str)> {
    let valid = |part: &str| {
        !part.is_empty()
            && !part.starts_with(['.', '-'])
            && part.chars().all(|character| character.is_ascii_alphanumeric() || ".-_".contains(character))
    };
    id.split_once('/').filter(|(owner, name)| valid(owner) && valid(name))
}

/// What an incomplete snapshot lacks: a required file, or a weight file that its index names.
fn missing_file(folder: &Path, files: HubFiles) -> Option<String> {
    if let Some(file) = files.required().iter().find(|file| !folder.join(file).is_file()) {
        return Some((*file).to_string());
    }
    if files == HubFiles::Tokenizer {
        return None;
    }
    let [whole, index] = WEIGHTS;
    if folder.join(whole).is_file() {
        return None;
    }
    let Ok(text) = std::fs::read_to_string(folder.join(index)) else {
        return Some(whole.to_string());
    };
    let index: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    index["weight_map"]
        .as_object()?
        .values()
        .filter_map(|file| file.as_str())
        .find(|file| !folder.join(file).is_file())
        .map(ToString::to_string)
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";

    fn cached(files: &[&str]) -> (tempfile::TempDir, HubAccess) {
        let cache = tempfile::tempdir().unwrap();
        let repository = cache.path().join("models--org--model");
        let snapshot = repository.join("snapshots").join(COMMIT);
        std::fs::create_dir_all(&snapshot).unwrap();
        std::fs::create_dir_all(repository.join("refs")).unwrap();
        std::fs::write(repository.join("refs/main"), COMMIT).unwrap();
        for file in files {
            std::fs::write(snapshot.join(file), "{}").unwrap();
        }
        let access = HubAccess {
            offline: true,
            cache: Some(cache.path().to_path_buf()),
            // Discard port: whoever asks the network gets an error at once.
            endpoint: Some("http://127.0.0.1:9".into()),
        };
        (cache, access)
    }

    #[test]
    fn a_cached_model_is_found_without_network() {
        let (_cache, access) = cached(&["config.json", "tokenizer.json", "model.safetensors"]);
        for revision in ["main", COMMIT] {
            assert!(access.fetch("org/model", revision, HubFiles::Model).unwrap().ends_with(COMMIT));
        }
        let online = HubAccess { offline: false, ..access };
        assert!(online.fetch("org/model", COMMIT, HubFiles::Model).is_ok(), "a pinned commit needs no network");
    }

    #[test]
    fn a_model_and_its_tokenizer_may_lie_apart() {
        let (_cache, weights) = cached(&["config.json", "model.safetensors"]);
        assert!(weights.fetch("org/model", "main", HubFiles::ModelWithoutTokenizer).is_ok());
        let missing = weights.fetch("org/model", "main", HubFiles::Tokenizer);
        assert!(matches!(missing, Err(MllmError::NotInCache { file, .. }) if file == "tokenizer.json"));
        let (_cache, tokenizer) = cached(&["tokenizer.json"]);
        assert!(tokenizer.fetch("org/model", "main", HubFiles::Tokenizer).is_ok());
    }

    #[test]
    fn what_is_not_cached_is_named() {
        let (_cache, access) = cached(&["config.json", "tokenizer.json"]);
        for (id, revision, missing) in [
            ("org/model", "main", "model.safetensors"),
            ("org/model", "v2", "config.json"),
            ("org/other", "main", "config.json"),
        ] {
            match access.fetch(id, revision, HubFiles::Model) {
                Err(MllmError::NotInCache { file, .. }) => assert_eq!(file, missing),
                other => panic!("{id}: {other:?}"),
            }
        }
        assert!(matches!(access.fetch("../x/y", "main", HubFiles::Model), Err(MllmError::Hub { .. })));
    }
}
