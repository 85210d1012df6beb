//! The folder of a benchmark: `metadata.json`, `rows.jsonl`, and at the end `figures.json` and
//! `table.md`.

use crate::bench::Row;
use planagent_files::{MAX_LIST_BYTES, read_text};
use planagent_runs::report::atomic;
use planagent_runs::report::{ReportError, ReportFault, check_writable};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

const METADATA: &str = "metadata.json";
const ROWS: &str = "rows.jsonl";
const FIGURES: &str = "figures.json";
const TABLE: &str = "table.md";

/// Settings and machine of a benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchMetadata {
    /// Version of the program.
    pub planagent: String,
    /// Commit of the build, with `-dirty` for uncommitted changes; `None` if unknown.
    pub commit: Option<String>,
    /// Start time: `YYYY.MM.DD.hh.mm.ss`, UTC.
    pub started: String,
    pub command: Vec<String>,
    /// The system's name of the processor.
    pub cpu: String,
    /// Memory of the machine, bytes; `None` where the system does not report it.
    pub memory: Option<u64>,
    /// Settings that a resumed benchmark must share.
    pub settings: serde_json::Map<String, serde_json::Value>,
}

/// The folder of a benchmark. All rows of a model are written together. The folder exists from the
/// first model on that could be measured, so a benchmark that fails leaves none.
#[derive(Debug)]
pub struct BenchFolder {
    path: PathBuf,
    metadata: BenchMetadata,
    rows: Vec<Row>,
}

impl BenchFolder {
    /// The folder of a new benchmark.
    ///
    /// # Errors
    /// When the folder is not empty or cannot be written.
    pub fn create(path: &Path, metadata: &BenchMetadata) -> Result<Self, ReportError> {
        check_writable(path)?;
        if path.exists()
            && fs::read_dir(path)
                .map_err(ReportError::read(path))?
                .next()
                .is_some()
        {
            return Err(ReportError::at(path)(ReportFault::NotEmpty));
        }
        Ok(Self {
            path: path.to_owned(),
            metadata: metadata.clone(),
            rows: Vec::new(),
        })
    }

    /// Opens the folder of a benchmark to resume it; `now` has the current settings.
    ///
    /// # Errors
    /// When the folder does not exist, or the settings differ.
    pub fn resume(path: &Path, now: &BenchMetadata) -> Result<Self, ReportError> {
        let then: BenchMetadata = read_json(&path.join(METADATA))?;
        let differences: Vec<String> = now
            .settings
            .iter()
            .filter(|(key, value)| then.settings.get(*key) != Some(value))
            .map(|(key, value)| {
                let before = then
                    .settings
                    .get(key)
                    .map_or_else(|| "none".to_owned(), ToString::to_string);
                format!("{key}: was {before}, is {value}")
            })
            .collect();
        if !differences.is_empty() {
            return Err(ReportError::at(path)(ReportFault::Differs(differences)));
        }
        let file = path.join(ROWS);
        // Failed models run again.
        let rows = if file.is_file() {
            Self::read(path)?
        } else {
            Vec::new()
        };
        let rows: Vec<Row> = rows
            .into_iter()
            .filter(|row| !matches!(row, Row::Failed(_)))
            .collect();
        Ok(Self {
            path: path.to_owned(),
            metadata: then,
            rows,
        })
    }

    pub fn read(path: &Path) -> Result<Vec<Row>, ReportError> {
        let file = path.join(ROWS);
        parse_rows(
            &file,
            &read_text(&file, MAX_LIST_BYTES).map_err(ReportError::read(&file))?,
        )
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Names of the completed models.
    pub fn done(&self) -> BTreeSet<&str> {
        self.rows.iter().map(Row::model).collect()
    }

    /// Whether a model could be measured.
    pub fn has_measurements(&self) -> bool {
        self.rows.iter().any(|row| !matches!(row, Row::Failed(_)))
    }

    pub fn commit(&mut self, rows: &[Row]) -> Result<(), ReportError> {
        self.rows.extend_from_slice(rows);
        if !self.has_measurements() {
            return Ok(());
        }
        let metadata = self.path.join(METADATA);
        if !metadata.is_file() {
            atomic::folder(&self.path)?;
            atomic::write_within(&metadata, &json(&self.path, &self.metadata)?)?;
        }
        let mut text = Vec::new();
        for row in &self.rows {
            serde_json::to_writer(&mut text, row).map_err(ReportError::at(&self.path))?;
            text.push(b'\n');
        }
        atomic::write_within(&self.path.join(ROWS), &text)
    }

    pub fn finish(&self, figures: &impl Serialize, table: &str) -> Result<(), ReportError> {
        if !self.has_measurements() {
            return Ok(());
        }
        atomic::write_within(&self.path.join(FIGURES), &json(&self.path, figures)?)?;
        atomic::write_within(&self.path.join(TABLE), table.as_bytes())
    }
}

fn json(place: &Path, value: &impl Serialize) -> Result<Vec<u8>, ReportError> {
    let mut text = serde_json::to_vec_pretty(value).map_err(ReportError::at(place))?;
    text.push(b'\n');
    Ok(text)
}

fn read_json(path: &Path) -> Result<BenchMetadata, ReportError> {
    let text = read_text(path, MAX_LIST_BYTES).map_err(ReportError::read(path))?;
    serde_json::from_str(&text).map_err(ReportError::at(path))
}

fn parse_rows(path: &Path, text: &str) -> Result<Vec<Row>, ReportError> {
    serde_json::Deserializer::from_str(text)
        .into_iter()
        .collect::<Result<_, _>>()
        .map_err(ReportError::at(path))
}
