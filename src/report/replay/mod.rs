//! `replay.json.gz` of a drive's folder: what it takes to look at the drive again, without the source that it came from. The
//! ego, everything around it, the lights, the map nearby, the plan in force at each iteration, and the roll-outs that Reflection
//! judged.
//!
//! Lengths are whole centimetres, angles milliradians, speeds cm/s, all delta-coded (see [`deltas`]), in the map frame. The same
//! drive gives the same bytes.

mod deltas;
mod map;
mod record;
mod scene;
mod track;

pub(super) use scene::{Moment, ReplayedSimulation};

use super::atomic;
use super::error::ReportError;
use deltas::Points;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use map::ReplayMap;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use track::{AgentTrack, EgoTrack, LightTrack};

/// Name of the file.
pub(super) const REPLAY: &str = "replay.json.gz";
/// Which form of the file this program writes and reads.
const FORM: u32 = 1;
/// Most bytes of a replay once unpacked: far more than any drive takes, and less than memory.
const MOST_BYTES: u64 = 256 << 20;
/// Plans and roll-outs are kept every half second,
const PLAN_STEP_US: i64 = 500_000;
/// for eight seconds: as far as nuPlan's planners plan.
const PLAN_POINTS: usize = 17;

/// A drive, ready to be looked at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Replay {
    /// Form of the file.
    form: u32,
    /// Times of the samples since the first, whole milliseconds.
    times_ms: deltas::Deltas,
    /// The map along the drive.
    map: ReplayMap,
    /// The ego.
    ego: EgoTrack,
    /// The recorded ego's rear axle, a point an iteration.
    expert: Points,
    /// Everything else.
    agents: Vec<AgentTrack>,
    /// The lights.
    lights: Vec<LightTrack>,
    /// The plan in force at each iteration: rear axle, a point every half second, the present first.
    plans: Vec<Points>,
    /// What Reflection rolled out, call by call.
    calls: Vec<CallTrack>,
}

/// The roll-outs of a planning call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CallTrack {
    /// At which iteration.
    iteration: usize,
    /// For each attempt what Reflection judged, as in [`Replay::plans`]; none for an attempt that it did not see.
    attempts: Vec<Option<Points>>,
}

impl Replay {
    /// Writes the file into a drive's folder.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(super) fn write(&self, folder: &Path) -> Result<(), ReportError> {
        let path = folder.join(REPLAY);
        atomic::create(&path, &packed(&serde_json::to_vec(self)?).map_err(ReportError::write(&path))?)
    }

    /// Reads the file of a drive's folder; none where an earlier version made the drive.
    ///
    /// # Errors
    /// When it cannot be read or understood.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>, ReportError> {
        let path = folder.join(REPLAY);
        if !path.is_file() {
            return Ok(None);
        }
        let file = File::open(&path).map_err(ReportError::read(&path))?;
        let mut text = String::new();
        GzDecoder::new(file).take(MOST_BYTES).read_to_string(&mut text).map_err(ReportError::read(&path))?;
        let replay: Self =
            serde_json::from_str(&text).map_err(|source| ReportError::ParseJson { path: path.clone(), source })?;
        if replay.form == FORM { Ok(Some(replay)) } else { Err(ReportError::ReplayForm { path, form: replay.form }) }
    }

    /// The map, taken out: the drives of a scenario mostly share it.
    pub(super) fn take_map(&mut self) -> ReplayMap {
        std::mem::take(&mut self.map)
    }
}

/// Bytes as gzip, without name and time.
pub(super) fn packed(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}
