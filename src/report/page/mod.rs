//! The page of runs: one HTML file with nuBoard's three views, Overview, Histograms and Scenarios. It opens from the disk and
//! asks nothing of the network. Tables and replays lie in it as compressed JSON; the scripts beside this file draw them.

mod assets;
mod index;
mod simulation;
mod source;

use super::atomic;
use super::error::ReportError;
use super::replay::packed;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use index::{Absent, Index};
use rayon::prelude::*;
use serde::Serialize;
use simulation::SimulationParts;
use source::RunSimulations;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most bytes of a page unless told otherwise: what a browser opens without a wait, and a mail may carry.
pub const MOST_BYTES: usize = 15_000_000;
/// Bytes by which naming its elements lengthens the packed index, a drive.
const NAMES_BYTES: usize = 8;
/// Name of the page in the folder of its run.
pub const PAGE: &str = "report.html";

/// What goes into a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageSettings {
    /// Most bytes of the page: replays that do not fit in are left out, whole scenarios at a time, and the page says so.
    pub most_bytes: usize,
    /// Only replays of scenarios that have this in their name; tables and histograms are always of all drives.
    pub scenario: Option<String>,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self { most_bytes: MOST_BYTES, scenario: None }
    }
}

/// What a page holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PageContents {
    /// Where it is.
    pub page: PathBuf,
    /// Its size.
    pub bytes: usize,
    /// Drives in its tables.
    pub simulations: usize,
    /// Drives that can be watched.
    pub replays: usize,
    /// Drives whose run kept no replay.
    pub without_replay: usize,
}

/// Writes a page of runs to `out`; several runs are compared. `on_simulation(done, all)` is called after each drive that was read.
///
/// # Errors
/// When a folder holds no run or no drive, a file of it cannot be read, or the page cannot be written.
pub fn write(
    runs: &[PathBuf],
    out: &Path,
    settings: &PageSettings,
    on_simulation: &(dyn Fn(usize, usize) + Sync),
) -> Result<PageContents, ReportError> {
    let runs = RunSimulations::read_all(runs)?;
    let wanted = |scenario: &str| settings.scenario.as_ref().is_none_or(|part| scenario.contains(part.as_str()));
    if let Some(part) = &settings.scenario
        && !runs.iter().flat_map(|run| &run.rows).any(|row| wanted(&row.scenario))
    {
        return Err(ReportError::NoScenario(part.clone()));
    }
    let done = AtomicUsize::new(0);
    let all = runs.iter().map(|run| run.rows.len()).sum();
    let simulations: Vec<(usize, usize)> =
        runs.iter().enumerate().flat_map(|(r, run)| (0..run.rows.len()).map(move |i| (r, i))).collect();
    let parts: Vec<SimulationParts> = simulations
        .par_iter()
        .map(|&(run, i)| {
            let (run, row) = (&runs[run], &runs[run].rows[i]);
            let parts = SimulationParts::read(&run.folders[&row.number], row, wanted(&row.scenario))?;
            on_simulation(done.fetch_add(1, Ordering::Relaxed) + 1, all);
            Ok(parts)
        })
        .collect::<Result<_, ReportError>>()?;
    let mut index = Index::of(&runs, &parts, wanted);
    let data = data(&mut index, &parts, settings.most_bytes)?;
    let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
    let page = assets::page(&format!("PlanAgent: {}", names.join(", ")), &data);
    atomic::write(out, page.as_bytes())?;
    let without_replay = index.simulations.iter().filter(|simulation| simulation.absent == Some(Absent::Run)).count();
    Ok(PageContents {
        page: out.to_owned(),
        bytes: page.len(),
        simulations: all,
        replays: index.replays,
        without_replay,
    })
}

/// The data elements of the page; the index says what of it is there.
fn data(index: &mut Index, parts: &[SimulationParts], most_bytes: usize) -> Result<String, ReportError> {
    let statistics = element("statistics", &text(&index::statistics(parts))?);
    let taken = assets::size() + statistics.len() + text(index)?.len() + NAMES_BYTES * parts.len();
    let mut elements = Elements { text: statistics, left: most_bytes.saturating_sub(taken) };
    add_replays(index, parts, &mut elements);
    add_images(index, parts, &mut elements);
    index.replays = index.simulations.iter().filter(|simulation| simulation.replay.is_some()).count();
    elements.text.push_str(&element("index", &text(index)?));
    Ok(elements.text)
}

/// Data elements within a number of bytes.
struct Elements {
    text: String,
    left: usize,
}

impl Elements {
    /// Adds what still fits; says whether it did.
    fn add(&mut self, more: &str) -> bool {
        let fits = more.len() <= self.left;
        if fits {
            self.left -= more.len();
            self.text.push_str(more);
        }
        fits
    }
}

/// Adds the replays, scenario by scenario: who compares planners wants all of them or none.
fn add_replays(index: &mut Index, parts: &[SimulationParts], elements: &mut Elements) {
    let mut first: BTreeMap<&str, usize> = BTreeMap::new();
    let mut scenarios: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, simulation) in index.simulations.iter().enumerate() {
        scenarios.entry(*first.entry(&simulation.scenario).or_insert(i)).or_default().push(i);
    }
    let mut maps: BTreeMap<&str, usize> = BTreeMap::new();
    for simulations in scenarios.into_values() {
        let (mut added, mut known) = (String::new(), maps.clone());
        let mut places = Vec::new();
        for i in simulations.iter().copied() {
            let Some(replay) = &parts[i].replay else { continue };
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

/// Adds the pictures that the model saw to the replays that are there.
fn add_images(index: &mut Index, parts: &[SimulationParts], elements: &mut Elements) {
    for (i, (simulation, part)) in index.simulations.iter_mut().zip(parts).enumerate() {
        let images = part.replay.as_ref().and_then(|replay| replay.images.as_ref());
        if let Some(images) = images.filter(|_| simulation.replay.is_some())
            && elements.add(&element(&format!("images-{i}"), images))
        {
            simulation.images = Some(i);
        }
    }
}

/// A value as the page unpacks it: base64 of gzip of JSON.
fn text(value: &impl Serialize) -> Result<String, ReportError> {
    let bytes = packed(&serde_json::to_vec(value)?).map_err(serde_json::Error::io)?;
    Ok(STANDARD.encode(bytes))
}

fn element(id: &str, text: &str) -> String {
    format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n")
}
