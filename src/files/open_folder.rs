//! A folder that is held open. Files in it are opened relative to its handle, and never through a
//! link: who made the folder cannot lead a reader or a writer out of it.

use super::regular::read_file;
use super::word::word_of;
use cap_fs_ext::{DirExt, FollowSymlinks, MetadataExt, OpenOptionsFollowExt, OpenOptionsSyncExt};
use cap_std::ambient_authority;
use cap_std::fs::{Dir, FileType, OpenOptions};
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

/// An open folder with the path by which it was opened.
#[derive(Debug, Clone)]
pub struct OpenFolder {
    dir: Arc<Dir>,
    path: PathBuf,
}

/// What stands under a name in a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntryKind {
    /// A regular file.
    File,
    /// A folder.
    Folder,
    /// A link, pipe, device or socket.
    Other(&'static str),
}

impl EntryKind {
    fn from_file_type(kind: FileType) -> Self {
        if kind.is_file() {
            Self::File
        } else if kind.is_dir() {
            Self::Folder
        } else if kind.is_symlink() {
            Self::Other("a link")
        } else {
            Self::Other("a pipe, socket or device")
        }
    }

    /// The kind in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::File => "a file",
            Self::Folder => "a folder",
            Self::Other(words) => words,
        }
    }
}

impl OpenFolder {
    /// Opens a folder that a user names, also through links.
    pub fn open(path: &Path) -> io::Result<Self> {
        let dir = Dir::open_ambient_dir(or_here(path), ambient_authority())?;
        Ok(Self {
            dir: Arc::new(dir),
            path: path.to_owned(),
        })
    }

    /// Opens a folder that a user names; creates it and its parents first.
    pub fn create(path: &Path) -> io::Result<Self> {
        fs::create_dir_all(or_here(path))?;
        Self::open(path)
    }

    /// The path by which the folder was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of an entry, for messages and other programs.
    pub fn path_of(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Whether the path still leads to this folder. Not so once it was moved or deleted.
    pub fn is_in_place(&self) -> bool {
        let identity = |dir: &Dir| {
            let metadata = dir.dir_metadata().ok()?;
            Some((metadata.dev(), metadata.ino()))
        };
        let now = Dir::open_ambient_dir(or_here(&self.path), ambient_authority());
        now.is_ok_and(|now| identity(&now).is_some_and(|now| Some(now) == identity(&self.dir)))
    }

    /// What stands under a name; none if nothing does. A link is not followed.
    pub fn kind(&self, name: impl AsRef<OsStr>) -> io::Result<Option<EntryKind>> {
        match self.dir.symlink_metadata(single(name.as_ref())?) {
            Ok(metadata) => Ok(Some(EntryKind::from_file_type(metadata.file_type()))),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Whether a regular file stands under a name.
    ///
    /// # Errors
    /// When something else stands there.
    pub fn has_file(&self, name: impl AsRef<OsStr>) -> io::Result<bool> {
        match self.kind(name)? {
            None => Ok(false),
            Some(EntryKind::File) => Ok(true),
            Some(other) => Err(is_no(other, "regular file")),
        }
    }

    /// Time of the last change and size of a regular file; none if there is none.
    pub fn stamp(&self, name: &str) -> Option<(SystemTime, u64)> {
        let metadata = self.dir.symlink_metadata(single(name).ok()?).ok()?;
        if !metadata.is_file() {
            return None;
        }
        Some((metadata.modified().ok()?.into_std(), metadata.len()))
    }

    /// The names in the folder, in no order.
    pub fn names(&self) -> io::Result<Vec<OsString>> {
        self.dir
            .entries()?
            .map(|entry| Ok(entry?.file_name()))
            .collect()
    }

    /// Opens a folder in this one.
    ///
    /// # Errors
    /// When it is missing, or a link or a file.
    pub fn subfolder(&self, name: &str) -> io::Result<Self> {
        match self.kind(name)? {
            None => return Err(ErrorKind::NotFound.into()),
            Some(EntryKind::Folder) => {}
            Some(other) => return Err(is_no(other, "folder")),
        }
        Ok(Self {
            dir: Arc::new(self.dir.open_dir_nofollow(single(name)?)?),
            path: self.path_of(name),
        })
    }

    /// Opens a folder in this one, and creates it first where nothing stands.
    pub fn make_subfolder(&self, name: &str) -> io::Result<Self> {
        match self.dir.create_dir(single(name)?) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(error),
            _ => self.subfolder(name),
        }
    }

    /// Opens a regular file.
    ///
    /// # Errors
    /// When it is missing, or a link, folder, pipe, device or socket.
    pub fn open_file(&self, name: &str) -> io::Result<File> {
        self.open_with(name, OpenOptions::new().read(true))
    }

    /// Opens a regular file to append to it, or creates an empty one.
    ///
    /// # Errors
    /// When the file has another name too: it may be one of the user's.
    pub fn append_file(&self, name: &str) -> io::Result<File> {
        let file = self.opened(
            name,
            OpenOptions::new().create(true).read(true).append(true),
        )?;
        if file.metadata()?.nlink() > 1 {
            return Err(io::Error::new(
                ErrorKind::InvalidInput,
                "it is a link: the file has another name too",
            ));
        }
        Ok(file.into_std())
    }

    /// The folder as a file, to lock it. Not every system opens a folder so.
    pub(super) fn handle(&self) -> io::Result<File> {
        // The handle of the folder itself may be one that only leads to entries.
        Ok(self.dir.open(".")?.into_std())
    }

    /// Creates a file where nothing stands.
    pub(super) fn new_file(&self, name: &str) -> io::Result<File> {
        self.open_with(
            name,
            OpenOptions::new().read(true).write(true).create_new(true),
        )
    }

    fn open_with(&self, name: &str, options: &mut OpenOptions) -> io::Result<File> {
        Ok(self.opened(name, options)?.into_std())
    }

    fn opened(&self, name: &str, options: &mut OpenOptions) -> io::Result<cap_std::fs::File> {
        // A pipe would wait for its other end: it is found before, and if it took the place of a
        // file meanwhile, the call does not block.
        self.has_file(name)?;
        let file = self.dir.open_with(
            single(name)?,
            options.follow(FollowSymlinks::No).nonblock(true),
        )?;
        match EntryKind::from_file_type(file.metadata()?.file_type()) {
            EntryKind::File => Ok(file),
            other => Err(is_no(other, "regular file")),
        }
    }

    /// Writes a file where nothing stands, not atomically: for folders that are renamed when they
    /// are complete.
    pub fn write_new(&self, name: &str, bytes: &[u8]) -> io::Result<File> {
        let mut file = self.new_file(name)?;
        file.write_all(bytes)?;
        Ok(file)
    }

    /// Reads a regular file of at most `max_bytes`. A larger one is not read at all.
    pub fn read(&self, name: &str, max_bytes: u64) -> io::Result<Vec<u8>> {
        read_file(self.open_file(name)?, max_bytes)
    }

    /// Reads a text of at most `max_bytes` from a regular file.
    pub fn read_text(&self, name: &str, max_bytes: u64) -> io::Result<String> {
        String::from_utf8(self.read(name, max_bytes)?)
            .map_err(|error| io::Error::new(ErrorKind::InvalidData, error.utf8_error()))
    }

    /// Renames an entry. A file or an empty folder of the new name is replaced, a link too.
    pub fn rename(&self, from: impl AsRef<OsStr>, to: impl AsRef<OsStr>) -> io::Result<()> {
        let (from, to) = (single(from.as_ref())?, single(to.as_ref())?);
        self.dir.rename(from, &self.dir, to)
    }

    /// Deletes a file, a link, or a folder with all that is in it. What a link leads to stays.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        let removed = match self.kind(name)? {
            None => Ok(()),
            Some(EntryKind::Folder) => self.dir.remove_dir_all(single(name)?),
            Some(_) => self.dir.remove_file_or_symlink(single(name)?),
        };
        match removed {
            // Another process was faster.
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            removed => removed,
        }
    }
}

/// The empty path is the working directory.
fn or_here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() {
        Path::new(".")
    } else {
        path
    }
}

/// A name that leads to an entry of the folder and nowhere else.
fn single(name: &(impl AsRef<OsStr> + ?Sized)) -> io::Result<&OsStr> {
    let name = name.as_ref();
    let mut components = Path::new(name).components();
    match (components.next(), components.next()) {
        (Some(Component::Normal(only)), None) if only == name => Ok(name),
        _ => Err(io::Error::new(
            ErrorKind::InvalidInput,
            format!("{} is no name of a file", word_of(name).escape_debug()),
        )),
    }
}

fn is_no(found: EntryKind, expected: &str) -> io::Error {
    io::Error::new(
        ErrorKind::InvalidInput,
        format!("it is {} and no {expected}", found.words()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_entries() {
        let work = tempfile::tempdir().unwrap();
        let folder = OpenFolder::create(&work.path().join("a/run")).unwrap();
        for name in ["", ".", "..", "../x", "a/b", "/etc/hosts", "a/"] {
            assert!(folder.kind(name).is_err(), "{name}");
            assert!(folder.make_subfolder(name).is_err(), "{name}");
        }
        folder.make_subfolder("inside").unwrap();
        folder.make_subfolder("inside").unwrap();
        assert_eq!(folder.kind("inside").unwrap(), Some(EntryKind::Folder));
        assert_eq!(folder.names().unwrap(), ["inside"]);
    }

    #[test]
    fn a_folder_that_was_moved_is_not_in_its_place() {
        let work = tempfile::tempdir().unwrap();
        let [here, there] = ["here", "there"].map(|name| work.path().join(name));
        let folder = OpenFolder::create(&here).unwrap();
        assert!(folder.is_in_place());
        fs::rename(&here, &there).unwrap();
        assert!(!folder.is_in_place());
        fs::create_dir(&here).unwrap();
        assert!(!folder.is_in_place());
        folder.make_subfolder("late").unwrap();
        assert!(there.join("late").is_dir() && !here.join("late").exists());
    }

    #[cfg(unix)]
    #[test]
    fn links_pipes_and_sockets_are_neither_read_nor_written() {
        use std::os::unix::fs::symlink;
        use std::os::unix::net::UnixListener;
        let work = tempfile::tempdir().unwrap();
        fs::write(work.path().join("private"), "secret").unwrap();
        fs::create_dir(work.path().join("elsewhere")).unwrap();
        let run = work.path().join("run");
        let folder = OpenFolder::create(&run).unwrap();
        symlink(work.path().join("private"), run.join("link")).unwrap();
        symlink(work.path().join("new"), run.join("dangling")).unwrap();
        symlink("../elsewhere", run.join("out")).unwrap();
        let _listener = UnixListener::bind(run.join("socket")).unwrap();
        let pipe = std::process::Command::new("mkfifo")
            .arg(run.join("pipe"))
            .status();
        assert!(pipe.is_ok_and(|status| status.success()));
        fs::hard_link(work.path().join("private"), run.join("second")).unwrap();
        assert!(folder.append_file("second").is_err());
        for name in ["link", "dangling", "out", "socket", "pipe"] {
            assert!(folder.open_file(name).is_err(), "{name} was opened");
            assert!(folder.append_file(name).is_err(), "{name} was opened");
            assert!(folder.read(name, 100).is_err(), "{name} was read");
            assert!(folder.subfolder(name).is_err(), "{name} is no folder");
            assert!(folder.make_subfolder(name).is_err(), "{name} is no folder");
            folder.remove(name).unwrap();
            assert_eq!(folder.kind(name).unwrap(), None);
        }
        assert_eq!(
            fs::read_to_string(work.path().join("private")).unwrap(),
            "secret"
        );
        assert!(work.path().join("elsewhere").is_dir() && !work.path().join("new").exists());
    }
}
