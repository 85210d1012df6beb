//! Writes a folder atomically: into a hidden folder beside it, which is renamed at the end.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A folder under construction. Dropped before [`Self::finish`], it is removed.
#[derive(Debug)]
pub(super) struct Staging {
    target: PathBuf,
    folder: PathBuf,
    finished: bool,
}

impl Staging {
    /// Begins to write `target`; `AlreadyExists` unless it is missing or an empty folder.
    pub(super) fn begin(target: &Path) -> io::Result<Self> {
        if is_taken(target)? {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        // A link to an empty folder stays a link.
        let target = &fs::canonicalize(target).unwrap_or_else(|_| target.to_owned());
        let name = target.file_name().ok_or(io::ErrorKind::InvalidInput)?;
        let parent = target
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        fs::create_dir_all(parent)?;
        let folder = parent.join(format!(
            ".{}.{}.part",
            name.to_string_lossy(),
            std::process::id()
        ));
        fs::create_dir(&folder)?;
        Ok(Self {
            target: target.to_owned(),
            folder,
            finished: false,
        })
    }

    /// The present path of a file of the finished folder; its parent folder exists.
    pub(super) fn path(&self, inside: &Path) -> io::Result<PathBuf> {
        let path = self.folder.join(inside);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        Ok(path)
    }

    pub(super) fn write(&self, inside: &Path, text: &str) -> io::Result<()> {
        fs::write(self.path(inside)?, text)
    }

    /// Gives the folder its name.
    pub(super) fn finish(mut self) -> io::Result<()> {
        fs::rename(&self.folder, &self.target)?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.finished {
            // An error cannot be reported here; a hidden folder that ends in `.part` would remain.
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

/// Whether the path is anything but missing or an empty folder.
fn is_taken(path: &Path) -> io::Result<bool> {
    match fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_some()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => Ok(true),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_appears_whole_or_not_at_all() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("deep").join("out");
        let staging = Staging::begin(&target).unwrap();
        staging.write(Path::new("a/b.txt"), "b").unwrap();
        assert!(!target.exists());
        drop(staging);
        assert_eq!(fs::read_dir(target.parent().unwrap()).unwrap().count(), 0);
        let staging = Staging::begin(&target).unwrap();
        staging.write(Path::new("a/b.txt"), "b").unwrap();
        staging.finish().unwrap();
        assert_eq!(fs::read_to_string(target.join("a/b.txt")).unwrap(), "b");
        assert_eq!(
            Staging::begin(&target).unwrap_err().kind(),
            io::ErrorKind::AlreadyExists
        );
        assert_eq!(
            Staging::begin(&target.join("a/b.txt")).unwrap_err().kind(),
            io::ErrorKind::AlreadyExists
        );
        fs::create_dir(home.path().join("empty")).unwrap();
        Staging::begin(&home.path().join("empty"))
            .unwrap()
            .finish()
            .unwrap();
    }
}
