//! The client of the hub: fills the cache.

use super::environment::Environment;
use super::files::offered;
use super::name::split_id;
use super::problem::{in_words, is_about_the_revision};
use super::{FetchListener, FetchProgress, HubFiles, HubName, HubPlace, cache};
use hf_hub::progress::{DownloadEvent, Progress, ProgressEvent, ProgressHandler};
use hf_hub::repository::RepoTreeEntry;
use hf_hub::{HFClientSync, HFError};
use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Attempts of a request where the cache has all files.
const ATTEMPTS_WITH_CACHE: usize = 2;
/// Attempts of a request that nothing replaces.
const ATTEMPTS: usize = 5;

/// Hubs that could not be reached, and repositories that they refused. While the cache has all
/// files, they are not asked again.
static UNREACHABLE: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

/// Downloads the missing files of a repository; an interrupted file starts from its beginning.
/// Where the hub cannot be reached and the cache has all files, these are taken, as
/// `huggingface_hub` does. The error is in words.
pub(super) fn download(
    name: &HubName,
    files: &HubFiles,
    cache: &Path,
    endpoint: &str,
    listener: Option<Arc<FetchListener>>,
) -> Result<HubPlace, String> {
    let cached = cache::find(cache, name, files).ok();
    let unreachable = || UNREACHABLE.lock().unwrap_or_else(PoisonError::into_inner);
    let repository = format!("{endpoint}/{}", name.id);
    if let Some(place) = &cached
        && [endpoint, &repository]
            .iter()
            .any(|place| unreachable().contains(*place))
    {
        return Ok(place.clone());
    }
    let attempts = if cached.is_some() {
        ATTEMPTS_WITH_CACHE
    } else {
        ATTEMPTS
    };
    match ask(name, files, cache, endpoint, attempts, listener) {
        Ok(place) => Ok(place),
        Err(Failure::Repository(problem)) => Err(problem),
        Err(Failure::Hub(error)) => match cached {
            Some(place) if !is_about_the_revision(&error, name) => {
                let refused = if matches!(*error, HFError::Request { .. }) {
                    endpoint.to_owned()
                } else {
                    repository
                };
                // Asked once a process: every model of a run would wait for the same silent hub.
                unreachable().insert(refused);
                Ok(place)
            }
            _ => Err(in_words(&error, name, endpoint)),
        },
    }
}

/// Why nothing was downloaded.
enum Failure {
    /// The hub gave no answer, or refused.
    Hub(Box<HFError>),
    /// The repository has no such files.
    Repository(String),
}

impl From<HFError> for Failure {
    fn from(error: HFError) -> Self {
        Self::Hub(Box::new(error))
    }
}

fn ask(
    name: &HubName,
    files: &HubFiles,
    cache: &Path,
    endpoint: &str,
    attempts: usize,
    listener: Option<Arc<FetchListener>>,
) -> Result<HubPlace, Failure> {
    let client = client(cache, endpoint, attempts)?;
    let (owner, repository) = split_id(&name.id).expect("the id was checked before the download");
    let repository = client.model(owner, repository);
    let revision = name.revision.as_deref().unwrap_or(cache::MAIN);
    let list = || -> Result<Vec<String>, HFError> {
        let entries = repository
            .list_tree()
            .revision(revision.to_string())
            .recursive(true)
            .send()?;
        Ok(entries
            .into_iter()
            .filter_map(|entry| match entry {
                RepoTreeEntry::File { path, .. } => Some(path),
                RepoTreeEntry::Directory { .. } => None,
            })
            .collect())
    };
    // A listing is a request of its own, and only names of GGUF files need it.
    let listed = if matches!(files, HubFiles::Gguf { .. }) {
        list()?
    } else {
        Vec::new()
    };
    let patterns = files.patterns(name, &listed).map_err(Failure::Repository)?;
    let progress = listener.map(|listener| {
        Progress::new(Told {
            listener,
            state: Mutex::default(),
        })
    });
    let folder = repository
        .snapshot_download()
        .revision(revision.to_string())
        .allow_patterns(patterns)
        .maybe_progress(progress)
        .send()?;
    let Some(file) = files.missing(name, &folder) else {
        return Ok(HubPlace::in_folder(folder, name, files));
    };
    let hint = match list() {
        Ok(listed) => offered(name, &listed).or_else(|| unread(&listed)),
        Err(_) => None,
    };
    let hint = hint.map_or(String::new(), |hint| format!("; {hint}"));
    Err(Failure::Repository(format!(
        "the repository has no {file}{hint}"
    )))
}

fn client(cache: &Path, endpoint: &str, attempts: usize) -> Result<HFClientSync, HFError> {
    let environment = Environment::of_process();
    let [connect, read] = environment.waits_s().map(Duration::from_secs);
    let http = reqwest::Client::builder()
        .user_agent(concat!("planagent/", env!("CARGO_PKG_VERSION")))
        .connect_timeout(connect)
        .read_timeout(read)
        .build()?;
    let mut builder = hf_hub::HFClient::builder()
        .cache_dir(cache)
        .endpoint(endpoint)
        .client(http)
        .retry_max_attempts(attempts);
    if let Some(token) = environment.token() {
        builder = builder.token(token);
    }
    HFClientSync::from_inner(builder.build()?)
}

/// Weights of a repository in a form that is not read.
fn unread(listed: &[String]) -> Option<String> {
    let is_weights = |file: &&String| {
        Path::new(file).extension().is_some_and(|extension| {
            ["bin", "pth", "pt", "ckpt", "onnx", "h5", "msgpack"]
                .iter()
                .any(|known| extension.eq_ignore_ascii_case(known))
        })
    };
    listed
        .iter()
        .find(is_weights)
        .map(|file| format!("{file} is not read: take a repository with safetensors"))
}

/// Sums the progress of all files.
struct Told {
    listener: Arc<FetchListener>,
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
