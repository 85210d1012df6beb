//! `replay.json.gz`: everything that the page and the renders need to show a simulation without its
//! source.
//!
//! It holds the ego, the agents, the lights, the map nearby, the active plan of each iteration, and
//! the roll-outs of Reflection. Lengths are whole centimeters, angles milliradians, speeds cm/s,
//! all delta-coded (see [`deltas`]), in the map frame. Equal simulations give equal bytes.

mod deltas;
mod map;
mod outline;
mod record;
mod scene;
mod track;

pub(super) use map::DrawnMap;
pub(super) use outline::Sketch;
pub(super) use scene::{Moment, ReplayedSimulation};

use super::bounded::at_most;
use super::error::{ReportError, ReportFault};
use super::layout::REPLAY;
use super::limits::{
    MAX_ATTEMPTS, MAX_ITERATIONS, MAX_OBJECTS, MAX_REPLAY_BYTES, MAX_UNPACKED_BYTES,
};
use super::run_files::{read_present, write_synced};
use deltas::Points;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use map::ReplayMap;
use planagent_files::OpenFolder;
use serde::{Deserialize, Serialize};
use std::io::{self, ErrorKind, Read, Write};
use track::{AgentTrack, EgoTrack, LightTrack};

/// The format that this program reads and writes.
const FORMAT: u32 = 2;
/// Time between the points of plans and roll-outs, microseconds.
const PLAN_STEP_US: i64 = 500_000;
/// Points of plans and roll-outs: eight seconds, the horizon of nuPlan's planners.
const PLAN_POINTS: usize = 17;

/// A simulation as the page shows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Replay {
    /// [`FORMAT`].
    format: u32,
    /// Times of the samples since the first, whole milliseconds.
    times_ms: deltas::Deltas,
    /// The map along the path of the ego.
    map: ReplayMap,
    /// The ego.
    ego: EgoTrack,
    /// The recorded ego's rear axle, a point an iteration.
    expert: Points,
    /// All other objects.
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    agents: Vec<AgentTrack>,
    /// The lights.
    #[serde(deserialize_with = "at_most::<_, _, MAX_OBJECTS>")]
    lights: Vec<LightTrack>,
    /// The active plan of each iteration: rear axle, a point every half second, the present first.
    #[serde(deserialize_with = "at_most::<_, _, MAX_ITERATIONS>")]
    plans: Vec<Points>,
    /// Reflection's roll-outs by planning call.
    #[serde(deserialize_with = "at_most::<_, _, MAX_ITERATIONS>")]
    calls: Vec<CallTrack>,
}

/// The roll-outs of a planning call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CallTrack {
    /// The iteration of the call.
    iteration: usize,
    /// The roll-out of each attempt, in the form of [`Replay::plans`]; none for an attempt without
    /// reflection.
    #[serde(deserialize_with = "at_most::<_, _, MAX_ATTEMPTS>")]
    attempts: Vec<Option<Points>>,
}

impl Replay {
    /// Writes the file into the folder of a simulation.
    pub(super) fn write(&self, folder: &OpenFolder) -> Result<(), ReportError> {
        let path = folder.path_of(REPLAY);
        let text = serde_json::to_vec(self).map_err(ReportError::at(&path))?;
        let packed = packed(&text).map_err(ReportError::write(&path))?;
        write_synced(folder, REPLAY, &packed)
    }

    /// Reads the file in the folder of a simulation; none where there is no file.
    pub(super) fn read(folder: &OpenFolder) -> Result<Option<Self>, ReportError> {
        let path = folder.path_of(REPLAY);
        let Some(packed) = read_present(folder, REPLAY, MAX_REPLAY_BYTES)? else {
            return Ok(None);
        };
        let text = unpacked(&packed).map_err(ReportError::read(&path))?;
        drop(packed);
        let replay: Self = serde_json::from_slice(&text).map_err(ReportError::at(&path))?;
        if replay.format == FORMAT {
            Ok(Some(replay))
        } else {
            Err(ReportError::at(&path)(ReportFault::ReplayFormat(
                replay.format,
            )))
        }
    }

    /// Removes the map, which simulations of a scenario mostly share.
    pub(super) fn take_map(&mut self) -> ReplayMap {
        std::mem::take(&mut self.map)
    }
}

/// The text of a packed replay.
fn unpacked(packed: &[u8]) -> io::Result<Vec<u8>> {
    let mut text = Vec::new();
    let unpacking = GzDecoder::new(packed).take(MAX_UNPACKED_BYTES + 1);
    { unpacking }.read_to_end(&mut text)?;
    if text.len() as u64 > MAX_UNPACKED_BYTES {
        return Err(io::Error::new(
            ErrorKind::InvalidData,
            format!(
                "the replay has more than {MAX_UNPACKED_BYTES} bytes once unpacked, which is the limit"
            ),
        ));
    }
    Ok(text)
}

/// Bytes as gzip, without name and time.
pub(super) fn packed(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}
