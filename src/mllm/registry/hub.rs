//! The Hugging Face hub: what is in the cache of the `huggingface_hub` tools, and downloads into it.

mod cache;
#[cfg(feature = "hub")]
mod client;
mod environment;
mod files;
mod name;
mod page;
#[cfg(feature = "hub")]
mod problem;

pub(super) use cache::snapshot_in;
pub use environment::offline_variable;
pub(super) use files::{GgufChoice, GgufNames, HubFiles};
pub(super) use name::{HubName, is_gguf, plain};
pub(super) use page::{addressed, without_owner};

use crate::MllmError;
use environment::Environment;
use name::{is_bare, split_id};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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

/// The wanted files of a repository on this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct HubPlace {
    /// The folder of the snapshot.
    pub folder: PathBuf,
    /// The GGUF files in it, if such are wanted.
    pub gguf: Option<GgufNames>,
}

impl HubPlace {
    fn in_folder(folder: PathBuf, name: &HubName, files: &HubFiles) -> Self {
        let gguf = files.chosen(name, &files::listed(&folder)).ok();
        Self { folder, gguf }
    }
}

impl HubAccess {
    /// As the environment says: `HF_HUB_OFFLINE` switches the network off.
    pub fn of_environment() -> Self {
        Self {
            offline: offline_variable().is_some(),
            ..Self::default()
        }
    }

    /// The cache folder.
    fn cache_folder(&self, environment: &Environment<'_>) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| environment.cache())
    }

    /// The repository without an organization that a word names, where the cache has it.
    pub(super) fn cached_without_owner(&self, word: &str) -> Option<HubName> {
        let name = without_owner(word)?;
        let cache = self.cache_folder(&Environment::of_process());
        cache::has(&cache, &name).then_some(name)
    }

    /// The wanted files of a repository. Missing ones are downloaded, if this is allowed. A
    /// repository without an organization is taken from the cache alone.
    pub(super) fn fetch(
        &self,
        name: &HubName,
        files: &HubFiles,
        listener: Option<Arc<FetchListener>>,
    ) -> Result<HubPlace, MllmError> {
        let revision = name.revision.as_deref().unwrap_or(cache::MAIN);
        let failed = |problem: String| MllmError::Hub {
            id: name.id.clone(),
            revision: revision.to_owned(),
            problem,
        };
        let has_owner = split_id(&name.id).is_some();
        if !has_owner && !is_bare(&name.id) {
            return Err(failed("a hub id has the form organization/name".into()));
        }
        let environment = Environment::of_process();
        let cache = self.cache_folder(&environment);
        // A commit never changes, so a complete snapshot of it needs no network.
        if has_owner && !(self.offline || cache::is_commit(revision)) {
            return download(self, name, files, &cache, listener).map_err(failed);
        }
        let absent = match cache::find(&cache, name, files) {
            Ok(place) => return Ok(place),
            Err(absent) => absent,
        };
        if has_owner && !self.offline {
            return download(self, name, files, &cache, listener).map_err(failed);
        }
        // A repository of GGUF files alone needs no download, but another name.
        let offered = files::offered(name, &cache::files(&cache, name));
        if let (Some(offered), HubFiles::Model { .. }) = (&offered, files) {
            return Err(failed(format!(
                "{} is not in the cache; {offered}",
                absent.file
            )));
        }
        let hint = absent.hint.or(offered);
        let download = if has_owner {
            let forbidden = match environment.offline() {
                Some(variable) => format!("where {variable} does not forbid it"),
                None => "without --offline (mllm.offline)".to_owned(),
            };
            format!(
                "`planagent models fetch {}` downloads it, {forbidden}",
                name.word()
            )
        } else {
            format!(
                "to download it, write it with its organization: ORG/{}",
                name.word()
            )
        };
        Err(MllmError::NotInCache {
            id: name.id.clone(),
            revision: revision.into(),
            file: absent.file,
            cache,
            advice: hint
                .into_iter()
                .chain([download])
                .collect::<Vec<_>>()
                .join("; ")
                .into(),
        })
    }
}

/// Downloads what is missing. The error is in words.
#[cfg(feature = "hub")]
fn download(
    access: &HubAccess,
    name: &HubName,
    files: &HubFiles,
    cache: &Path,
    listener: Option<Arc<FetchListener>>,
) -> Result<HubPlace, String> {
    let endpoint = access.endpoint.clone();
    let endpoint = endpoint.unwrap_or_else(|| Environment::of_process().endpoint());
    client::download(name, files, cache, &endpoint, listener)
}

/// Takes what is in the cache: this build has no hub client.
#[cfg(not(feature = "hub"))]
fn download(
    _: &HubAccess,
    name: &HubName,
    files: &HubFiles,
    cache: &Path,
    _: Option<Arc<FetchListener>>,
) -> Result<HubPlace, String> {
    cache::find(cache, name, files).map_err(|absent| {
        format!(
            "{} is not in the cache {}, and this build has no hub client; build with the cargo feature `hub`, or name a folder",
            absent.file,
            cache.display()
        )
    })
}

#[cfg(test)]
mod tests;
