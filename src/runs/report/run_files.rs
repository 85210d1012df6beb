//! The door to the folder of a run. The folder may come from elsewhere: its files are opened by
//! its handle and by the names of the layout, none through a link, and each up to its limit.

use super::error::{ReportError, ReportFault};
use super::file_names::SimulationName;
use super::layout::{MANIFEST, SIMULATIONS};
use super::limits::MAX_SIMULATIONS;
use planagent_files::OpenFolder;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Time of the last change and size of a file; none if it does not exist.
pub(super) type FileStamp = Option<(SystemTime, u64)>;

/// The folder of a run.
#[derive(Debug, Clone)]
pub(super) struct RunFiles {
    root: OpenFolder,
}

/// The folder of a simulation in a run. It is opened when it is read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimulationFolder {
    run: PathBuf,
    name: String,
}

impl RunFiles {
    /// Opens the folder that a user names, also through links.
    ///
    /// # Errors
    /// When there is no such folder.
    pub(super) fn open(path: &Path) -> Result<Self, ReportError> {
        let absent = |error: &io::Error| {
            matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory)
        };
        match OpenFolder::open(path) {
            Ok(root) => Ok(Self { root }),
            Err(error) if absent(&error) => Err(ReportError::at(path)(ReportFault::Absent)),
            Err(error) => Err(ReportError::read(path)(error)),
        }
    }

    pub(super) fn in_folder(root: OpenFolder) -> Self {
        Self { root }
    }

    pub(super) fn root(&self) -> &OpenFolder {
        &self.root
    }

    /// Whether a file of the run is there.
    ///
    /// # Errors
    /// When a link or something else stands in its place.
    pub(super) fn has(&self, name: &str) -> Result<bool, ReportError> {
        self.root
            .has_file(name)
            .map_err(ReportError::read(&self.root.path_of(name)))
    }

    /// The stamp of the manifest.
    pub(super) fn manifest_stamp(&self) -> FileStamp {
        self.root.stamp(MANIFEST)
    }

    /// The folder of the simulations; none for a run that has just started.
    pub(super) fn simulations(&self) -> Result<Option<OpenFolder>, ReportError> {
        let place = self.root.path_of(SIMULATIONS);
        let kind = self
            .root
            .kind(SIMULATIONS)
            .map_err(ReportError::read(&place))?;
        if kind.is_none() {
            return Ok(None);
        }
        let folder = self.root.subfolder(SIMULATIONS);
        folder.map(Some).map_err(ReportError::read(&place))
    }

    /// The folders of the completed simulations, by number. Names of another form are left alone.
    ///
    /// # Errors
    /// When there is no folder of simulations, or two have one number.
    pub(super) fn folders(&self) -> Result<BTreeMap<usize, SimulationFolder>, ReportError> {
        let place = self.root.path_of(SIMULATIONS);
        let Some(simulations) = self.simulations()? else {
            return Err(ReportError::read(&place)(ErrorKind::NotFound.into()));
        };
        let mut found: BTreeMap<usize, SimulationFolder> = BTreeMap::new();
        for name in simulations.names().map_err(ReportError::read(&place))? {
            let Some(name) = name.to_str().and_then(SimulationName::parse) else {
                continue;
            };
            let folder = SimulationFolder {
                run: self.root.path().to_owned(),
                name: name.as_str().to_owned(),
            };
            if let Some(other) = found.insert(name.number, folder) {
                return Err(ReportError::at(&place)(ReportFault::SameNumber {
                    first: other.name,
                    second: name.as_str().to_owned(),
                }));
            }
            if found.len() > MAX_SIMULATIONS {
                return Err(ReportError::at(&place)(ReportFault::TooMany {
                    what: "simulations",
                    limit: MAX_SIMULATIONS,
                }));
            }
        }
        Ok(found)
    }
}

impl SimulationFolder {
    /// The name of the folder.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The path of the folder, for messages.
    pub fn path(&self) -> PathBuf {
        self.run.join(SIMULATIONS).join(&self.name)
    }

    /// Opens the folder.
    ///
    /// # Errors
    /// When it is gone, or a link stands in its place or in that of a folder above it.
    pub(super) fn open(&self) -> Result<OpenFolder, ReportError> {
        let opened = OpenFolder::open(&self.run)
            .and_then(|run| run.subfolder(SIMULATIONS))
            .and_then(|simulations| simulations.subfolder(&self.name));
        opened.map_err(ReportError::read(&self.path()))
    }
}

/// Reads a TOML file of at most `max_bytes`.
pub(super) fn read_toml<T: DeserializeOwned>(
    folder: &OpenFolder,
    name: &str,
    max_bytes: u64,
) -> Result<T, ReportError> {
    let path = folder.path_of(name);
    let text = folder
        .read_text(name, max_bytes)
        .map_err(ReportError::read(&path))?;
    toml::from_str(&text).map_err(|error| ReportError::at(&path)(Box::new(error)))
}

/// Reads a file of at most `max_bytes`; none if there is none.
pub(super) fn read_present(
    folder: &OpenFolder,
    name: &str,
    max_bytes: u64,
) -> Result<Option<Vec<u8>>, ReportError> {
    let failed = |error| ReportError::read(&folder.path_of(name))(error);
    match folder.kind(name).map_err(failed)? {
        None => Ok(None),
        Some(_) => folder.read(name, max_bytes).map(Some).map_err(failed),
    }
}

/// A folder within another; none if nothing stands there.
pub(super) fn present_folder(
    folder: &OpenFolder,
    name: &str,
) -> Result<Option<OpenFolder>, ReportError> {
    let failed = |error| ReportError::read(&folder.path_of(name))(error);
    match folder.kind(name).map_err(failed)? {
        None => Ok(None),
        Some(_) => folder.subfolder(name).map(Some).map_err(failed),
    }
}

/// Writes a new file and waits until it is on the disk.
pub(super) fn write_synced(
    folder: &OpenFolder,
    name: &str,
    bytes: &[u8],
) -> Result<(), ReportError> {
    folder
        .write_new(name, bytes)
        .and_then(|file| file.sync_data())
        .map_err(ReportError::write(&folder.path_of(name)))
}
