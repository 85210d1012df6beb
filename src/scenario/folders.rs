//! Where the recordings of a folder are looked for.

use crate::reader::MAX_FOLDER_DEPTH;
use planagent_files::is_hidden;
use std::io;
use std::path::{Path, PathBuf};

/// Folders that hold no recordings, but very many files, or macOS's copies of their names.
const WITHOUT_RECORDINGS: [&str; 3] = ["sensor_blobs", "maps", "__MACOSX"];

/// The files in a folder and in the folders below that `enter` lets in, in order of their paths.
/// Hidden names are left out. A folder below that cannot be listed hides nothing beside it: it is
/// one of the notes.
pub(crate) fn files_below(
    folder: &Path,
    mut enter: impl FnMut(&Path) -> bool,
    notes: &mut Vec<String>,
) -> io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    // No recursion, so that `enter` and `notes` are borrowed once.
    let mut left = vec![(folder.to_owned(), 0)];
    while let Some((folder, depth)) = left.pop() {
        let entries = match list(&folder) {
            Ok(entries) => entries,
            Err(error) if depth == 0 => return Err(error),
            Err(error) => {
                notes.push(format!("cannot list {}: {error}", folder.display()));
                continue;
            }
        };
        for (path, name) in entries {
            if is_hidden(&name) {
                continue;
            }
            if !path.is_dir() {
                files.push(path);
            } else if depth < MAX_FOLDER_DEPTH
                && !WITHOUT_RECORDINGS.contains(&name.as_str())
                && enter(&path)
            {
                left.push((path, depth + 1));
            }
        }
    }
    files.sort();
    Ok(files)
}

/// The entries of a folder with their names.
fn list(folder: &Path) -> io::Result<Vec<(PathBuf, String)>> {
    let named = |entry: std::fs::DirEntry| {
        let name = entry.file_name().to_string_lossy().into_owned();
        (entry.path(), name)
    };
    std::fs::read_dir(folder)?
        .map(|entry| entry.map(named))
        .collect()
}
