//! Scenarios of the motion-forecasting dataset: `scenario_*.parquet`, 11 s at 10 Hz.
//!
//! * The recording car is the track `AV`. Its position is the origin of its frame, the rear axle,
//!   since it does not move sideways in bends. The positions of other tracks are the centers of
//!   their boxes.
//! * The dataset has no sizes. They are those of typical road users ([`RoadUser::from_word`]).
//! * Velocities are those recorded, also the ego's: its positions are smoothed and drift within the
//!   first and last second of a scenario. Static kinds have no velocity, as in nuPlan.

use super::error::{Argoverse2Error, LogFault};
use super::map::{lane_count, lane_map};
use super::map_file::MapFile;
use super::table::{Table, in_range};
use crate::recording::motion::{self, MAX_SPEED};
use crate::recording::window::{self, Recording, step_times};
use crate::{Contents, Scenario};
use planagent_world::geometry::{OrientedBox, Pose, Vector, wrap_angle};
use planagent_world::{ObjectKind, STEP_S, TrackToken, TrackedObject};
use std::collections::BTreeMap;
use std::path::Path;

/// Id of the recording car's track.
const EGO: &str = "AV";
/// Maximum number of steps: an hour.
const MAX_STEPS: i64 = 36_000;

/// Kind and assumed box of a track, meters.
#[derive(Debug, Clone, Copy)]
struct RoadUser {
    kind: ObjectKind,
    length: f64,
    width: f64,
}

impl RoadUser {
    /// By object type; `None` if unknown.
    fn from_word(word: &str) -> Option<Self> {
        let (kind, length, width) = match word {
            "vehicle" => (ObjectKind::Vehicle, 4.6, 2.0),
            "bus" => (ObjectKind::Vehicle, 12.0, 2.6),
            "pedestrian" => (ObjectKind::Pedestrian, 0.7, 0.7),
            "cyclist" | "riderless_bicycle" => (ObjectKind::Bicycle, 1.8, 0.6),
            "motorcyclist" => (ObjectKind::Bicycle, 2.1, 0.8),
            "construction" => (ObjectKind::TrafficCone, 0.5, 0.5),
            "static" | "background" | "unknown" => (ObjectKind::GenericObject, 0.5, 0.5),
            _ => return None,
        };
        Some(Self {
            kind,
            length,
            width,
        })
    }
}

/// The table, column by column.
struct Tracks {
    steps: Vec<usize>,
    ids: Vec<String>,
    kinds: Vec<RoadUser>,
    poses: Vec<Pose>,
    velocities: Vec<Vector>,
    city: String,
}

impl Tracks {
    fn read(table: &Table) -> Result<Self, LogFault> {
        let kinds = table
            .words("object_type")?
            .into_iter()
            .enumerate()
            .map(|(row, word)| {
                RoadUser::from_word(&word).ok_or(LogFault::Category {
                    column: "object_type",
                    row,
                    word,
                })
            });
        let [x, y, heading] = [
            table.numbers("position_x")?,
            table.numbers("position_y")?,
            table.numbers("heading")?,
        ];
        let [east, north] = [speeds(table, "velocity_x")?, speeds(table, "velocity_y")?];
        let poses = (0..x.len()).map(|row| Pose::new(x[row], y[row], wrap_angle(heading[row])));
        // A column at a time: Parquet stores columns, and a missing one is named before any row is
        // read.
        Ok(Self {
            steps: steps(table)?,
            ids: table.words("track_id")?,
            kinds: kinds.collect::<Result<_, _>>()?,
            poses: poses.collect(),
            velocities: east
                .into_iter()
                .zip(north)
                .map(|(x, y)| Vector::new(x, y))
                .collect(),
            city: table.words("city")?.into_iter().next().unwrap_or_default(),
        })
    }
}

/// Steps of the rows.
fn steps(table: &Table) -> Result<Vec<usize>, LogFault> {
    let column = "timestep";
    let steps = table.integers(column)?;
    match steps.iter().position(|step| !(0..MAX_STEPS).contains(step)) {
        Some(row) => Err(LogFault::OutOfRange {
            column,
            row,
            value: steps[row] as f64,
        }),
        None => Ok(steps.into_iter().map(|step| step as usize).collect()),
    }
}

fn speeds(table: &Table, column: &'static str) -> Result<Vec<f64>, LogFault> {
    in_range(column, table.numbers(column)?, |speed| {
        speed.abs() <= MAX_SPEED
    })
}

/// Times of all steps up to the last one of a row, seconds.
fn seconds(steps: &[usize]) -> Vec<f64> {
    (0..=steps.iter().copied().max().unwrap_or(0))
        .map(|step| step as f64 * STEP_S)
        .collect()
}

/// Opens a scenario; `id` is the name of its folder.
pub(super) fn scenario(path: &Path, map: &Path, id: String) -> Result<Scenario, Argoverse2Error> {
    let tracks = Tracks::read(&Table::parquet(path)?).map_err(Argoverse2Error::at(path))?;
    let seconds = seconds(&tracks.steps);
    let egos = ego_rows(&tracks, seconds.len()).map_err(Argoverse2Error::at(path))?;
    let origin = egos.first().map_or_else(Vector::zeros, |&row| {
        tracks.poses[row].position().coords.map(f64::round)
    });
    let objects = objects(&tracks, seconds.len(), origin).map_err(Argoverse2Error::at(path))?;
    let map =
        lane_map(&MapFile::read(map)?, &tracks.city, origin).map_err(Argoverse2Error::at(map))?;
    let rear_axles: Vec<Pose> = egos
        .iter()
        .map(|&row| moved(tracks.poses[row], origin))
        .collect();
    let velocities: Vec<Vector> = egos.iter().map(|&row| tracks.velocities[row]).collect();
    let times_us = step_times(&seconds).map_err(Argoverse2Error::at(path))?;
    let egos = motion::ego_states(&times_us, &seconds, &rear_axles, &velocities);
    let objects = objects.into_iter().map(Into::into).collect();
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

pub(super) fn contents(path: &Path, map: &Path) -> Result<Contents, Argoverse2Error> {
    let table = Table::parquet(path)?;
    let steps = steps(&table).map_err(Argoverse2Error::at(path))?;
    let tracks = table
        .distinct("track_id")
        .map_err(Argoverse2Error::at(path))?;
    Ok(window::contents(
        &seconds(&steps),
        tracks,
        lane_count(&MapFile::read(map)?),
    ))
}

fn moved(pose: Pose, origin: Vector) -> Pose {
    Pose::at(pose.position() - origin, pose.heading)
}

/// Row of the ego at every step.
fn ego_rows(tracks: &Tracks, count: usize) -> Result<Vec<usize>, LogFault> {
    let mut rows: Vec<Option<usize>> = vec![None; count];
    for (row, track) in tracks
        .ids
        .iter()
        .enumerate()
        .filter(|(_, track)| *track == EGO)
    {
        if rows[tracks.steps[row]].replace(row).is_some() {
            return Err(LogFault::Twice {
                row,
                track: track.clone(),
            });
        }
    }
    rows.into_iter()
        .enumerate()
        .map(|(step, row)| row.ok_or(LogFault::NoEgo { step }))
        .collect()
}

/// Objects of every step in order of track.
fn objects(
    tracks: &Tracks,
    count: usize,
    origin: Vector,
) -> Result<Vec<Vec<TrackedObject>>, LogFault> {
    // Tracks are numbered in the order of their names, so a token does not depend on the order of
    // rows.
    let mut rows: BTreeMap<&str, BTreeMap<usize, usize>> = BTreeMap::new();
    for (row, track) in tracks
        .ids
        .iter()
        .enumerate()
        .filter(|(_, track)| *track != EGO)
    {
        if rows
            .entry(track)
            .or_default()
            .insert(tracks.steps[row], row)
            .is_some()
        {
            return Err(LogFault::Twice {
                row,
                track: track.clone(),
            });
        }
    }
    let mut objects: Vec<Vec<TrackedObject>> = vec![Vec::new(); count];
    for (number, track) in rows.into_values().enumerate() {
        for (step, row) in track {
            let RoadUser {
                kind,
                length,
                width,
            } = tracks.kinds[row];
            objects[step].push(TrackedObject {
                token: TrackToken(number as u32),
                kind,
                shape: OrientedBox::new(moved(tracks.poses[row], origin), length, width),
                velocity: if kind.is_agent() {
                    tracks.velocities[row]
                } else {
                    Vector::zeros()
                },
            });
        }
    }
    Ok(objects)
}
