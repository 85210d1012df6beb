//! A log of the sensor dataset to a drive.
//!
//! The steps are the annotated sweeps of the laser scanner, 10 a second. The ego's velocity is the slope of its position over
//! five of them. Coordinates are moved to an origin near the ego's first place, in whole metres.

use super::annotations::{Annotations, sweeps, track_count};
use super::error::{Argoverse2Error, LogFault};
use super::files::city_of;
use super::log::{Log, velocities_of};
use super::map::{lane_count, lane_map};
use super::map_file::MapFile;
use super::poses::{EgoPoses, heading};
use super::table::Table;
use super::{Contents, within};
use crate::geometry::{Pose, Vector};
use std::path::Path;

/// Nanoseconds in a second.
const NANOS_PER_SECOND: f64 = 1e9;

/// The files of a sensor log.
#[derive(Debug, Clone, Copy)]
pub(super) struct SensorFiles<'a> {
    /// Ego poses.
    pub(super) poses: &'a Path,
    /// Annotated boxes.
    pub(super) annotations: &'a Path,
    /// Vector map.
    pub(super) map: &'a Path,
}

/// Reads a log; `id` is the name of its folder.
///
/// # Errors
/// When a file is missing or unsound.
pub(super) fn log(files: SensorFiles<'_>, id: String) -> Result<Log, Argoverse2Error> {
    let poses = within(files.poses, EgoPoses::read(&Table::feather(files.poses)?))?;
    let table = Table::feather(files.annotations)?;
    let in_annotations = |fault| Argoverse2Error::Content { path: files.annotations.to_owned(), fault };
    let sweeps_ns = sweeps(&table).map_err(in_annotations)?;
    let egos = sweeps_ns.iter().map(|&time| poses.at(time)).collect::<Result<Vec<_>, LogFault>>();
    let egos = within(files.poses, egos)?;
    let first = egos.first().ok_or_else(|| in_annotations(LogFault::Empty))?.translation;
    let origin = Vector::new(first.x.round(), first.y.round());
    let annotations = Annotations::read(&table, &sweeps_ns, &egos, origin).map_err(in_annotations)?;
    let seconds = seconds(&sweeps_ns);
    let map = MapFile::read(files.map)?;
    let map = within(files.map, lane_map(&map, city_of(files.map).unwrap_or("city"), origin))?;
    let rear_axles: Vec<Pose> = egos
        .iter()
        .map(|ego| Pose::new(ego.translation.x - origin.x, ego.translation.y - origin.y, heading(ego)))
        .collect();
    let velocities = velocities_of(&seconds, &rear_axles);
    Ok(Log { id, objects: annotations.objects(&seconds), seconds, rear_axles, velocities, map })
}

/// What a log holds, without deriving anything.
///
/// # Errors
/// When a file is missing or no sound table or map.
pub(super) fn contents(files: SensorFiles<'_>) -> Result<Contents, Argoverse2Error> {
    let table = Table::feather(files.annotations)?;
    let sweeps_ns = within(files.annotations, sweeps(&table))?;
    let tracks = within(files.annotations, track_count(&table))?;
    Ok(Contents { seconds: seconds(&sweeps_ns), tracks, lanes: lane_count(&MapFile::read(files.map)?) })
}

/// Seconds from the first sweep.
fn seconds(sweeps_ns: &[i64]) -> Vec<f64> {
    let first = sweeps_ns.first().copied().unwrap_or(0);
    sweeps_ns.iter().map(|&time| time.saturating_sub(first) as f64 / NANOS_PER_SECOND).collect()
}
