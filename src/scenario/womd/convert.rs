//! A recording to a drive: what to keep, and in which coordinates.
//!
//! * Times are in whole microseconds from the first step.
//! * Coordinates are moved to an origin near the ego's first place, in whole metres; the map's name keeps it.
//! * What is driven is the window of `recording::window`.
//! * The goal is the last recorded pose, be it after the drive.

use super::error::RecordingFault;
use super::map::lane_map;
use super::proto;
use super::signals::lights;
use super::tracks::{ego_states, first_position, objects_at};
use crate::geometry::{Pose, Vector};
use crate::scenario::recording::route::route;
use crate::scenario::recording::window::{step_times, window};
use crate::scenario::{FUTURE_FRAMES, Frame, Scenario, UNKNOWN_TYPE};
use crate::world::Route;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Makes a drive of a recording.
///
/// # Errors
/// When the recording is too short, not at 10 Hz, contradicts itself, or has no lane.
pub(super) fn scenario(recording: &proto::Scenario, log_name: &str) -> Result<Scenario, RecordingFault> {
    let times_us = step_times(&recording.timestamps_seconds)?;
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
        scenario_type: UNKNOWN_TYPE.to_owned(),
        log_name: log_name.to_owned(),
        map,
        route,
        frames,
        start: window.start,
        future: egos[window.end..].iter().copied().take(FUTURE_FRAMES).collect(),
    })
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
