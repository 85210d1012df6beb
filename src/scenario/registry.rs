//! The registry of scenario readers: which scenarios a word of the command line names.
//!
//! A reader is one folder of this stage and one line of [`READERS`]; a program adds its own by
//! [`Readers::with`].

#[cfg(feature = "argoverse2")]
use super::argoverse2;
use super::generator;
use super::later_start::{self, LaterStart};
use super::modified::{self, ModifiedName};
#[cfg(feature = "nuplan")]
use super::nuplan;
use super::reader::{
    DataRoots, MAX_FOLDER_DEPTH, OnProgress, ReaderError, ScenarioReader, ScenarioRef,
    absolute_path,
};
use super::split::Split;
#[cfg(feature = "womd")]
use super::womd;
use planagent_files::{KIND_BYTES, TEXT, kind_of, path_of};
use std::collections::BTreeSet;
use std::fmt;
use std::io::Read;
use std::path::Path;

type BuildReader = fn(&DataRoots) -> Box<dyn ScenarioReader>;

/// The readers of this package. In a folder that several of them read, their scenarios stand in
/// this order.
const READERS: &[BuildReader] = &[
    |_| Box::new(generator::GeneratedReader),
    #[cfg(feature = "womd")]
    |_| Box::<womd::WomdReader>::default(),
    #[cfg(feature = "argoverse2")]
    |_| Box::<argoverse2::Argoverse2Reader>::default(),
    #[cfg(feature = "nuplan")]
    |roots| Box::new(nuplan::NuPlanReader::new(roots.clone())),
];

/// Where the test recordings lie in `$PLANAGENT_DATA`.
pub const RECORDINGS: [&str; 3] = ["womd", "argoverse2/sensor", "argoverse2/motion_forecasting"];

/// The readers of a program, with the maps and notes that they keep.
pub struct Readers {
    readers: Vec<Box<dyn ScenarioReader>>,
}

impl Readers {
    /// The readers of this package. Nothing is read yet.
    pub fn new(roots: &DataRoots) -> Self {
        Self {
            readers: READERS.iter().map(|reader| reader(roots)).collect(),
        }
    }

    /// With one more reader.
    #[must_use]
    pub fn with(mut self, reader: impl ScenarioReader + 'static) -> Self {
        self.readers.push(Box::new(reader));
        self
    }

    /// The first reader that takes a word.
    fn reader_of(&self, word: &str) -> Option<&dyn ScenarioReader> {
        self.readers
            .iter()
            .find(|reader| reader.recognizes(word))
            .map(|reader| &**reader)
    }

    /// All scenarios that a word of the command line names. They are those of the reader that takes
    /// it, else those that all readers find in the folder of that name and in the folders below.
    /// With `@SECONDS` at the end they start that much later. With `~NAME` or `~FILE.toml` they are
    /// modified.
    pub fn find(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        if let Some((base, name)) = ModifiedName::in_word(word) {
            let modification = name.read().map_err(ReaderError::new)?;
            return Ok(self
                .find(base)?
                .into_iter()
                .map(|scenario| modification.modify(scenario))
                .collect());
        }
        if let Some((base, LaterStart(iterations))) = start_in(word) {
            return Ok(self
                .find(base)?
                .into_iter()
                .map(|scenario| scenario.started_later(iterations))
                .collect());
        }
        let path = &path_of(word);
        if let Some(error) = self.wrong_mark(word) {
            return Err(error);
        }
        if let Some(reader) = self.reader_of(word) {
            return reader.list(word);
        }
        if !path.is_dir() {
            let path = path.to_owned();
            return Err(if path.exists() {
                let kind = kind_of_file(&path);
                ReaderError::UnknownFile { path, kind }
            } else {
                ReaderError::Missing(path)
            });
        }
        let mut all = Vec::new();
        let (mut looked_for, mut faults) = (Vec::new(), Vec::new());
        for reader in &self.readers {
            if let Some(files) = reader.looks_for() {
                match reader.list(word) {
                    Ok(found) => all.extend(found),
                    Err(error) => faults.push(error),
                }
                looked_for.push(files);
            }
        }
        // Files of one source that cannot be read do not hide those of another.
        if !all.is_empty() {
            all.extend(
                faults
                    .iter()
                    .map(|fault| ScenarioRef::unreadable(path, fault.to_string())),
            );
        } else if !faults.is_empty() {
            // What was passed over may be what the user means.
            let fault = faults.swap_remove(0);
            let notes = self.take_notes();
            return Err(if notes.is_empty() {
                fault
            } else {
                ReaderError::Unreadable(format!("{fault}; {}", notes.join("; ")))
            });
        }
        match all.first() {
            None => {
                let looked_for = looked_for.join(", no ");
                let files = format!("no {looked_for}, down to {MAX_FOLDER_DEPTH} folders below");
                Err(ReaderError::Empty {
                    path: path.to_owned(),
                    // What was passed over may be what the user means.
                    looked_for: std::iter::once(files).chain(self.take_notes()).collect(),
                })
            }
            Some(first) => match first.fault() {
                Some(fault) if all.iter().all(|one| one.fault().is_some()) => {
                    Err(ReaderError::Unreadable(fault.to_owned()))
                }
                _ => Ok(all),
            },
        }
    }

    /// What is wrong behind the last mark of a word whose beginning names scenarios.
    fn wrong_mark(&self, word: &str) -> Option<ReaderError> {
        let is_known = |base: &str| path_of(base).exists() || self.reader_of(base).is_some();
        if path_of(word).exists() {
            return None;
        }
        let own = |(base, name): (&str, &str)| (base.to_owned(), name.to_owned());
        if let Some((base, name)) = word.rsplit_once(modified::MARK).map(own)
            && is_known(&base)
        {
            let word = word.to_owned();
            return Some(ReaderError::UnknownModification { word, name });
        }
        let (base, start) = word.rsplit_once(later_start::MARK).map(own)?;
        is_known(&base).then(|| ReaderError::UnknownStart {
            word: word.to_owned(),
            base,
            start,
        })
    }

    /// The word by which the same scenarios are found from any working directory.
    pub fn absolute_word(&self, word: &str) -> String {
        if let Some((base, name)) = ModifiedName::in_word(word) {
            return name.absolute().mark(&self.absolute_word(base));
        }
        if let Some((base, start)) = start_in(word) {
            return start.mark(&self.absolute_word(base));
        }
        self.reader_of(word)
            .map_or_else(|| absolute_path(word), |reader| reader.absolute_word(word))
    }

    /// The names of all splits.
    pub fn splits(&self) -> Vec<&'static str> {
        self.readers
            .iter()
            .flat_map(|reader| reader.splits())
            .collect()
    }

    /// The scenarios of a split; `None` when no reader knows the name.
    pub fn split(
        &self,
        name: &str,
        on_progress: OnProgress<'_>,
    ) -> Option<Result<Split, ReaderError>> {
        self.readers
            .iter()
            .find_map(|reader| reader.split(name, on_progress))
    }

    /// What a user should know about the data that was read since the last call.
    pub fn take_notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = self
            .readers
            .iter()
            .flat_map(|reader| reader.take_notes())
            .collect();
        // Of a folder that cannot be listed, each reader has the same note.
        let mut seen = BTreeSet::new();
        notes.retain(|note| seen.insert(note.clone()));
        notes
    }
}

/// What a file of no reader is, if that is known and says something.
fn kind_of_file(path: &Path) -> Option<&'static str> {
    let mut beginning = Vec::new();
    let file = planagent_files::open(path).ok()?;
    file.take(KIND_BYTES as u64)
        .read_to_end(&mut beginning)
        .ok()?;
    kind_of(&beginning).filter(|kind| *kind != TEXT)
}

/// The later start that a word ends in, unless it is the name of a file.
fn start_in(word: &str) -> Option<(&str, LaterStart)> {
    LaterStart::parse(word).filter(|_| !path_of(word).exists())
}

impl fmt::Debug for Readers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Readers({})", self.readers.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_files::word_of;

    #[test]
    fn a_wrong_end_of_a_word_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.tfrecord");
        std::fs::write(&file, "").unwrap();
        let readers = Readers::new(&DataRoots::default());
        let base = word_of(file.as_os_str());
        let said = |word: String| readers.find(&word).unwrap_err().to_string();
        for base in [
            base.as_str(),
            "generated/changing_lane/3",
            "log.db#0123456789abcdef",
        ] {
            let unknown = said(format!("{base}~jaywalker"));
            let kind = "name one of low_traffic_density";
            assert!(
                unknown.starts_with("'jaywalker' in ") && unknown.contains(kind),
                "{unknown}"
            );
        }
        let start = said(format!("{base}@3s"));
        assert!(
            start.starts_with("'3s' in ") && start.contains("a.tfrecord@3"),
            "{start}"
        );
        let missing = said("none.tfrecord@3s".to_owned());
        assert!(missing.contains("there is no file or folder"), "{missing}");
    }
}
