//! The runs that a page is made of.

use crate::report::drive_row::DriveRow;
use crate::report::error::ReportError;
use crate::report::manifest::Manifest;
use crate::report::run_folder::{RunFolder, folders};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A run and its drives that have ended.
pub(super) struct RunDrives {
    /// Name of its folder.
    pub(super) name: String,
    /// What it is made of.
    pub(super) manifest: Manifest,
    /// Its drives by number.
    pub(super) rows: Vec<DriveRow>,
    /// Their folders by number.
    pub(super) folders: BTreeMap<usize, PathBuf>,
}

impl RunDrives {
    /// Reads a run's folder.
    ///
    /// # Errors
    /// When it holds no run or no drive, or a record cannot be read.
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        let manifest = RunFolder::manifest(path)?;
        let rows = RunFolder::ended(path)?.rows;
        if rows.is_empty() {
            return Err(ReportError::NoDrives(path.to_owned()));
        }
        let absolute = std::path::absolute(path).map_err(ReportError::read(path))?;
        let name = absolute.file_name().map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned());
        Ok(Self { name, manifest, rows, folders: folders(path)? })
    }

    /// A number of the configuration, by its dotted key.
    pub(super) fn setting(&self, key: &str) -> Option<f64> {
        let mut value = None;
        let mut table = Some(&self.manifest.config);
        for part in key.split('.') {
            value = table.and_then(|table| table.get(part));
            table = value.and_then(toml::Value::as_table);
        }
        value.and_then(|value| value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64)))
    }

    /// Name of the model, if one drove.
    pub(super) fn model(&self) -> Option<&str> {
        self.manifest.model.as_ref()?.get("name")?.as_str()
    }
}
