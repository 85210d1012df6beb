//! Logs of the sensor dataset.
//!
//! The steps are the annotated sweeps of the laser scanner, 10 per second. The ego's velocity is
//! the slope of its position over five of them. Coordinates have their origin near the ego's first
//! position, in whole meters.

use super::annotations::{Annotations, sweeps};
use super::error::{Argoverse2Error, LogFault};
use super::files::{SensorFiles, city_of};
use super::map::{lane_count, lane_map};
use super::map_file::MapFile;
use super::poses::{EgoPoses, heading};
use super::table::Table;
use crate::recording::motion::{self, slopes};
use crate::recording::window::{self, Recording, step_times};
use crate::{Contents, Scenario};
use planagent_world::geometry::{Pose, Vector};

/// The dataset's times are in nanoseconds.
const NANOS_PER_SECOND: f64 = 1e9;

pub(super) fn scenario(files: &SensorFiles, id: String) -> Result<Scenario, Argoverse2Error> {
    let SensorFiles {
        poses,
        annotations,
        map,
    } = files;
    let frames = EgoPoses::read(&Table::feather(poses)?).map_err(Argoverse2Error::at(poses))?;
    let table = Table::feather(annotations)?;
    let sweeps_ns = sweeps(&table).map_err(Argoverse2Error::at(annotations))?;
    let frames = sweeps_ns
        .iter()
        .map(|&time| frames.at(time))
        .collect::<Result<Vec<_>, LogFault>>();
    let frames = frames.map_err(Argoverse2Error::at(poses))?;
    let first = frames
        .first()
        .ok_or(LogFault::Empty)
        .map_err(Argoverse2Error::at(annotations))?
        .translation;
    // Whole meters, so that coordinates keep the decimals of the log.
    let origin = Vector::new(first.x.round(), first.y.round());
    let boxes = Annotations::read(&table, &sweeps_ns, &frames, origin)
        .map_err(Argoverse2Error::at(annotations))?;
    let seconds = seconds(&sweeps_ns);
    let city = city_of(map).unwrap_or("city");
    let map = lane_map(&MapFile::read(map)?, city, origin).map_err(Argoverse2Error::at(map))?;
    let rear_axles: Vec<Pose> = frames
        .iter()
        .map(|frame| {
            Pose::new(
                frame.translation.x - origin.x,
                frame.translation.y - origin.y,
                heading(frame),
            )
        })
        .collect();
    let velocities = slopes(
        &seconds,
        rear_axles.iter().map(|pose| pose.position().coords),
    );
    let times_us = step_times(&seconds).map_err(Argoverse2Error::at(annotations))?;
    let egos = motion::ego_states(&times_us, &seconds, &rear_axles, &velocities);
    let objects = boxes
        .objects(&seconds)
        .into_iter()
        .map(Into::into)
        .collect();
    Ok(Recording {
        log_name: id.clone(),
        id,
        map,
        egos,
        objects,
        lights: Vec::new(),
    }
    .scenario())
}

pub(super) fn contents(files: &SensorFiles) -> Result<Contents, Argoverse2Error> {
    let table = Table::feather(&files.annotations)?;
    let sweeps_ns = sweeps(&table).map_err(Argoverse2Error::at(&files.annotations))?;
    // The ego is one of the tracks.
    let tracks = table
        .distinct("track_uuid")
        .map_err(Argoverse2Error::at(&files.annotations))?;
    Ok(window::contents(
        &seconds(&sweeps_ns),
        tracks,
        lane_count(&MapFile::read(&files.map)?),
    ))
}

/// Times of the sweeps from the first, seconds.
fn seconds(sweeps_ns: &[i64]) -> Vec<f64> {
    let first = sweeps_ns.first().copied().unwrap_or(0);
    sweeps_ns
        .iter()
        .map(|&time| time.saturating_sub(first) as f64 / NANOS_PER_SECOND)
        .collect()
}
