//! A scenario of the motion-forecasting dataset to a drive: `scenario_*.parquet`, 11 s at 10 Hz.
//!
//! * The recording car is the track `AV`. Its position is that of its own frame's origin, the rear axle: in bends it does not
//!   slide sideways. All others are told by the middle of their boxes.
//! * The dataset has no sizes. They are those of usual road users (table in [`RoadUser::of`]).
//! * Velocities are taken as recorded, the ego's too: its positions are smoothed, and run off within the first and last second
//!   of a scenario. Static kinds have no velocity, as in nuPlan.
//!
//! | Argoverse 2 | nuPlan |
//! |---|---|
//! | `vehicle`, `bus` | vehicle |
//! | `pedestrian` | pedestrian |
//! | `cyclist`, `motorcyclist`, `riderless_bicycle` | bicycle |
//! | `construction` | traffic cone |
//! | `static`, `background`, `unknown` | generic object |

use super::Contents;
use super::error::{Argoverse2Error, LogFault};
use super::log::Log;
use super::map::{lane_count, lane_map};
use super::map_file::MapFile;
use super::table::Table;
use super::within;
use crate::geometry::{OrientedBox, Pose, Vector, wrap_angle};
use crate::world::{ObjectKind, STEP_S, TrackToken, TrackedObject};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Id of the recording car's track.
const EGO: &str = "AV";
/// No scenario has more steps: an hour.
const MAX_STEPS: i64 = 36_000;
/// Speeds beyond this are no road user's, m/s.
const FASTEST: f64 = 200.0;

/// What a track is, and its assumed box, metres.
#[derive(Debug, Clone, Copy)]
struct RoadUser {
    kind: ObjectKind,
    length: f64,
    width: f64,
}

impl RoadUser {
    /// Reads an object type; `None` when the dataset has no such type.
    fn of(word: &str) -> Option<Self> {
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
        Some(Self { kind, length, width })
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
            .map(|(row, word)| RoadUser::of(&word).ok_or(LogFault::Category { column: "object_type", row, word }));
        let [x, y, heading] = [table.numbers("position_x")?, table.numbers("position_y")?, table.numbers("heading")?];
        let [east, north] = [speeds(table, "velocity_x")?, speeds(table, "velocity_y")?];
        let poses = (0..x.len()).map(|row| Pose::new(x[row], y[row], wrap_angle(heading[row])));
        Ok(Self {
            steps: steps(table)?,
            ids: table.words("track_id")?,
            kinds: kinds.collect::<Result<_, _>>()?,
            poses: poses.collect(),
            velocities: east.into_iter().zip(north).map(|(x, y)| Vector::new(x, y)).collect(),
            city: table.words("city")?.into_iter().next().unwrap_or_default(),
        })
    }
}

/// Steps of the rows, from 0.
fn steps(table: &Table) -> Result<Vec<usize>, LogFault> {
    let column = "timestep";
    let steps = table.integers(column)?;
    match steps.iter().position(|step| !(0..MAX_STEPS).contains(step)) {
        Some(row) => Err(LogFault::Unbelievable { column, row, value: steps[row] as f64 }),
        None => Ok(steps.into_iter().map(|step| step as usize).collect()),
    }
}

fn speeds(table: &Table, column: &'static str) -> Result<Vec<f64>, LogFault> {
    let speeds = table.numbers(column)?;
    match speeds.iter().position(|speed| speed.abs() > FASTEST) {
        Some(row) => Err(LogFault::Unbelievable { column, row, value: speeds[row] }),
        None => Ok(speeds),
    }
}

/// Seconds of all steps up to the last that a row names.
fn seconds(steps: &[usize]) -> Vec<f64> {
    (0..=steps.iter().copied().max().unwrap_or(0)).map(|step| step as f64 * STEP_S).collect()
}

/// Reads a scenario; `id` is the name of its folder.
///
/// # Errors
/// When a file is unsound.
pub(super) fn log(path: &Path, map: &Path, id: String) -> Result<Log, Argoverse2Error> {
    let tracks = within(path, Tracks::read(&Table::parquet(path)?))?;
    let seconds = seconds(&tracks.steps);
    let egos = within(path, ego_rows(&tracks, seconds.len()))?;
    let origin = egos.first().map_or_else(Vector::zeros, |&row| tracks.poses[row].position().coords.map(f64::round));
    let objects = within(path, objects(&tracks, seconds.len(), origin))?;
    let file = MapFile::read(map)?;
    let map = within(map, lane_map(&file, &tracks.city, origin))?;
    let rear_axles = egos.iter().map(|&row| moved(tracks.poses[row], origin)).collect();
    let velocities = egos.iter().map(|&row| tracks.velocities[row]).collect();
    Ok(Log { id, seconds, rear_axles, velocities, objects, map })
}

/// What a scenario holds, without deriving anything.
///
/// # Errors
/// When a file is no sound table or map.
pub(super) fn contents(path: &Path, map: &Path) -> Result<Contents, Argoverse2Error> {
    let table = Table::parquet(path)?;
    let steps = within(path, steps(&table))?;
    let tracks = within(path, table.words("track_id"))?.into_iter().collect::<BTreeSet<_>>().len();
    Ok(Contents { seconds: seconds(&steps), tracks, lanes: lane_count(&MapFile::read(map)?) })
}

fn moved(pose: Pose, origin: Vector) -> Pose {
    Pose::at(pose.position() - origin, pose.heading)
}

/// The ego's row at every step.
fn ego_rows(tracks: &Tracks, count: usize) -> Result<Vec<usize>, LogFault> {
    let mut rows: Vec<Option<usize>> = vec![None; count];
    for (row, track) in tracks.ids.iter().enumerate().filter(|(_, track)| *track == EGO) {
        if rows[tracks.steps[row]].replace(row).is_some() {
            return Err(LogFault::Twice { row, track: track.clone() });
        }
    }
    rows.into_iter().enumerate().map(|(step, row)| row.ok_or(LogFault::NoEgo { step })).collect()
}

/// The objects of every step, in order of track.
fn objects(tracks: &Tracks, count: usize, origin: Vector) -> Result<Vec<Vec<TrackedObject>>, LogFault> {
    let mut rows: BTreeMap<&str, BTreeMap<usize, usize>> = BTreeMap::new();
    for (row, track) in tracks.ids.iter().enumerate().filter(|(_, track)| *track != EGO) {
        if rows.entry(track).or_default().insert(tracks.steps[row], row).is_some() {
            return Err(LogFault::Twice { row, track: track.clone() });
        }
    }
    let mut objects: Vec<Vec<TrackedObject>> = vec![Vec::new(); count];
    for (number, track) in rows.into_values().enumerate() {
        for (step, row) in track {
            let RoadUser { kind, length, width } = tracks.kinds[row];
            objects[step].push(TrackedObject {
                token: TrackToken(number as u32),
                kind,
                shape: OrientedBox::new(moved(tracks.poses[row], origin), length, width),
                velocity: if kind.is_agent() { tracks.velocities[row] } else { Vector::zeros() },
            });
        }
    }
    Ok(objects)
}
