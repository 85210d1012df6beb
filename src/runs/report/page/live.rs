//! The page of runs that may still be running. A simulation is read once, when its folder is
//! complete; the page asks for replays one by one.

use super::assets;
use super::index::{self, Index, Statistics};
use super::packed_json;
use super::simulation::{ReplayPart, SimulationParts};
use super::source::{RunSimulations, names};
use crate::report::error::{ReportError, ReportFault};
use crate::report::layout::{BEV, MANIFEST, METRICS, RECORD, REPLAY};
use crate::report::limits::MAX_RECORD_BYTES;
use crate::report::manifest::Manifest;
use crate::report::run_files::{FileStamp, RunFiles, SimulationFolder, present_folder, read_toml};
use crate::report::run_folder::RunFolder;
use crate::report::simulation_row::SimulationRow;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// The element that tells the scripts that a server has the data.
const MARK: &str = "<script type=\"text/plain\" id=\"live\"></script>\n";

/// A page that follows its runs.
#[derive(Debug)]
pub struct LivePage {
    runs: Vec<LiveRun>,
    /// Serial number of the next simulation that is read. A simulation that runs again gets another
    /// one.
    next: usize,
    /// Time when the page was opened, milliseconds since 1970: versions of two pages differ.
    opened: u128,
    changes: u64,
    state: Arc<LiveState>,
}

/// The data of a page at one moment.
#[derive(Debug, Default)]
pub struct LiveState {
    version: String,
    /// Index and statistics as gzip of JSON.
    index: Vec<u8>,
    /// Folders of the simulations with a replay, by serial number.
    folders: BTreeMap<usize, SimulationFolder>,
    simulations: usize,
    planned: usize,
}

/// A run with the simulations that were read.
#[derive(Debug)]
struct LiveRun {
    path: PathBuf,
    name: String,
    manifest: Manifest,
    manifest_stamp: FileStamp,
    known: BTreeMap<usize, Known>,
}

/// A simulation that was read, or could not be.
#[derive(Debug)]
struct Known {
    folder: SimulationFolder,
    stamp: FolderStamp,
    serial: usize,
    content: Result<(SimulationRow, SimulationParts), String>,
}

/// The stamps of record, metrics and replay: they change if the simulation runs again, or if a copy
/// of its folder goes on.
type FolderStamp = [FileStamp; 3];

/// A simulation folder that is new or has changed.
struct Unread {
    run: usize,
    number: usize,
    folder: SimulationFolder,
    stamp: FolderStamp,
}

/// The index of a live page.
#[derive(Serialize)]
struct LiveIndex<'a> {
    version: &'a str,
    #[serde(flatten)]
    index: &'a Index,
    statistics: Statistics,
    /// Simulations that cannot be read, each with its error.
    unreadable: Vec<&'a str>,
}

impl LivePage {
    /// Opens the page of runs. Calls `on_simulation(done, all)` after it has read a simulation.
    ///
    /// # Errors
    /// When a folder holds no run, or one of another format version.
    pub fn open(
        folders: &[PathBuf],
        on_simulation: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self, ReportError> {
        let runs = folders
            .iter()
            .zip(names(folders)?)
            .map(|(path, name)| LiveRun::open(path, name));
        let opened = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default()
            .as_millis();
        let mut page = Self {
            runs: runs.collect::<Result<_, _>>()?,
            next: 0,
            opened,
            changes: 0,
            state: Arc::new(LiveState::default()),
        };
        page.update(on_simulation)?;
        page.renew()?;
        Ok(page)
    }

    /// Reads what is new, and returns the present data.
    ///
    /// # Errors
    /// When a run cannot be read any more. The data stays then.
    pub fn refresh(&mut self) -> Result<Arc<LiveState>, ReportError> {
        if self.update(&|_, _| ())? {
            self.renew()?;
        }
        Ok(self.state())
    }

    /// The data at the last refresh.
    pub fn state(&self) -> Arc<LiveState> {
        Arc::clone(&self.state)
    }

    /// Whether a process works on one of the runs.
    pub(crate) fn is_running(&self) -> bool {
        self.runs.iter().any(|run| RunFolder::is_running(&run.path))
    }

    /// The page without data.
    pub fn html(&self) -> String {
        let names: Vec<&str> = self.runs.iter().map(|run| run.name.as_str()).collect();
        assets::page(&format!("PlanAgent: {}", names.join(", ")), MARK)
    }

    /// Reads new simulations and forgets those that are gone; returns whether there are any.
    fn update(
        &mut self,
        on_simulation: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<bool, ReportError> {
        let (mut changed, mut unread) = (false, Vec::new());
        for (place, run) in self.runs.iter_mut().enumerate() {
            changed |= run.update_manifest()?;
            changed |= run.list(place, &mut unread)?;
        }
        let (done, all) = (AtomicUsize::new(0), unread.len());
        // An unreadable simulation is kept with its error, so that one does not hide all others.
        let contents: Vec<_> = unread
            .par_iter()
            .map(|Unread { number, folder, .. }| {
                let content = read(*number, folder).map_err(|error| error.to_string());
                on_simulation(done.fetch_add(1, Ordering::Relaxed) + 1, all);
                content
            })
            .collect();
        for (
            Unread {
                run,
                number,
                folder,
                stamp,
            },
            content,
        ) in unread.into_iter().zip(contents)
        {
            if let Some(run) = self.runs.get_mut(run) {
                run.known.insert(
                    number,
                    Known {
                        folder,
                        stamp,
                        serial: self.next,
                        content,
                    },
                );
                self.next += 1;
            }
        }
        Ok(changed || all > 0)
    }

    /// Makes the data of what is known.
    fn renew(&mut self) -> Result<(), ReportError> {
        self.changes += 1;
        let runs: Vec<RunSimulations> = self.runs.iter().map(LiveRun::simulations).collect();
        let readable = || {
            self.runs
                .iter()
                .flat_map(|run| run.known.values())
                .filter(|known| known.content.is_ok())
        };
        let parts: Vec<SimulationParts> = readable()
            .filter_map(|known| known.content.as_ref().ok())
            .map(|(_, parts)| parts.clone())
            .collect();
        let mut index = Index::from_runs(&runs, &parts, |_| true);
        let mut with_replay = BTreeMap::new();
        for (entry, known) in index.simulations.iter_mut().zip(readable()) {
            if entry.absent.is_none() {
                (entry.replay, entry.map) = (Some(known.serial), Some(known.serial));
                entry.images = has_pictures(&known.folder).then_some(known.serial);
                with_replay.insert(known.serial, known.folder.clone());
            }
        }
        index.replays = with_replay.len();
        // Each renewal is a version of its own, so that a page mixes no two.
        let version = format!("{}-{}", self.opened, self.changes);
        let errors = self.runs.iter().flat_map(|run| run.known.values());
        let live = LiveIndex {
            version: &version,
            index: &index,
            statistics: index::statistics(&parts),
            unreadable: errors
                .filter_map(|known| Some(known.content.as_ref().err()?.as_str()))
                .collect(),
        };
        let place = self
            .runs
            .first()
            .map_or(Path::new(MANIFEST), |run| &run.path);
        let packed = packed_json(place, &live)?;
        self.state = Arc::new(LiveState {
            version,
            index: packed,
            folders: with_replay,
            simulations: parts.len(),
            planned: self
                .runs
                .iter()
                .map(|run| run.manifest.simulations())
                .fold(0, usize::saturating_add),
        });
        Ok(())
    }
}

impl LiveState {
    /// Changes with the data.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Index and statistics as gzip of JSON.
    pub fn index(&self) -> &[u8] {
        &self.index
    }

    /// Number of simulations that are shown, and that the runs consist of.
    pub fn counts(&self) -> (usize, usize) {
        (self.simulations, self.planned)
    }

    /// A part of a replay as gzip of JSON: `simulation-N`, `map-N` or `images-N`, with the numbers
    /// of the index. None if there is no such part.
    ///
    /// # Errors
    /// When its files cannot be read.
    pub fn part(&self, name: &str) -> Result<Option<Vec<u8>>, ReportError> {
        let Some((part, number)) = name.split_once('-') else {
            return Ok(None);
        };
        let part = match part {
            "simulation" => ReplayPart::Simulation,
            "map" => ReplayPart::Map,
            "images" => ReplayPart::Images,
            _ => return Ok(None),
        };
        let Some(folder) = number
            .parse()
            .ok()
            .and_then(|serial: usize| self.folders.get(&serial))
        else {
            return Ok(None);
        };
        part.read(folder)
    }
}

impl LiveRun {
    fn open(path: &Path, name: String) -> Result<Self, ReportError> {
        let files = RunFiles::open(path)?;
        let manifest_stamp = files.manifest_stamp();
        let manifest = RunFolder::manifest_in(&files)?;
        Ok(Self {
            path: path.to_owned(),
            name,
            manifest,
            manifest_stamp,
            known: BTreeMap::new(),
        })
    }

    /// Reads the manifest if it has changed: another run may take the place of this one.
    fn update_manifest(&mut self) -> Result<bool, ReportError> {
        let files = RunFiles::open(&self.path)?;
        let now = files.manifest_stamp();
        if now == self.manifest_stamp {
            return Ok(false);
        }
        self.manifest = RunFolder::manifest_in(&files)?;
        self.manifest_stamp = now;
        Ok(true)
    }

    /// Forgets simulations whose folders are gone, and lists those that are not known as they are
    /// now. Returns whether some are gone.
    fn list(&mut self, place: usize, unread: &mut Vec<Unread>) -> Result<bool, ReportError> {
        // A run that has just started has no such folder yet.
        let files = RunFiles::open(&self.path)?;
        let found = match files.simulations()? {
            Some(_) => files.folders()?,
            None => BTreeMap::new(),
        };
        let before = self.known.len();
        self.known
            .retain(|number, known| found.get(number) == Some(&known.folder));
        for (number, folder) in found {
            // A folder that cannot be opened says why when it is read.
            let open = folder.open().ok();
            let now = [RECORD, METRICS, REPLAY].map(|name| open.as_ref()?.stamp(name));
            if self
                .known
                .get(&number)
                .is_none_or(|known| known.stamp != now)
            {
                unread.push(Unread {
                    run: place,
                    number,
                    folder,
                    stamp: now,
                });
            }
        }
        Ok(self.known.len() < before)
    }

    /// The run with the simulations that could be read.
    fn simulations(&self) -> RunSimulations {
        let readable = || {
            self.known
                .iter()
                .filter_map(|(number, known)| Some((number, known, known.content.as_ref().ok()?)))
        };
        RunSimulations {
            name: self.name.clone(),
            manifest: self.manifest.clone(),
            rows: readable().map(|(_, _, (row, _))| row.clone()).collect(),
            folders: readable()
                .map(|(number, known, _)| (*number, known.folder.clone()))
                .collect(),
        }
    }
}

/// Row, statistics and sketch of a simulation.
fn read(
    number: usize,
    folder: &SimulationFolder,
) -> Result<(SimulationRow, SimulationParts), ReportError> {
    let open = folder.open()?;
    let path = open.path_of(RECORD);
    let row: SimulationRow = read_toml(&open, RECORD, MAX_RECORD_BYTES)?;
    if row.number != number {
        let (found, expected) = (row.identity(), format!("simulation {number}"));
        return Err(ReportError::at(&path)(ReportFault::WrongRecord {
            found,
            expected,
        }));
    }
    let parts = SimulationParts::read(folder, &row, false)?;
    Ok((row, parts))
}

fn has_pictures(folder: &SimulationFolder) -> bool {
    folder
        .open()
        .and_then(|open| present_folder(&open, BEV))
        .is_ok_and(|pictures| pictures.is_some())
}
