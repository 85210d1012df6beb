//! Whether results can be written: found before the work, and not after it.

use super::error::{ReportError, ReportFault};
use planagent_files::{OpenFolder, WholeFile};
use std::fs;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// How often a look is repeated that another process disturbed.
const MAX_TRIES: usize = 100;
/// Bytes at the beginning of a file that tell which command wrote it.
const MARKED_BYTES: u64 = 1 << 10;

/// Checks that files can be created in a folder, which need not exist yet. Leaves nothing
/// behind, apart from an empty folder where several processes look at one time.
///
/// # Errors
/// When something else stands in its place, or the folder or a file in it cannot be created.
pub fn check_writable(folder: &Path) -> Result<(), ReportError> {
    let is_named = |part: &&Path| !part.as_os_str().is_empty();
    let found = |part: &Path| fs::metadata(part).ok().map(|found| found.is_dir());
    // One look at each: another process may delete a folder between two.
    if let Some((existing, false)) = folder
        .ancestors()
        .find_map(|part| Some((part, found(part)?)))
    {
        return Err(ReportError::at(folder)(ReportFault::NoFolder(
            existing.to_owned(),
        )));
    }
    let missing: Vec<&Path> = folder
        .ancestors()
        .filter(is_named)
        .take_while(|part| !part.exists())
        .collect();
    let mut written = write_file(folder);
    for _ in 0..MAX_TRIES {
        match &written {
            // Another process made the same look, and took the folder away again.
            Err(error)
                if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::AlreadyExists) =>
            {
                written = write_file(folder);
            }
            _ => break,
        }
    }
    for made in missing {
        // Another process may use it by now.
        let _ = fs::remove_dir(made);
    }
    written.map_err(ReportError::write(folder))
}

/// Refuses to replace a file of others: an own one has all of `marks` in its first KiB. A file that
/// is missing or empty replaces nothing.
///
/// # Errors
/// When the file is another's, or cannot be read.
pub fn check_own(file: &Path, marks: &[&str]) -> Result<(), ReportError> {
    // A pipe or a device loses nothing.
    if fs::metadata(file).is_ok_and(|found| !found.is_file()) {
        return Ok(());
    }
    let mut beginning = Vec::new();
    let read =
        fs::File::open(file).and_then(|file| file.take(MARKED_BYTES).read_to_end(&mut beginning));
    match read {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        read => read.map_err(ReportError::read(file))?,
    };
    let text = String::from_utf8_lossy(&beginning);
    if text.is_empty() || marks.iter().all(|mark| text.contains(mark)) {
        return Ok(());
    }
    Err(ReportError::at(file)(ReportFault::NotOwn))
}

/// Creates a folder and, in it, a file that is deleted again.
fn write_file(folder: &Path) -> io::Result<()> {
    let probe = WholeFile::create_in(&OpenFolder::create(folder)?, "probe")?;
    drop(probe);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_left_behind() {
        let work = tempfile::tempdir().unwrap();
        let new = work.path().join("new/run");
        check_writable(&new).unwrap();
        assert_eq!(fs::read_dir(work.path()).unwrap().count(), 0);
        fs::create_dir_all(&new).unwrap();
        check_writable(&new).unwrap();
        assert!(new.is_dir() && fs::read_dir(&new).unwrap().count() == 0);
        fs::write(work.path().join("file"), "").unwrap();
        let error = check_writable(&work.path().join("file/run"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("is a file and no folder"), "{error}");
    }

    #[test]
    fn files_of_others_are_not_replaced() {
        let work = tempfile::tempdir().unwrap();
        let file = work.path().join("notes.txt");
        let marks = ["<!doctype html>", "PlanAgent"];
        check_own(&file, &marks).unwrap();
        for own in ["", "<!doctype html>\n<title>PlanAgent: run</title>"] {
            fs::write(&file, own).unwrap();
            check_own(&file, &marks).unwrap();
        }
        for other in ["notes", "<!doctype html>\n<title>mine</title>"] {
            fs::write(&file, other).unwrap();
            let error = check_own(&file, &marks).unwrap_err().to_string();
            assert!(
                error.contains("notes.txt: this command did not write"),
                "{error}"
            );
        }
    }

    #[test]
    fn many_looks_at_one_time_all_succeed() {
        let work = tempfile::tempdir().unwrap();
        let new = &work.path().join("runs");
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(move || (0..50).for_each(|_| check_writable(new).unwrap()));
            }
        });
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_takes_no_files_is_an_error() {
        for folder in ["/proc", "/proc/run"] {
            let error = check_writable(Path::new(folder)).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("{folder}: cannot write: ")),
                "{error}"
            );
        }
    }
}
