//! Downloads from the Hugging Face hub into the cache of the `huggingface_hub` tools.

#[cfg(feature = "hub")]
mod client;

use crate::MllmError;
use crate::checkpoint::safetensors_folder::{has_safetensors, weight_files};
use crate::gguf::named_parts;
use std::path::{Path, PathBuf};

/// The wanted part of a repository.
#[derive(Debug, Clone)]
pub(super) struct HubFiles {
    /// Patterns of the files to download, where they exist.
    patterns: Vec<String>,
    /// The files that a complete snapshot must have.
    required: Vec<String>,
    /// Whether a complete snapshot has safetensors.
    weights: bool,
}

impl HubFiles {
    /// A model, without its tokenizer if that is elsewhere.
    pub(super) fn model(tokenizer: bool) -> Self {
        let required = if tokenizer {
            &["config.json", "tokenizer.json"][..]
        } else {
            &["config.json"]
        };
        Self {
            patterns: owned(&["*.json", "*.jinja", "*.safetensors"]),
            required: owned(required),
            weights: true,
        }
    }

    /// A tokenizer alone.
    pub(super) fn tokenizer() -> Self {
        Self {
            patterns: owned(&["tokenizer.json", "tokenizer_config.json"]),
            required: owned(&["tokenizer.json"]),
            weights: false,
        }
    }

    /// A GGUF file with its vision tower; without a name, all towers of the repository.
    pub(super) fn gguf(file: &str, mmproj: Option<&str>) -> Self {
        let tower = mmproj.unwrap_or("*mmproj*.gguf");
        let parts = named_parts(file);
        let patterns = owned(&[
            "tokenizer.json",
            "tokenizer_config.json",
            "chat_template.jinja",
            tower,
        ]);
        Self {
            patterns: patterns.into_iter().chain(parts.clone()).collect(),
            required: parts
                .into_iter()
                .chain(mmproj.map(ToString::to_string))
                .collect(),
            weights: false,
        }
    }

    /// A file that a snapshot lacks: a required one, or a weight file of its index.
    fn missing(&self, folder: &Path) -> Option<String> {
        if let Some(file) = self
            .required
            .iter()
            .find(|file| !folder.join(file).is_file())
        {
            return Some(file.clone());
        }
        if !self.weights {
            return None;
        }
        if !has_safetensors(folder) {
            return Some("model.safetensors".into());
        }
        match weight_files(folder) {
            Err(MllmError::MissingFile { file, .. }) => Some(file),
            _ => None,
        }
    }
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(ToString::to_string).collect()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FetchProgress {
    /// Bytes so far.
    pub bytes: u64,
    /// Bytes of all files.
    pub total: u64,
}

pub type FetchListener = dyn Fn(FetchProgress) + Send + Sync;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HubAccess {
    /// Whether to use the cache alone.
    pub offline: bool,
    /// The cache folder; none for the default (`HF_HUB_CACHE`, `HF_HOME`,
    /// `~/.cache/huggingface/hub`).
    pub cache: Option<PathBuf>,
    /// The hub's address; none for the default (`HF_ENDPOINT`, <https://huggingface.co>).
    pub endpoint: Option<String>,
}

#[cfg(not(feature = "hub"))]
impl HubAccess {
    /// Refuses: this build has no hub client.
    pub(super) fn fetch(
        &self,
        id: &str,
        revision: &str,
        _: &HubFiles,
        _: Option<std::sync::Arc<FetchListener>>,
    ) -> Result<PathBuf, MllmError> {
        let problem =
            "this build has no hub client; build with the cargo feature `hub`, or name a folder"
                .to_string();
        Err(MllmError::Hub {
            id: id.to_string(),
            revision: revision.to_string(),
            problem,
        })
    }
}

/// Whether a path names a GGUF file.
pub(super) fn is_gguf(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gguf"))
}

/// Splits `organization/name` or `organization/name/file.gguf` into id and file.
pub(super) fn split_file(name: &str) -> Option<(&str, Option<&str>)> {
    if split_id(name).is_some() {
        // A name with the extension of a file means a file that does not exist.
        return (!is_gguf(Path::new(name))).then_some((name, None));
    }
    let (end, _) = name.match_indices('/').nth(1)?;
    let (id, file) = (name.get(..end)?, name.get(end + 1..)?);
    let plain = file
        .split('/')
        .all(|part| !part.is_empty() && !part.starts_with('.'));
    (split_id(id).is_some() && plain && is_gguf(Path::new(file))).then_some((id, Some(file)))
}

/// Splits `organization/name`.
pub(super) fn split_id(id: &str) -> Option<(&str, &str)> {
    let valid = |part: &str| {
        !part.is_empty()
            && !part.starts_with(['.', '-'])
            && part
                .chars()
                .all(|character| character.is_ascii_alphanumeric() || ".-_".contains(character))
    };
    id.split_once('/')
        .filter(|(owner, name)| valid(owner) && valid(name))
}

#[cfg(test)]
#[cfg(feature = "hub")]
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
            // Discard port: any network access fails at once.
            endpoint: Some("http://127.0.0.1:9".into()),
        };
        (cache, access)
    }

    #[test]
    fn a_cached_model_is_found_without_network() {
        let (_cache, access) = cached(&["config.json", "tokenizer.json", "model.safetensors"]);
        for revision in ["main", COMMIT] {
            assert!(
                access
                    .fetch("org/model", revision, &HubFiles::model(true), None)
                    .unwrap()
                    .ends_with(COMMIT)
            );
        }
        let online = HubAccess {
            offline: false,
            ..access
        };
        assert!(
            online
                .fetch("org/model", COMMIT, &HubFiles::model(true), None)
                .is_ok(),
            "a pinned commit needs no network"
        );
    }

    #[test]
    fn a_model_and_its_tokenizer_may_lie_apart() {
        let (_cache, weights) = cached(&["config.json", "model.safetensors"]);
        assert!(
            weights
                .fetch("org/model", "main", &HubFiles::model(false), None)
                .is_ok()
        );
        let missing = weights.fetch("org/model", "main", &HubFiles::tokenizer(), None);
        assert!(
            matches!(missing, Err(MllmError::NotInCache { file, .. }) if file == "tokenizer.json")
        );
        let (_cache, tokenizer) = cached(&["tokenizer.json"]);
        assert!(
            tokenizer
                .fetch("org/model", "main", &HubFiles::tokenizer(), None)
                .is_ok()
        );
    }

    #[test]
    fn gguf_files_are_asked_for_by_name() {
        let (_cache, access) = cached(&["model-q4_k.gguf", "mmproj.gguf"]);
        let files = |mmproj: Option<&str>| HubFiles::gguf("model-q4_k.gguf", mmproj);
        assert!(
            access
                .fetch("org/model", "main", &files(None), None)
                .is_ok()
        );
        assert!(
            access
                .fetch("org/model", "main", &files(Some("mmproj.gguf")), None)
                .is_ok()
        );
        let missing = access.fetch("org/model", "main", &files(Some("mmproj-f16.gguf")), None);
        assert!(
            matches!(missing, Err(MllmError::NotInCache { file, .. }) if file == "mmproj-f16.gguf")
        );
    }

    #[test]
    fn what_is_not_cached_is_named() {
        let (_cache, access) = cached(&["config.json", "tokenizer.json"]);
        for (id, revision, missing) in [
            ("org/model", "main", "model.safetensors"),
            ("org/model", "v2", "config.json"),
            ("org/other", "main", "config.json"),
        ] {
            match access.fetch(id, revision, &HubFiles::model(true), None) {
                Err(MllmError::NotInCache { file, .. }) => assert_eq!(file, missing),
                other => panic!("{id}: {other:?}"),
            }
        }
        assert!(matches!(
            access.fetch("../x/y", "main", &HubFiles::model(true), None),
            Err(MllmError::Hub { .. })
        ));
    }
}
