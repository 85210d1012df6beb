//! What tests need from outside the package, and a loud word where it is missing.

use std::fmt::Display;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file or folder of the data folder: `$PLANAGENT_DATA`, else `../shared/data`. Says so when it is missing.
pub(crate) fn data(path: &str) -> Option<PathBuf> {
    // A crate's folder lies below the repository's.
    let beside = || {
        let folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|folder| folder.join("../shared/data"));
        folders.clone().find(|folder| folder.exists()).or_else(|| folders.last()).unwrap_or_default()
    };
    let root = std::env::var_os("PLANAGENT_DATA").map_or_else(beside, PathBuf::from);
    let found = root.join(path);
    if found.exists() {
        return Some(found);
    }
    skipped(format!("no {} (PLANAGENT_DATA may name the data folder)", found.display()));
    None
}

/// Says what is not tested. `eprintln` would not do: the harness hides what a test prints when it passes.
pub(crate) fn skipped(what: impl Display) {
    // A test does not fail for a closed stderr.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}");
}
