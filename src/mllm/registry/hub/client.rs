//! The client of the hub: fills the cache and finds what is in it.

use super::{FetchListener, FetchProgress, HubAccess, HubFiles, split_id};
use crate::MllmError;
use hf_hub::HFClientSync;
use hf_hub::progress::{DownloadEvent, Progress, ProgressEvent, ProgressHandler};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

impl HubAccess {
    /// The folder with the files of a repository. Missing files are downloaded, if this is allowed;
    /// an interrupted file starts from its beginning.
    pub(in crate::registry) fn fetch(
        &self,
        id: &str,
        revision: &str,
        files: &HubFiles,
        listener: Option<std::sync::Arc<FetchListener>>,
    ) -> Result<PathBuf, MllmError> {
        let failed = |problem: String| MllmError::Hub {
            id: id.to_string(),
            revision: revision.to_string(),
            problem,
        };
        let (owner, name) =
            split_id(id).ok_or_else(|| failed("a hub id has the form organization/name".into()))?;
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
        let progress = listener.map(|listener| {
            Progress::new(Told {
                listener,
                state: Mutex::default(),
            })
        });
        let snapshot = |local_only: bool| {
            repository
                .snapshot_download()
                .revision(revision.to_string())
                .allow_patterns(files.patterns.clone())
                .local_files_only(local_only)
                .maybe_progress(progress.clone())
                .send()
        };
        // A commit never changes, so a complete snapshot of it needs no network.
        let pinned = revision.len() == 40 && revision.bytes().all(|byte| byte.is_ascii_hexdigit());
        if self.offline || pinned {
            let missing = match snapshot(true) {
                Ok(folder) => match files.missing(&folder) {
                    None => return Ok(folder),
                    Some(file) => file,
                },
                Err(_) => files
                    .required
                    .first()
                    .cloned()
                    .expect("every choice of files requires one"),
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
        match files.missing(&folder) {
            None => Ok(folder),
            Some(file) => Err(failed(format!("the repository has no {file}"))),
        }
    }
}

/// Sums the progress of all files.
struct Told {
    listener: std::sync::Arc<FetchListener>,
    state: Mutex<DownloadState>,
}

#[derive(Default)]
struct DownloadState {
    total: u64,
    files: HashMap<String, u64>,
    /// Bytes of files that come from the hub's chunk store, reported for all of them at once.
    pieces: u64,
}

impl ProgressHandler for Told {
    fn on_progress(&self, event: &ProgressEvent) {
        let ProgressEvent::Download(event) = event else {
            return;
        };
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            DownloadEvent::Start { total_bytes, .. } => state.total = state.total.max(*total_bytes),
            DownloadEvent::Progress { files } => {
                for file in files {
                    state
                        .files
                        .insert(file.filename.clone(), file.bytes_completed);
                }
            }
            DownloadEvent::AggregateProgress {
                bytes_completed, ..
            } => state.pieces = *bytes_completed,
            DownloadEvent::Complete => {}
        }
        let arrived = state.files.values().sum::<u64>().max(state.pieces);
        (self.listener)(FetchProgress {
            bytes: arrived.min(state.total),
            total: state.total,
        });
    }
}
