//! The folder that a run leaves: `summary.json`, `calls.jsonl`, `timing.json`, `config.toml`, and for each drive its
//! transcript and BEV maps.

use super::call_record::call_record;
use super::summary::Summary;
use super::timing::Timing;
use super::transcript::transcript;
use crate::experiment::run::{DriveRecord, Driven};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Parent of the folders that are numbered.
const RUNS: &str = "runs";

/// Why results cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The folder holds something already.
    #[error("the folder {} is not empty; name a new one, so that no result is lost", .0.display())]
    NotEmpty(PathBuf),
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A BEV map cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Image {
        /// Which.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A value cannot be put into JSON.
    #[error("cannot serialise the results")]
    Json(#[from] serde_json::Error),
}

/// An empty folder that is known to be writable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the folder; without a name, the next free `runs/NNNN`. Called before the drives, so that hours of driving do
    /// not end at a folder that cannot be written.
    ///
    /// # Errors
    /// When it cannot be made or written, or is not empty.
    pub fn create(path: Option<&Path>) -> Result<Self, ReportError> {
        let path = path.map_or_else(next_free, Path::to_owned);
        let failed = |source| ReportError::Write { path: path.clone(), source };
        fs::create_dir_all(&path).map_err(failed)?;
        if fs::read_dir(&path).map_err(failed)?.next().is_some() {
            return Err(ReportError::NotEmpty(path));
        }
        let probe = path.join(".probe");
        fs::write(&probe, b"").map_err(failed)?;
        fs::remove_file(&probe).map_err(failed)?;
        Ok(Self { path })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes everything.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(
        &self,
        config: &str,
        summary: &Summary,
        timing: &Timing,
        records: &[DriveRecord],
    ) -> Result<(), ReportError> {
        self.file("config.toml", config.as_bytes())?;
        self.file("summary.json", pretty(summary)?.as_bytes())?;
        self.file("timing.json", pretty(timing)?.as_bytes())?;
        self.file("calls.jsonl", call_lines(records)?.as_bytes())?;
        for record in records {
            if let Ok(driven) = &record.outcome {
                self.drive(record, driven)?;
            }
        }
        Ok(())
    }

    /// Transcript and BEV maps of a drive.
    fn drive(&self, record: &DriveRecord, driven: &Driven) -> Result<(), ReportError> {
        if driven.calls.is_empty() {
            return Ok(());
        }
        let safe: String =
            record.scenario.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
        let folder = format!("{safe}-{}", record.challenge.short_name());
        self.folder(&format!("{folder}/bev"))?;
        for call in &driven.calls {
            if let Some(image) = &call.image {
                let path = self.path.join(format!("{folder}/bev/{:03}.png", call.iteration));
                image.save(&path).map_err(|source| ReportError::Image { path, source })?;
            }
        }
        let text =
            transcript(record, driven, |call| call.image.as_ref().map(|_| format!("bev/{:03}.png", call.iteration)));
        self.file(&format!("{folder}/transcript.md"), text.as_bytes())
    }

    fn folder(&self, name: &str) -> Result<(), ReportError> {
        let path = self.path.join(name);
        fs::create_dir_all(&path).map_err(|source| ReportError::Write { path, source })
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<(), ReportError> {
        let path = self.path.join(name);
        let write = || fs::File::create(&path).and_then(|mut file| file.write_all(bytes));
        write().map_err(|source| ReportError::Write { path: path.clone(), source })
    }
}

fn pretty(value: &impl serde::Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(value).map(|text| text + "\n")
}

fn call_lines(records: &[DriveRecord]) -> Result<String, serde_json::Error> {
    let mut lines = String::new();
    for record in records {
        for call in record.outcome.iter().flat_map(|driven| &driven.calls) {
            lines.push_str(&serde_json::to_string(&call_record(record, call))?);
            lines.push('\n');
        }
    }
    Ok(lines)
}

/// The first `runs/NNNN` that does not exist.
fn next_free() -> PathBuf {
    let runs = Path::new(RUNS);
    (1u32..)
        .map(|number| runs.join(format!("{number:04}")))
        .find(|path| !path.exists())
        .unwrap_or_else(|| runs.to_owned())
}
