//! A recording to a drive: what to keep, and in which coordinates.
//!
//! * Times are in whole microseconds from the first step.
//! * Coordinates are moved to an origin near the ego's first place, in whole metres; the map's name keeps it.
//! * The drive begins at the first step with 2 s of history (1 s when the recording is shorter than 12 s) and lasts to the end of
//!   the recording, at most 15 s; the steps before it are kept as history.
//! * The goal is the last recorded pose, be it after the drive.

use super::error::RecordingFault;
use super::map::lane_map;
use super::proto;
use super::route::route;
use super::signals::lights;
use super::tracks::{ego_states, first_position, objects_at};
use crate::geometry::{Pose, Vector};
use crate::scenario::{FUTURE_FRAMES, Frame, Scenario};
use crate::world::{MICROS_PER_SECOND, Route};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Recordings shorter than this spend less on history, s.
const LONG_RECORDING: f64 = 12.0;
/// History of a long recording, s.
const LONG_HISTORY: f64 = 2.0;
/// History of a short recording, s.
const SHORT_HISTORY: f64 = 1.0;
/// Longest drive, s: nuPlan's scenario duration.
const LONGEST_DRIVE: f64 = 15.0;
/// Half a step, s: recorded times jitter.
const HALF_STEP: f64 = 0.05;
/// Steps of the shortest recording that can be driven: a second of history and a second of driving.
const FEWEST_STEPS: usize = 21;

/// Makes a drive of a recording.
///
/// # Errors
/// When the recording is too short, not at 10 Hz, contradicts itself, or has no lane.
pub(super) fn scenario(recording: &proto::Scenario, log_name: &str) -> Result<Scenario, RecordingFault> {
    let times_us = times(&recording.timestamps_seconds)?;
    check_tracks(recording, times_us.len())?;
    let index = recording.sdc_track_index;
    let no_ego = RecordingFault::NoEgoTrack { index, tracks: recording.tracks.len() };
    let ego_index = usize::try_from(index).map_err(|_| no_ego.clone())?;
    let ego_track = recording.tracks.get(ego_index).ok_or(no_ego)?;
    let missing = RecordingFault::EgoMissing { step: 0, missing: times_us.len() };
    let origin: Vector = first_position(ego_track).ok_or(missing)?.coords.map(f64::round);
    let egos = ego_states(ego_track, &times_us, origin)?;
    let map = Arc::new(lane_map(&recording.map_features, &recording.dynamic_map_states, origin)?);
    let window = window(&times_us);
    let mut lights = lights(&map, &recording.dynamic_map_states, window.end, origin).into_iter();
    let frames: Vec<Frame> = egos[..window.end]
        .iter()
        .enumerate()
        .map(|(step, &ego)| Frame {
            ego,
            objects: objects_at(&recording.tracks, ego_index, step, origin),
            lights: lights.next().unwrap_or_default(),
        })
        .collect();
    let centers: Vec<Pose> = egos[window.start..].iter().map(crate::world::EgoState::center).collect();
    let route = Route { roadblocks: route(&map, &centers), goal: egos.last().map(|ego| ego.rear_axle) };
    Ok(Scenario {
        id: recording.scenario_id.clone(),
        scenario_type: "unknown".to_owned(),
        log_name: log_name.to_owned(),
        map,
        route,
        frames,
        start: window.start,
        future: egos[window.end..].iter().copied().take(FUTURE_FRAMES).collect(),
    })
}

/// Microseconds from the first step.
fn times(seconds: &[f64]) -> Result<Vec<i64>, RecordingFault> {
    /// Steps may be this much apart, s.
    const STEP_RANGE: std::ops::RangeInclusive<f64> = 0.05..=0.15;
    if seconds.len() < FEWEST_STEPS {
        return Err(RecordingFault::TooShort { steps: seconds.len(), needed: FEWEST_STEPS });
    }
    let odd = seconds.windows(2).position(|pair| !STEP_RANGE.contains(&(pair[1] - pair[0])));
    if let Some(step) = odd {
        return Err(RecordingFault::StepTime { step: step + 1, seconds: seconds[step + 1] - seconds[step] });
    }
    Ok(seconds.iter().map(|t| ((t - seconds[0]) * MICROS_PER_SECOND).round() as i64).collect())
}

fn check_tracks(recording: &proto::Scenario, steps: usize) -> Result<(), RecordingFault> {
    let mut ids = BTreeSet::new();
    for track in &recording.tracks {
        if !ids.insert(track.id) {
            return Err(RecordingFault::DuplicateId { layer: "track", id: i64::from(track.id) });
        }
        if track.states.len() != steps {
            return Err(RecordingFault::TrackLength { track: track.id, states: track.states.len(), steps });
        }
    }
    Ok(())
}

/// The steps that are driven; those before are history.
pub(super) fn window(times_us: &[i64]) -> std::ops::Range<usize> {
    let seconds = |step: usize| times_us.get(step).map_or(0.0, |&t| t as f64 / MICROS_PER_SECOND);
    let duration = seconds(times_us.len().saturating_sub(1));
    let history = if duration < LONG_RECORDING { SHORT_HISTORY } else { LONG_HISTORY };
    let first = |after: f64| (0..times_us.len()).find(|&step| seconds(step) >= after).unwrap_or(times_us.len());
    let start = first(history - HALF_STEP);
    start..first(seconds(start) + LONGEST_DRIVE + HALF_STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(count: i64) -> Vec<i64> {
        (0..count).map(|i| i * 100_000).collect()
    }

    #[test]
    fn windows_are_cut_as_documented() {
        assert_eq!(window(&steps(91)), 10..91);
        assert_eq!(window(&steps(120)), 10..120);
        assert_eq!(window(&steps(121)), 20..121);
        assert_eq!(window(&steps(199)), 20..171);
        assert_eq!(window(&steps(21)), 10..21);
    }

    #[test]
    fn only_ten_hertz_is_taken() {
        let mut seconds: Vec<f64> = (0..30).map(|i| 5.0 + f64::from(i) * 0.1).collect();
        assert_eq!(times(&seconds).unwrap()[29], 2_900_000);
        seconds[7] = f64::NAN;
        assert!(matches!(times(&seconds), Err(RecordingFault::StepTime { step: 7, .. })));
        seconds[7] = seconds[6];
        assert!(matches!(times(&seconds), Err(RecordingFault::StepTime { step: 7, .. })));
        assert_eq!(times(&seconds[..20]), Err(RecordingFault::TooShort { steps: 20, needed: 21 }));
    }
}
