//! A folder that gets its name when it is complete.

use super::open_folder::OpenFolder;
use super::unfinished::{is_of, temporary_name};
use super::whole_file::sweep;
use super::word::word_of;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// How often a temporary folder is created again that another process swept away.
const MAX_TRIES: usize = 100;

/// A folder in progress, under a temporary name beside its final one. Dropped before
/// [`Self::finish`], it is deleted with all that is in it. Another process can tell from its lock
/// that it is in progress.
#[derive(Debug)]
pub struct WholeFolder {
    parent: OpenFolder,
    name: OsString,
    temporary: String,
    finished: bool,
    /// Locked while the folder is filled; none on systems that do not lock folders.
    _lock: Option<File>,
}

impl WholeFolder {
    /// Begins a folder that a user names; through a link to an empty folder, that folder. Its
    /// parents are created. What a dead process left of a folder of this name is deleted.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`] unless the folder is missing or empty.
    pub fn create(target: &Path) -> io::Result<Self> {
        if is_taken(target)? {
            return Err(ErrorKind::AlreadyExists.into());
        }
        // A link to an empty folder stays a link.
        let target = &fs::canonicalize(target).unwrap_or_else(|_| target.to_owned());
        let name = target
            .file_name()
            .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "it names no folder"))?;
        let parent = OpenFolder::create(target.parent().unwrap_or(Path::new("")))?;
        let shown = &word_of(name);
        sweep(&parent, |temporary| is_of(temporary, shown))?;
        for _ in 0..MAX_TRIES {
            let temporary = temporary_name(shown);
            if parent.kind(&temporary)?.is_some() {
                continue;
            }
            let made = match parent.make_subfolder(&temporary) {
                // Another process swept it away as it was made.
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                made => made?,
            };
            // Systems without locks of folders have no sweepers either.
            let lock = made.handle().ok();
            let lock = lock.filter(|folder| folder.lock().is_ok());
            if parent.kind(&temporary)?.is_some() {
                return Ok(Self {
                    parent,
                    name: name.to_owned(),
                    temporary,
                    finished: false,
                    _lock: lock,
                });
            }
        }
        Err(io::Error::other(
            "its temporary folders vanish while it is written",
        ))
    }

    /// The present path of a file of the finished folder; its parent folder exists.
    pub fn path_of(&self, inside: &Path) -> io::Result<PathBuf> {
        let path = self.parent.path_of(&self.temporary).join(inside);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        Ok(path)
    }

    /// Writes a file of the folder.
    pub fn write(&self, inside: &Path, bytes: &[u8]) -> io::Result<()> {
        fs::write(self.path_of(inside)?, bytes)
    }

    /// Gives the folder its name.
    pub fn finish(mut self) -> io::Result<()> {
        self.parent.rename(&self.temporary, &self.name)?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for WholeFolder {
    fn drop(&mut self) {
        if !self.finished {
            // The failure before this is the one to report, and the next writer sweeps.
            let _ = self.parent.remove(&self.temporary);
        }
    }
}

/// Whether the path is anything but missing or an empty folder.
fn is_taken(path: &Path) -> io::Result<bool> {
    match fs::read_dir(path) {
        Ok(mut entries) => Ok(entries.next().is_some()),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        Err(error) if error.kind() == ErrorKind::NotADirectory => Ok(true),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_folder_appears_whole_or_not_at_all() {
        let home = tempfile::tempdir().unwrap();
        let target = home.path().join("deep").join("out");
        let folder = WholeFolder::create(&target).unwrap();
        folder.write(Path::new("a/b.txt"), b"b").unwrap();
        assert!(!target.exists());
        drop(folder);
        assert_eq!(names(target.parent().unwrap()), Vec::<String>::new());
        let folder = WholeFolder::create(&target).unwrap();
        folder.write(Path::new("a/b.txt"), b"b").unwrap();
        folder.finish().unwrap();
        assert_eq!(fs::read_to_string(target.join("a/b.txt")).unwrap(), "b");
        for taken in [&target, &target.join("a/b.txt")] {
            let error = WholeFolder::create(taken).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        }
        let empty = home.path().join("empty");
        fs::create_dir(&empty).unwrap();
        WholeFolder::create(&empty).unwrap().finish().unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn the_next_writer_sweeps_what_a_dead_one_left_and_nothing_else() {
        let home = tempfile::tempdir().unwrap();
        for left in [".unfinished-a-1-0", ".unfinished-b-1-0", ".unfinished-a"] {
            let inside = home.path().join(left).join("inside");
            fs::create_dir_all(&inside).unwrap();
            fs::write(inside.join("half"), "half").unwrap();
        }
        let alive = WholeFolder::create(&home.path().join("a")).unwrap();
        WholeFolder::create(&home.path().join("a"))
            .unwrap()
            .finish()
            .unwrap();
        let now = names(home.path());
        assert_eq!(now.len(), 4, "{now:?}");
        for name in [&alive.temporary, ".unfinished-a", ".unfinished-b-1-0", "a"] {
            assert!(now.iter().any(|found| found == name), "{name}: {now:?}");
        }
        // An empty folder of the name is replaced; one that was filled meanwhile is kept.
        alive.write(Path::new("file"), b"new").unwrap();
        fs::write(home.path().join("a/other"), "kept").unwrap();
        assert!(alive.finish().is_err());
        assert_eq!(names(&home.path().join("a")), ["other"]);
    }

    #[cfg(unix)]
    #[test]
    fn many_writers_of_one_folder_leave_one_whole() {
        let home = tempfile::tempdir().unwrap();
        let target = &home.path().join("out");
        let finished = std::thread::scope(|scope| {
            let writer = |text: u8| {
                let folder = WholeFolder::create(target)?;
                for file in ["a", "b", "c"] {
                    folder.write(Path::new(file), &[text; 100])?;
                }
                folder.finish()
            };
            let writers: Vec<_> = (0..8)
                .map(|text| scope.spawn(move || writer(text)))
                .collect();
            let ended = writers.into_iter().map(|writer| writer.join().unwrap());
            ended.flatten().count()
        });
        assert_eq!(finished, 1);
        assert_eq!(names(home.path()), ["out"]);
        assert_eq!(names(target), ["a", "b", "c"]);
    }
}
