//! The verdicts of trials, kept for the next start: an empty file for each content that passed.
//!
//! A failed trial is repeated, because a machine under load may have been too slow.

use std::fs;
use std::path::{Path, PathBuf};

/// The folder of the verdicts.
pub(super) struct Verdicts {
    folder: PathBuf,
}

impl Verdicts {
    pub(super) fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
        }
    }

    fn file(&self, digest: &str) -> PathBuf {
        self.folder.join(format!("{digest}.passed"))
    }

    /// Whether files with this digest passed.
    pub(super) fn passed(&self, digest: &str) -> bool {
        self.file(digest).is_file()
    }

    /// Keeps that files with this digest passed. Where nothing can be written, they are tried
    /// again.
    pub(super) fn keep(&self, digest: &str) {
        let _ = fs::create_dir_all(&self.folder).and_then(|()| fs::write(self.file(digest), ""));
    }
}
