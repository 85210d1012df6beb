//! Cache of maps by location: each is read once in a process.

use super::database::Database;
use super::error::{FileFault, NuPlanError};
use super::lane_map::{self, NuPlanMap};
use super::schema::MAPS_INDEX;
use super::side_index;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The map file in the folder of a version.
const MAP_FILE: &str = "map.gpkg";

type Slot = Arc<Mutex<Option<Arc<NuPlanMap>>>>;

/// The maps of a maps folder, and the indices of the logs that use them.
#[derive(Debug)]
pub struct MapStore {
    root: Option<PathBuf>,
    indices: side_index::SideIndices,
    maps: Mutex<BTreeMap<String, Slot>>,
    /// Map files that exist, by location.
    checked: Mutex<BTreeMap<String, PathBuf>>,
    notes: Mutex<BTreeSet<String>>,
    /// Agents without a velocity in the frames that were read, by log.
    without_velocity: Mutex<BTreeMap<PathBuf, usize>>,
}

impl MapStore {
    /// The maps below `NUPLAN_MAPS_ROOT`; nothing is read before a scenario asks for it. Indices of
    /// logs go to `$PLANAGENT_CACHE`, else to the platform's cache folder.
    pub fn new(root: Option<PathBuf>) -> Self {
        Self::with_cache(root, side_index::default_folder())
    }

    /// As [`Self::new`], with the folder for the indices of logs.
    pub fn with_cache(root: Option<PathBuf>, cache: Option<PathBuf>) -> Self {
        Self {
            root,
            indices: side_index::SideIndices::new(cache),
            maps: Mutex::default(),
            checked: Mutex::default(),
            notes: Mutex::default(),
            without_velocity: Mutex::default(),
        }
    }

    /// The map of a location, as `us-ma-boston`.
    pub fn map(&self, location: &str) -> Result<Arc<NuPlanMap>, NuPlanError> {
        let slot = lock(&self.maps)
            .entry(location.to_owned())
            .or_default()
            .clone();
        // Other threads that need this map wait here until it is read.
        let mut slot = lock(&slot);
        if let Some(map) = &*slot {
            return Ok(map.clone());
        }
        let (path, version) = self.file(location)?;
        let (map, notes) = lane_map::read(&path, location, &version)?;
        lock(&self.notes).extend(notes);
        let map = Arc::new(map);
        *slot = Some(map.clone());
        Ok(map)
    }

    /// Checks that the map of a location exists, without reading it; gives its file.
    pub fn check(&self, location: &str) -> Result<PathBuf, NuPlanError> {
        if let Some(path) = lock(&self.checked).get(location) {
            return Ok(path.clone());
        }
        let (path, _) = self.file(location)?;
        lock(&self.checked).insert(location.to_owned(), path.clone());
        Ok(path)
    }

    /// Notes for the user about the maps and logs that were opened since the last call, in
    /// alphabetical order.
    pub fn take_notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = std::mem::take(&mut *lock(&self.notes))
            .into_iter()
            .collect();
        let derived = std::mem::take(&mut *lock(&self.without_velocity));
        notes.extend(derived.into_iter().map(|(log, count)| {
            format!(
                "{}: {count} states of agents have no velocity; it is derived from their positions",
                log.display()
            )
        }));
        notes
    }

    /// Counts the agents of a log whose velocity was derived.
    pub(super) fn count_without_velocity(&self, log: &Path, count: usize) {
        if count > 0 {
            *lock(&self.without_velocity)
                .entry(log.to_owned())
                .or_default() += count;
        }
    }

    /// Provides indices for the rows of a log between two times, µs.
    pub(super) fn attach_index(
        &self,
        log: &Database,
        times: (i64, i64),
    ) -> Result<side_index::LogIndex, NuPlanError> {
        let found = self.indices.attach(log, times)?;
        lock(&self.notes).extend(found.note.clone());
        Ok(found)
    }

    /// The file of a location and its version.
    fn file(&self, location: &str) -> Result<(PathBuf, String), NuPlanError> {
        let root = self.root.as_deref().ok_or(NuPlanError::NoMapsRoot)?;
        let index = root.join(MAPS_INDEX);
        let text = planagent_files::read_text(&index, planagent_files::MAX_LIST_BYTES)
            .map_err(|source| NuPlanError::file(&index, FileFault::NoMapsIndex(source)))?;
        let wrong = |reason: String| NuPlanError::file(&index, FileFault::MapsIndex(reason));
        let known: BTreeMap<String, Value> = serde_json::from_str(&text)
            .map_err(|error| wrong(format!("not a JSON object: {error}")))?;
        let Some(entry) = known.get(location) else {
            let (location, known) = (location.to_owned(), known.into_keys().collect());
            return Err(NuPlanError::file(
                index,
                FileFault::UnknownLocation { location, known },
            ));
        };
        let version = entry.get("version").and_then(Value::as_str);
        let version = version
            .ok_or_else(|| wrong(format!("`{location}` has no version")))?
            .to_owned();
        let path = root.join(location).join(&version).join(MAP_FILE);
        if path.is_file() {
            Ok((path, version))
        } else {
            let found = versions_in(&root.join(location));
            Err(NuPlanError::file(path, FileFault::MissingMap { found }))
        }
    }
}

/// A poisoned lock means that a reader of another map panicked; the stored values are complete.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn versions_in(location: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(location).into_iter().flatten().flatten();
    let mut found: Vec<String> = entries
        .filter(|entry| entry.path().join(MAP_FILE).is_file())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    found.sort();
    found
}
