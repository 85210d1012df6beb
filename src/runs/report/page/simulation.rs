//! The parts of one simulation: statistics for the histograms and, packed, the replay with calls
//! and time series.

use super::{packed_json, text_of};
use crate::report::call_record::{CallRecord, calls_in};
use crate::report::error::ReportError;
use crate::report::key::{CompactParts, KeyTable};
use crate::report::layout::{BEV, bev_name};
use crate::report::limits::MAX_IMAGE_BYTES;
use crate::report::picture::is_picture;
use crate::report::replay::{Replay, Sketch};
use crate::report::run_files::{SimulationFolder, present_folder, read_present};
use crate::report::simulation_folder;
use crate::report::simulation_row::SimulationRow;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use planagent_files::OpenFolder;
use planagent_score::metrics::{MetricResult, Statistic};
use serde::Serialize;
use serde_json::{Map, Value};

/// The parts of a simulation.
#[derive(Debug, Clone)]
pub(super) struct SimulationParts {
    /// Statistics with metric and category.
    pub(super) statistics: Vec<(String, &'static str, Statistic)>,
    /// The replay, if it exists and was requested.
    pub(super) replay: Option<PackedReplay>,
    /// The recorded ego's path; none if the run has no replay.
    pub(super) sketch: Option<Sketch>,
}

/// A replay as base64 of gzip of JSON.
#[derive(Debug, Clone)]
pub(super) struct PackedReplay {
    /// Tracks, planning calls and time series.
    pub(super) simulation: String,
    /// The map, which simulations of a scenario share.
    pub(super) map: String,
    /// The model's images by iteration; none if there are none.
    pub(super) images: Option<String>,
}

/// A part of a replay that a page asks a server for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ReplayPart {
    /// Tracks, planning calls and time series.
    Simulation,
    /// The map.
    Map,
    /// The model's images by iteration.
    Images,
}

/// The content of [`ReplayPart::Simulation`].
#[derive(Serialize)]
struct SimulationReplay<'a> {
    replay: &'a Replay,
    calls: &'a [CallRecord],
    series: Vec<Series<'a>>,
    /// The key to the compact texts of the calls; empty without such texts.
    key: Vec<KeyTable>,
}

/// A metric's time series with its bounds.
#[derive(Serialize)]
struct Series<'a> {
    metric: &'a str,
    unit: &'a str,
    values: Vec<Option<f64>>,
    frames: Option<&'a [usize]>,
    low: Option<f64>,
    high: Option<f64>,
}

impl SimulationParts {
    /// Those of a simulation that failed, or whose files cannot be read.
    pub(super) fn none() -> Self {
        Self {
            statistics: Vec::new(),
            replay: None,
            sketch: None,
        }
    }

    /// Reads the folder of a simulation, with its replay if `wants_replay`.
    pub(super) fn read(
        folder: &SimulationFolder,
        row: &SimulationRow,
        wants_replay: bool,
    ) -> Result<Self, ReportError> {
        if row.error.is_some() {
            return Ok(Self::none());
        }
        let folder = &folder.open()?;
        let metrics = simulation_folder::metrics(folder)?;
        let replay = Replay::read(folder)?;
        let sketch = replay.as_ref().map(Replay::sketch);
        let replay = match replay.filter(|_| wants_replay) {
            Some(replay) => Some(packed(folder, replay, &metrics)?),
            None => None,
        };
        let of_metric = |metric: MetricResult| {
            let (name, category) = (metric.name, metric.category.as_str());
            metric
                .statistics
                .into_iter()
                .map(move |statistic| (name.clone(), category, statistic))
        };
        Ok(Self {
            statistics: metrics.into_iter().flat_map(of_metric).collect(),
            replay,
            sketch,
        })
    }
}

impl ReplayPart {
    /// The part of the replay in the folder of a simulation, as gzip of JSON; none if the run has
    /// no replay.
    pub(super) fn read(self, folder: &SimulationFolder) -> Result<Option<Vec<u8>>, ReportError> {
        let folder = &folder.open()?;
        let place = folder.path();
        if self == Self::Images {
            return packed_json(place, &images(folder, &calls_in(folder)?)?).map(Some);
        }
        let Some(mut replay) = Replay::read(folder)? else {
            return Ok(None);
        };
        let map = replay.take_map();
        if self == Self::Map {
            return packed_json(place, &map).map(Some);
        }
        simulation(
            folder,
            &replay,
            &calls_in(folder)?,
            &simulation_folder::metrics(folder)?,
        )
        .map(Some)
    }
}

fn packed(
    folder: &OpenFolder,
    mut replay: Replay,
    metrics: &[MetricResult],
) -> Result<PackedReplay, ReportError> {
    let map = text_of(&packed_json(folder.path(), &replay.take_map())?);
    let calls = calls_in(folder)?;
    let images = images(folder, &calls)?;
    let simulation = text_of(&simulation(folder, &replay, &calls, metrics)?);
    let images = if images.is_empty() {
        None
    } else {
        Some(text_of(&packed_json(folder.path(), &images)?))
    };
    Ok(PackedReplay {
        simulation,
        map,
        images,
    })
}

/// [`ReplayPart::Simulation`] of a replay without its map.
fn simulation(
    folder: &OpenFolder,
    replay: &Replay,
    calls: &[CallRecord],
    metrics: &[MetricResult],
) -> Result<Vec<u8>, ReportError> {
    let series = metrics.iter().filter_map(Series::from_metric).collect();
    let key = CompactParts::seen_in(calls).tables();
    packed_json(
        folder.path(),
        &SimulationReplay {
            replay,
            calls,
            series,
            key,
        },
    )
}

impl<'a> Series<'a> {
    fn from_metric(metric: &'a MetricResult) -> Option<Self> {
        let series = metric.time_series.as_ref()?;
        let (low, high) =
            planagent_score::metrics::metric(&metric.name).map_or((None, None), |spec| spec.bounds);
        Some(Self {
            metric: &metric.name,
            unit: &series.unit,
            values: series
                .values
                .iter()
                .map(|&value| four_digits(value))
                .collect(),
            frames: series.selected_frames.as_deref(),
            low,
            high,
        })
    }
}

/// Largest number of a chart: axes of larger ones would overflow.
const MAX_SHOWN: f64 = 1e12;

/// A number with four digits, more than a chart shows; none if it is not finite or wild.
pub(super) fn four_digits(value: f64) -> Option<f64> {
    // Also false for NaN.
    if value.abs() <= MAX_SHOWN {
        format!("{value:.3e}").parse().ok()
    } else {
        None
    }
}

/// The images of the calls as base64, by iteration. What is no picture is left out.
fn images(folder: &OpenFolder, calls: &[CallRecord]) -> Result<Map<String, Value>, ReportError> {
    let mut images = Map::new();
    let Some(pictures) = present_folder(folder, BEV)? else {
        return Ok(images);
    };
    for iteration in calls.iter().map(|call| call.iteration) {
        let bytes = read_present(&pictures, &bev_name(iteration), MAX_IMAGE_BYTES)?;
        if let Some(bytes) = bytes.filter(|bytes| is_picture(bytes)) {
            images.insert(iteration.to_string(), STANDARD.encode(bytes).into());
        }
    }
    Ok(images)
}
