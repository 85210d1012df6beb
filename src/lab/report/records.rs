//! Records of a model's answers: a line of JSON for each question that was answered, kept as it
//! comes.

use planagent_files::{MAX_LIST_BYTES, OpenFolder};
use planagent_runs::report::ReportError;
use planagent_runs::report::atomic;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::Write;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The records of a file, in the order in which they came.
#[derive(Debug)]
pub struct Records<R> {
    path: PathBuf,
    file: Mutex<File>,
    of: PhantomData<fn(R)>,
}

impl<R: Serialize + DeserializeOwned> Records<R> {
    /// Begins or resumes the file of this name in a folder; gives the records that are complete.
    pub fn open(folder: &Path, name: &str) -> Result<(Self, Vec<R>), ReportError> {
        atomic::folder(folder)?;
        let path = folder.join(name);
        let opened = OpenFolder::open(folder).map_err(ReportError::read(folder))?;
        let text = match opened.read_text(name, MAX_LIST_BYTES) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(ReportError::read(&path)(error)),
        };
        // A process that was killed may leave the first part of a line.
        let complete: String = text
            .split_inclusive('\n')
            .filter(|line| line.ends_with('\n'))
            .collect();
        let records = complete
            .lines()
            .map(serde_json::from_str)
            .collect::<Result<_, _>>()
            .map_err(ReportError::at(&path))?;
        if complete.len() < text.len() {
            atomic::write_within(&path, complete.as_bytes())?;
        }
        let file = opened
            .append_file(name)
            .map_err(ReportError::write(&path))?;
        Ok((
            Self {
                path,
                file: Mutex::new(file),
                of: PhantomData,
            },
            records,
        ))
    }

    /// Adds a record.
    pub fn add(&self, record: &R) -> Result<(), ReportError> {
        let line = serde_json::to_string(record).map_err(ReportError::at(&self.path))? + "\n";
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(line.as_bytes())
            .map_err(ReportError::write(&self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twins::PairRecord;
    use std::fs;

    const PAIRS: &str = "pairs.jsonl";

    #[test]
    fn the_first_part_of_a_line_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let record = |pair: &str| PairRecord {
            pair: pair.to_owned(),
            kind: "taper".to_owned(),
            dropped: Some("the prompts differ".to_owned()),
            scenes: Vec::new(),
        };
        let (records, before) = Records::<PairRecord>::open(folder.path(), PAIRS).unwrap();
        assert!(before.is_empty());
        records.add(&record("one")).unwrap();
        let path = folder.path().join(PAIRS);
        let whole = fs::read_to_string(&path).unwrap();
        fs::write(&path, format!("{whole}{}", &whole[..10])).unwrap();
        let (records, before) = Records::<PairRecord>::open(folder.path(), PAIRS).unwrap();
        assert_eq!(before, [record("one")]);
        records.add(&record("two")).unwrap();
        assert_eq!(
            Records::<PairRecord>::open(folder.path(), PAIRS).unwrap().1,
            [record("one"), record("two")]
        );
    }
}
