//! A file that gets its name when it is complete.

use super::open_folder::{EntryKind, OpenFolder};
use super::regular::target;
use super::unfinished::{UNFINISHED, is_of, temporary_name};
use super::word::word_of;
use std::ffi::{OsStr, OsString};
use std::fs::{File, TryLockError};
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// How often a temporary file is created again that another process swept away.
const MAX_TRIES: usize = 100;

/// A file in progress, under a temporary name beside its final one. Dropped before
/// [`Self::finish`], it is deleted. Another process can tell from its lock that it is in progress.
#[derive(Debug)]
pub struct WholeFile {
    folder: OpenFolder,
    name: OsString,
    temporary: String,
    file: File,
    finished: bool,
}

/// Writes a file that a user names: all of it, or nothing.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(bytes)?;
    file.finish()
}

/// Writes a file of a folder of results: all of it, or nothing. The folder may come from elsewhere:
/// a link of the file's name is replaced, and what it leads to stays.
pub fn write_within(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "it names no file"))?;
    let folder = OpenFolder::open(path.parent().unwrap_or(Path::new("")))?;
    let mut file = WholeFile::create_in(&folder, name)?;
    file.write_all(bytes)?;
    file.finish()
}

impl WholeFile {
    /// Begins a file that a user names; through links, the file that they lead to. Its folder must
    /// exist.
    pub fn create(path: &Path) -> io::Result<Self> {
        let path = target(path)?;
        let name = path
            .file_name()
            .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "it names no file"))?;
        let folder = OpenFolder::open(path.parent().unwrap_or(Path::new("")))?;
        Self::create_in(&folder, name)
    }

    /// Begins a file of an open folder. A link of its name is replaced, and what it leads to stays.
    ///
    /// # Errors
    /// When a folder has its name.
    pub fn create_in(folder: &OpenFolder, name: impl AsRef<OsStr>) -> io::Result<Self> {
        let name = name.as_ref();
        if folder.kind(name)? == Some(EntryKind::Folder) {
            return Err(io::Error::new(
                ErrorKind::IsADirectory,
                "it is a folder and no regular file",
            ));
        }
        let shown = &word_of(name);
        sweep(folder, |temporary| is_of(temporary, shown))?;
        for _ in 0..MAX_TRIES {
            let temporary = temporary_name(shown);
            let file = match folder.new_file(&temporary) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                created => created?,
            };
            // File systems without locks have no sweepers either.
            let _ = file.lock();
            if folder.has_file(&temporary)? {
                return Ok(Self {
                    folder: folder.clone(),
                    name: name.to_owned(),
                    temporary,
                    file,
                    finished: false,
                });
            }
        }
        Err(io::Error::other(
            "its temporary files vanish while it is written",
        ))
    }

    /// The present path of the file, for a program that writes it.
    pub fn temporary_path(&self) -> PathBuf {
        self.folder.path_of(&self.temporary)
    }

    /// Another handle to write the file with.
    pub fn writer(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// Gives the file its name. It is on the disk then.
    pub fn finish(self) -> io::Result<()> {
        self.file.sync_data()?;
        self.finish_unsynced()
    }

    /// Gives the file its name, and does not wait for the disk: for files of which a run writes
    /// many, and which it can write again.
    pub fn finish_unsynced(mut self) -> io::Result<()> {
        self.folder.rename(&self.temporary, &self.name)?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if !self.finished {
            // The failure before this is the one to report, and the next writer sweeps.
            let _ = self.folder.remove(&self.temporary);
        }
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl OpenFolder {
    /// Writes a file: all of it, or nothing.
    pub fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let mut file = WholeFile::create_in(self, name)?;
        file.write_all(bytes)?;
        file.finish()
    }

    /// Deletes the unfinished files that no living process writes.
    pub fn sweep_files(&self) -> io::Result<()> {
        sweep(self, |name| {
            let is_file = || matches!(self.kind(name), Ok(Some(EntryKind::File)));
            name.starts_with(UNFINISHED) && is_file()
        })
    }
}

/// Deletes temporary files and folders whose process is gone: nobody holds their lock.
pub(super) fn sweep(folder: &OpenFolder, is_meant: impl Fn(&str) -> bool) -> io::Result<()> {
    for name in folder.names()? {
        let Some(name) = name.to_str().filter(|name| is_meant(name)) else {
            continue;
        };
        let opened = match folder.kind(name)? {
            Some(EntryKind::Folder) => folder.subfolder(name).and_then(|folder| folder.handle()),
            _ => folder.open_file(name),
        };
        // What is neither was left by nobody, and what cannot be opened is in nobody's way.
        let Ok(opened) = opened else {
            continue;
        };
        match opened.try_lock() {
            Ok(()) => folder.remove(name)?,
            Err(TryLockError::WouldBlock | TryLockError::Error(_)) => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::thread;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let work = tempfile::tempdir().unwrap();
        let path = work.path().join("page.html");
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"half").unwrap();
        assert!(!path.exists() && file.temporary_path().is_file());
        drop(file);
        assert_eq!(names(work.path()), Vec::<String>::new());
        write_whole(&path, b"whole").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(names(work.path()), ["page.html"]);
    }

    #[test]
    fn the_next_writer_sweeps_what_a_dead_one_left_and_nothing_else() {
        let work = tempfile::tempdir().unwrap();
        for left in [
            ".unfinished-a.gif-1-0",
            ".unfinished-b.gif-1-0",
            ".unfinished-a.gif",
        ] {
            fs::write(work.path().join(left), "left").unwrap();
        }
        let alive = WholeFile::create(&work.path().join("a.gif")).unwrap();
        write_whole(&work.path().join("a.gif"), b"film").unwrap();
        let mut now = names(work.path());
        now.sort();
        let own = alive.temporary_path();
        let own = own.file_name().unwrap().to_str().unwrap();
        assert_eq!(now.len(), 4, "{now:?}");
        for name in [own, ".unfinished-a.gif", ".unfinished-b.gif-1-0", "a.gif"] {
            assert!(now.iter().any(|found| found == name), "{name}: {now:?}");
        }
        alive.finish().unwrap();
    }

    #[test]
    fn many_writers_of_one_file_all_succeed() {
        let work = tempfile::tempdir().unwrap();
        let path = &work.path().join("page.html");
        thread::scope(|scope| {
            for writer in 0..8u8 {
                scope.spawn(move || {
                    for _ in 0..20 {
                        write_whole(path, &[writer; 1000]).unwrap();
                    }
                });
            }
        });
        let bytes = fs::read(path).unwrap();
        assert!(bytes.len() == 1000 && bytes.iter().all(|byte| *byte == bytes[0]));
        assert_eq!(names(work.path()), ["page.html"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_of_the_user_stays_and_one_in_an_open_folder_is_replaced() {
        let work = tempfile::tempdir().unwrap();
        let [mine, link] = ["mine", "link"].map(|name| work.path().join(name));
        fs::write(&mine, "old").unwrap();
        std::os::unix::fs::symlink("mine", &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&mine).unwrap(), b"new");
        write_within(&link, b"newer").unwrap();
        assert!(!fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&link).unwrap(), b"newer");
        assert_eq!(fs::read(&mine).unwrap(), b"new");
    }
}
