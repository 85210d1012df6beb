//! The cache of the `huggingface_hub` tools: refs, and snapshots that may be links or copies.

use super::files::listed;
use super::{HubFiles, HubName, HubPlace};
use std::path::{Path, PathBuf};

/// Digits of a commit.
const COMMIT_DIGITS: usize = 40;
/// Fewest digits that abbreviate a commit, as the hub takes them.
const MIN_COMMIT_DIGITS: usize = 5;
/// Largest file of a ref, bytes.
const MAX_REF_BYTES: u64 = 4096;
/// The revision that is meant where none is named.
pub(super) const MAIN: &str = "main";

/// What is not in the cache.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NotCached {
    pub file: String,
    /// What is there instead, and what to do.
    pub hint: Option<String>,
}

/// Whether a revision is a whole commit, which never changes.
pub(super) fn is_commit(revision: &str) -> bool {
    revision.len() == COMMIT_DIGITS && is_hexadecimal(revision)
}

fn is_hexadecimal(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The folder of a repository in a cache.
fn folder(cache: &Path, name: &HubName) -> PathBuf {
    cache.join(format!("models--{}", name.id.replace('/', "--")))
}

/// Whether a cache has a snapshot of a repository, complete or not.
pub(super) fn has(cache: &Path, name: &HubName) -> bool {
    !snapshots(&folder(cache, name)).is_empty()
}

/// The snapshot of a repository that has all wanted files.
pub(super) fn find(cache: &Path, name: &HubName, files: &HubFiles) -> Result<HubPlace, NotCached> {
    let repository = folder(cache, name);
    let revision = name.revision.as_deref().unwrap_or(MAIN);
    let candidates = snapshots_of(&repository, revision);
    let place = |folder: &PathBuf| match files.missing(name, folder) {
        None => Ok(HubPlace::in_folder(folder.clone(), name, files)),
        Some(file) => Err(file),
    };
    let mut complete = candidates.iter().filter_map(|folder| place(folder).ok());
    // Several complete snapshots may be of any revisions: none of them is chosen.
    match (complete.next(), complete.next()) {
        (Some(one), None) => return Ok(one),
        (Some(_), Some(_)) => {
            return Err(NotCached {
                file: format!("a ref of revision {revision}"),
                hint: Some(format!(
                    "the cache has several revisions; name one of them: {}",
                    words(
                        name,
                        candidates.iter().filter(|folder| place(folder).is_ok())
                    )
                )),
            });
        }
        (None, _) => {}
    }
    let file = match candidates.first() {
        Some(folder) => files.missing(name, folder),
        None => files.missing(name, &repository.join("snapshots").join(revision)),
    };
    let others = snapshots(&repository);
    let mut others = others
        .iter()
        .filter(|folder| place(folder).is_ok())
        .peekable();
    let hint = if others.peek().is_some() {
        Some(format!(
            "the cache has other revisions, which need no download: {}",
            words(name, others)
        ))
    } else {
        is_interrupted(&repository).then(|| "an interrupted download is in the cache".to_owned())
    };
    let file = file.unwrap_or_else(|| "a complete snapshot".to_owned());
    Err(NotCached { file, hint })
}

/// The files of the snapshots of a revision, whether or not they are complete.
pub(super) fn files(cache: &Path, name: &HubName) -> Vec<String> {
    let repository = folder(cache, name);
    let revision = name.revision.as_deref().unwrap_or(MAIN);
    let folders = snapshots_of(&repository, revision);
    folders.iter().flat_map(|folder| listed(folder)).collect()
}

/// The snapshot in a repository's own folder of a cache (`models--org--name`), if a user names that
/// folder; `None` for other folders.
pub(in crate::registry) fn snapshot_in(folder: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(folder).ok()?;
    let named = absolute.file_name()?.to_str()?.starts_with("models--");
    if !named || folder.join("config.json").exists() {
        return None;
    }
    match snapshots_of(folder, MAIN).as_slice() {
        [one] => Some(one.clone()),
        _ => None,
    }
}

/// The snapshots that a revision may mean: that of its ref, else of its commit or the beginning of
/// one; for the default revision without a ref, those that no other ref names.
fn snapshots_of(repository: &Path, revision: &str) -> Vec<PathBuf> {
    let snapshot = |commit: &str| repository.join("snapshots").join(commit);
    // A revision becomes a part of a path, and must not lead out of the cache.
    if !is_plain(revision) {
        return Vec::new();
    }
    if let Some(commit) = read_ref(&repository.join("refs").join(revision)) {
        return vec![snapshot(&commit)];
    }
    if snapshot(revision).is_dir() {
        return vec![snapshot(revision)];
    }
    let all = snapshots(repository);
    let commit_of = |folder: &PathBuf| {
        folder
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    if revision == MAIN {
        let named = refs(&repository.join("refs"));
        return all
            .into_iter()
            .filter(|folder| !named.contains(&commit_of(folder)))
            .collect();
    }
    if (MIN_COMMIT_DIGITS..COMMIT_DIGITS).contains(&revision.len()) && is_hexadecimal(revision) {
        let revision = revision.to_ascii_lowercase();
        return all
            .into_iter()
            .filter(|folder| commit_of(folder).starts_with(&revision))
            .collect();
    }
    Vec::new()
}

/// Whether a revision stays inside its folder.
fn is_plain(revision: &str) -> bool {
    let part = |part: &str| !part.is_empty() && !part.starts_with('.');
    !revision.contains('\\') && revision.split('/').all(part)
}

/// The commit of a ref.
fn read_ref(file: &Path) -> Option<String> {
    let text = planagent_files::read_text(file, MAX_REF_BYTES).ok()?;
    let commit = text.trim();
    (!commit.is_empty() && is_hexadecimal(commit)).then(|| commit.to_owned())
}

/// The commits that refs name.
fn refs(folder: &Path) -> Vec<String> {
    listed(folder)
        .iter()
        .filter_map(|name| read_ref(&folder.join(name)))
        .collect()
}

/// All snapshots, sorted.
fn snapshots(repository: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(repository.join("snapshots"));
    let folders = entries.into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = folders
        .map(|entry| entry.path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    folders
}

fn words<'a>(name: &HubName, folders: impl Iterator<Item = &'a PathBuf>) -> String {
    let words: Vec<String> = folders
        .filter_map(|folder| folder.file_name())
        .map(|commit| {
            let revision = Some(commit.to_string_lossy().into_owned());
            HubName {
                revision,
                ..name.clone()
            }
            .word()
        })
        .collect();
    words.join(", ")
}

/// Whether a file of the cache has begun and not ended.
fn is_interrupted(repository: &Path) -> bool {
    let entries = std::fs::read_dir(repository.join("blobs"));
    entries.into_iter().flatten().flatten().any(|entry| {
        Path::new(&entry.file_name())
            .extension()
            .is_some_and(|extension| extension == "incomplete")
    })
}
