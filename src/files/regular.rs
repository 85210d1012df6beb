//! Opening files and finding where to write: never a pipe, which would wait forever, nor a device
//! or socket.

use std::fs::{self, File, FileType};
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Maximum number of links that lead to a file, as in Linux.
const MAX_LINKS: usize = 40;

/// Opens a regular file, also through links.
///
/// # Errors
/// When it is missing, or a folder, pipe, device or socket.
pub fn open(path: &Path) -> io::Result<File> {
    check_regular(fs::metadata(path)?.file_type())?;
    File::open(path)
}

/// Reads a text of at most `max_bytes` from a regular file. A larger one is not read at all.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    String::from_utf8(read(path, max_bytes)?)
        .map_err(|error| io::Error::new(ErrorKind::InvalidData, error.utf8_error()))
}

/// Reads at most `max_bytes` from a regular file. A larger one is not read at all.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_file(open(path)?, max_bytes)
}

/// Reads at most `max_bytes` from an open file.
pub(super) fn read_file(file: File, max_bytes: u64) -> io::Result<Vec<u8>> {
    let length = file.metadata()?.len();
    if length > max_bytes {
        return Err(too_large(&format!("{length} bytes"), max_bytes));
    }
    let mut bytes = Vec::new();
    // A file may grow, and those of the system say that they are empty.
    if file.take(max_bytes + 1).read_to_end(&mut bytes)? as u64 > max_bytes {
        return Err(too_large("more", max_bytes));
    }
    Ok(bytes)
}

fn too_large(bytes: &str, max_bytes: u64) -> io::Error {
    io::Error::new(
        ErrorKind::InvalidData,
        format!("the file has {bytes}; at most {max_bytes} are read"),
    )
}

/// The file that a user's path leads to through links, existing or not: who writes it under another
/// name and renames it would otherwise replace the link.
///
/// # Errors
/// When something else than a regular file is there.
pub fn target(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        let kind = match fs::symlink_metadata(&path) {
            Ok(metadata) => metadata.file_type(),
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(path),
            Err(error) => return Err(error),
        };
        if !kind.is_symlink() {
            return check_regular(kind).map(|()| path);
        }
        let next = fs::read_link(&path)?;
        path = path.parent().unwrap_or(Path::new("")).join(next);
    }
    Err(io::Error::other("too many links"))
}

fn check_regular(kind: FileType) -> io::Result<()> {
    if kind.is_file() {
        return Ok(());
    }
    let what = if kind.is_dir() {
        "a folder"
    } else {
        special(kind)
    };
    Err(io::Error::new(
        ErrorKind::InvalidInput,
        format!("it is {what} and no regular file"),
    ))
}

#[cfg(unix)]
fn special(kind: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match kind {
        kind if kind.is_fifo() => "a pipe (FIFO)",
        kind if kind.is_socket() => "a socket",
        _ => "a device",
    }
}

#[cfg(not(unix))]
fn special(_: FileType) -> &'static str {
    "a device"
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    #[test]
    fn only_regular_files_are_opened_and_written() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, chain, dangling, ring, socket] =
            ["file", "link", "chain", "dangling", "ring", "socket"]
                .map(|name| folder.path().join(name));
        fs::write(&file, "text").unwrap();
        symlink("file", &link).unwrap();
        symlink(&link, &chain).unwrap();
        symlink("new", &dangling).unwrap();
        symlink("ring", &ring).unwrap();
        let _listener = UnixListener::bind(&socket).unwrap();
        assert_eq!(read_text(&chain, 4).unwrap(), "text");
        assert_eq!(
            read_text(&chain, 3).unwrap_err().to_string(),
            "the file has 4 bytes; at most 3 are read"
        );
        #[cfg(target_os = "linux")]
        assert_eq!(
            read_text(Path::new("/proc/self/status"), 3)
                .unwrap_err()
                .to_string(),
            "the file has more; at most 3 are read"
        );
        assert_eq!(target(&chain).unwrap(), file);
        assert_eq!(target(&dangling).unwrap(), folder.path().join("new"));
        let said = |error: io::Error| error.to_string();
        for (path, what) in [
            (folder.path(), "a folder"),
            (Path::new("/dev/null"), "a device"),
            (&socket, "a socket"),
        ] {
            let expected = format!("it is {what} and no regular file");
            assert_eq!(
                (
                    said(open(path).unwrap_err()),
                    said(target(path).unwrap_err())
                ),
                (expected.clone(), expected)
            );
        }
        assert!(target(&ring).is_err() && open(&dangling).is_err());
    }
}
