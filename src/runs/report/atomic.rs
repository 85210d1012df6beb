//! Files and folders that are either complete or absent.

use super::error::ReportError;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Prefix of an unfinished file or folder. A process that was killed may leave one; it is safe to
/// delete.
pub(super) const UNFINISHED: &str = ".unfinished-";

/// The temporary path of a file or folder, beside its final one.
pub(super) fn unfinished(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{UNFINISHED}{name}"))
}

/// Writes a file at its temporary path, then renames it.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let temporary = unfinished(path);
    create(&temporary, bytes)?;
    fs::rename(&temporary, path).map_err(ReportError::write(path))
}

/// Writes a file and waits until it is on the disk.
pub(super) fn create(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let written = fs::File::create(path).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_data()
    });
    written.map_err(ReportError::write(path))
}

/// Creates a folder and its parents.
pub fn folder(path: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(path).map_err(ReportError::write(path))
}

/// Deletes unfinished files and folders.
pub(super) fn sweep(folder: &Path) -> Result<(), ReportError> {
    for entry in fs::read_dir(folder).map_err(ReportError::read(folder))? {
        let path = entry.map_err(ReportError::read(folder))?.path();
        let name = path
            .file_name()
            .expect("an entry of a folder has a name")
            .to_string_lossy()
            .into_owned();
        if name.starts_with(UNFINISHED) {
            let removed = if path.is_dir() {
                fs::remove_dir_all(&path)
            } else {
                fs::remove_file(&path)
            };
            removed.map_err(ReportError::write(&path))?;
        }
    }
    Ok(())
}
