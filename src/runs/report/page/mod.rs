//! The page of runs: one HTML file with nuBoard's three views, Overview, Histograms and Scenarios.
//!
//! The page opens from the disk and makes no network request. It holds tables and replays as
//! compressed JSON, which the scripts in `assets/` draw.

mod assets;
mod comparison;
mod index;
mod live;
mod simulation;
mod source;

pub(crate) use super::layout::PAGE;
pub use live::{LivePage, LiveState};

use super::atomic;
use super::error::{ReportError, ReportFault};
use super::replay::packed;
use super::run_files::RunFiles;
use super::run_folder::write_in;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use index::{Absent, Index};
use rayon::prelude::*;
use serde::Serialize;
use simulation::SimulationParts;
use source::RunSimulations;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Default maximum size of a page, bytes: a browser opens it at once, and most mail servers accept
/// it.
pub(crate) const DEFAULT_MAX_BYTES: usize = 15_000_000;
/// Bytes that the element numbers of one simulation add to the packed index.
const NUMBERS_BYTES: usize = 8;

/// Settings of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageSettings {
    /// Maximum size, bytes. Scenarios whose replays do not fit have no replay, and the page says
    /// so.
    pub max_bytes: usize,
    /// Only replays of scenarios with this in their name; tables and histograms include all
    /// simulations.
    pub scenario: Option<String>,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self {
            max_bytes: DEFAULT_MAX_BYTES,
            scenario: None,
        }
    }
}

/// The contents of a page.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PageContents {
    pub page: PathBuf,
    /// Its size, bytes.
    pub bytes: usize,
    /// Simulations in its tables.
    pub simulations: usize,
    /// Simulations with a replay.
    pub replays: usize,
    /// Simulations whose run has no replay.
    pub without_replay: usize,
    /// Folders of simulations that are left out, because their files are damaged.
    pub damaged: Vec<PathBuf>,
    /// Why simulations have a row and no more: a file that cannot be read.
    pub unread: Vec<String>,
}

/// A page of the same look around a body of markup, without runs.
pub fn document(title: &str, body: &str) -> String {
    assets::document(title, body)
}

/// Writes a page of one or more runs to `out`, or, without it, as [`PAGE`] into the folder of the
/// first; a link of that name is replaced, because a run may come from elsewhere. Calls
/// `on_simulation(done, all)` after it has read a simulation.
pub fn write(
    folders: &[PathBuf],
    out: Option<&Path>,
    settings: &PageSettings,
    on_simulation: &(dyn Fn(usize, usize) + Sync),
) -> Result<PageContents, ReportError> {
    let (runs, damaged) = RunSimulations::read_all(folders)?;
    let page_of_first = || folders.first().map_or(PAGE.into(), |run| run.join(PAGE));
    let place = &out.map_or_else(page_of_first, Path::to_owned);
    let wanted = |scenario: &str| {
        settings
            .scenario
            .as_ref()
            .is_none_or(|part| scenario.contains(part.as_str()))
    };
    let scenarios = || {
        runs.iter()
            .flat_map(|run| &run.rows)
            .map(|row| row.scenario.as_str())
    };
    if let Some(part) = &settings.scenario
        && !scenarios().any(wanted)
    {
        let place = folders.first().unwrap_or(place);
        let known: BTreeSet<&str> = scenarios().collect();
        let known = known.into_iter().map(str::to_owned).collect();
        return Err(ReportError::at(place)(ReportFault::NoScenario {
            part: part.clone(),
            known,
        }));
    }
    let done = AtomicUsize::new(0);
    let simulations: Vec<_> = runs
        .iter()
        .flat_map(|run| run.rows.iter().map(move |row| (run, row)))
        .collect();
    let all = simulations.len();
    let read: Vec<(SimulationParts, Option<String>)> = simulations
        .par_iter()
        .map(|(run, row)| {
            let folder = &run.folders[&row.number];
            let parts = SimulationParts::read(folder, row, wanted(&row.scenario));
            on_simulation(done.fetch_add(1, Ordering::Relaxed) + 1, all);
            // A file that cannot be read costs the replay of its simulation, not the page.
            parts.map_or_else(
                |error| (SimulationParts::none(), Some(error.to_string())),
                |parts| (parts, None),
            )
        })
        .collect();
    let (parts, unread): (Vec<_>, Vec<_>) = read.into_iter().unzip();
    let mut index = Index::from_runs(&runs, &parts, wanted);
    let data = data(place, &mut index, &parts, settings.max_bytes)?;
    let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
    let page = assets::page(&format!("PlanAgent: {}", names.join(", ")), &data);
    match (out, folders.first()) {
        (None, Some(run)) => write_in(RunFiles::open(run)?.root(), PAGE, page.as_bytes())?,
        _ => atomic::write(place, page.as_bytes())?,
    }
    let without_replay = index
        .simulations
        .iter()
        .filter(|simulation| simulation.absent == Some(Absent::Run))
        .count();
    Ok(PageContents {
        page: place.clone(),
        bytes: page.len(),
        simulations: all,
        replays: index.replays,
        without_replay,
        damaged,
        unread: unread.into_iter().flatten().collect(),
    })
}

/// The data elements of the page; sets the element numbers in the index.
fn data(
    out: &Path,
    index: &mut Index,
    parts: &[SimulationParts],
    max_bytes: usize,
) -> Result<String, ReportError> {
    let statistics = element(
        "statistics",
        &text_of(&packed_json(out, &index::statistics(parts))?),
    );
    let numberless = text_of(&packed_json(out, index)?);
    let taken = assets::size() + statistics.len() + numberless.len() + NUMBERS_BYTES * parts.len();
    let mut elements = Elements {
        text: statistics,
        left: max_bytes.saturating_sub(taken),
    };
    add_replays(index, parts, &mut elements);
    add_images(index, parts, &mut elements);
    index.replays = index
        .simulations
        .iter()
        .filter(|simulation| simulation.replay.is_some())
        .count();
    elements
        .text
        .push_str(&element("index", &text_of(&packed_json(out, index)?)));
    Ok(elements.text)
}

/// Data elements within a size limit.
struct Elements {
    text: String,
    left: usize,
}

impl Elements {
    /// Adds `more` if it fits, and returns whether it did.
    fn add(&mut self, more: &str) -> bool {
        let fits = more.len() <= self.left;
        if fits {
            self.left -= more.len();
            self.text.push_str(more);
        }
        fits
    }
}

/// Adds the replays of whole scenarios, so that all planners of a scenario can be compared.
fn add_replays(index: &mut Index, parts: &[SimulationParts], elements: &mut Elements) {
    let mut first: BTreeMap<&str, usize> = BTreeMap::new();
    let mut scenarios: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, simulation) in index.simulations.iter().enumerate() {
        scenarios
            .entry(*first.entry(&simulation.summary.id).or_insert(i))
            .or_default()
            .push(i);
    }
    let mut maps: BTreeMap<&str, usize> = BTreeMap::new();
    for simulations in scenarios.into_values() {
        // A copy of the maps: a scenario that does not fit leaves nothing behind.
        let (mut added, mut known) = (String::new(), maps.clone());
        let mut places = Vec::new();
        for i in simulations.iter().copied() {
            let Some(replay) = &parts[i].replay else {
                continue;
            };
            let next = known.len();
            let map = *known.entry(&replay.map).or_insert(next);
            if map == next {
                added.push_str(&element(&format!("map-{map}"), &replay.map));
            }
            added.push_str(&element(&format!("simulation-{i}"), &replay.simulation));
            places.push((i, map));
        }
        if elements.add(&added) {
            maps = known;
            for (i, map) in places {
                index.simulations[i].replay = Some(i);
                index.simulations[i].map = Some(map);
            }
        } else {
            for (i, _) in places {
                index.simulations[i].absent = Some(Absent::Size);
            }
        }
    }
}

/// Adds the model's images to the replays of the page.
fn add_images(index: &mut Index, parts: &[SimulationParts], elements: &mut Elements) {
    for (i, (simulation, part)) in index.simulations.iter_mut().zip(parts).enumerate() {
        let images = part
            .replay
            .as_ref()
            .and_then(|replay| replay.images.as_ref());
        if let Some(images) = images.filter(|_| simulation.replay.is_some())
            && elements.add(&element(&format!("images-{i}"), images))
        {
            simulation.images = Some(i);
        }
    }
}

/// A value as gzip of JSON; `place` is for the error.
fn packed_json(place: &Path, value: &impl Serialize) -> Result<Vec<u8>, ReportError> {
    let json = serde_json::to_vec(value).map_err(ReportError::at(place))?;
    packed(&json).map_err(ReportError::write(place))
}

/// Packed bytes as text for an element: base64.
fn text_of(packed: &[u8]) -> String {
    STANDARD.encode(packed)
}

fn element(id: &str, text: &str) -> String {
    format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n")
}
