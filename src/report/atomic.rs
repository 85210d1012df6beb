//! Files that are there whole or not at all.

use super::error::ReportError;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Beginning of the names of what is not finished. Whatever bears it after a kill is worthless.
pub(super) const UNFINISHED: &str = ".unfinished-";

/// Where something is written before it gets its name: beside it.
pub(super) fn unfinished(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{UNFINISHED}{name}"))
}

/// Writes a file under another name and then gives it its own.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let temporary = unfinished(path);
    create(&temporary, bytes)?;
    fs::rename(&temporary, path).map_err(ReportError::write(path))
}

/// Writes a file and waits until it lies on the disk.
pub(super) fn create(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let written = fs::File::create(path).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_data()
    });
    written.map_err(ReportError::write(path))
}

/// Makes a folder and those above it.
pub(super) fn folder(path: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(path).map_err(ReportError::write(path))
}

/// Removes what a killed process left unfinished in a folder.
pub(super) fn sweep(folder: &Path) -> Result<(), ReportError> {
    for entry in fs::read_dir(folder).map_err(ReportError::read(folder))? {
        let path = entry.map_err(ReportError::read(folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with(UNFINISHED) {
            let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            removed.map_err(ReportError::write(&path))?;
        }
    }
    Ok(())
}
