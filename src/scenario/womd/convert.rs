//! Converts a recording to a scenario.
//!
//! * Times are whole microseconds from the first step.
//! * Coordinates have their origin near the ego's first position, in whole meters. The map's name
//!   keeps the origin.
//! * The simulated part is the window of `recording::window`.

use super::error::WomdFault;
use super::map::lane_map;
use super::proto;
use super::signals::lights;
use super::tracks::{check_ego_fields, ego_states, first_position, objects_at};
use crate::Scenario;
use crate::recording::error::RecordingFault;
use crate::recording::window::{Recording, step_times, window};
use planagent_world::geometry::Vector;
use std::collections::BTreeSet;

/// Converts a recording. Fails if it is too short, not at 10 Hz, contradicts itself, or has no
/// lane.
pub(super) fn scenario(recording: &proto::Scenario, log_name: &str) -> Result<Scenario, WomdFault> {
    let times_us = step_times(&recording.timestamps_seconds)?;
    check_tracks(recording, times_us.len())?;
    let index = recording.sdc_track_index.ok_or(WomdFault::NoEgoIndex)?;
    let ego_index = usize::try_from(index).unwrap_or(usize::MAX);
    let ego_track = recording
        .tracks
        .get(ego_index)
        .ok_or(WomdFault::NoEgoTrack {
            index,
            tracks: recording.tracks.len(),
        })?;
    check_ego_fields(ego_track)?;
    let missing = WomdFault::EgoMissing {
        step: 0,
        missing: times_us.len(),
    };
    let origin: Vector = first_position(ego_track)
        .ok_or(missing)?
        .coords
        .map(f64::round);
    let egos = ego_states(ego_track, &times_us, origin)?;
    let map = lane_map(
        &recording.map_features,
        &recording.dynamic_map_states,
        origin,
    )?;
    // Objects after the window would be converted and then dropped.
    let steps = window(&times_us).end;
    let recording = Recording {
        id: recording.scenario_id.clone(),
        log_name: log_name.to_owned(),
        objects: (0..steps)
            .map(|step| objects_at(&recording.tracks, ego_index, step, origin))
            .collect(),
        lights: lights(&map, &recording.dynamic_map_states, steps, origin),
        egos,
        map,
    };
    Ok(recording.scenario())
}

fn check_tracks(recording: &proto::Scenario, steps: usize) -> Result<(), WomdFault> {
    let mut ids = BTreeSet::new();
    for track in &recording.tracks {
        if !ids.insert(track.id) {
            return Err(RecordingFault::DuplicateId {
                layer: "track",
                id: i64::from(track.id),
            }
            .into());
        }
        if track.states.len() != steps {
            return Err(WomdFault::TrackLength {
                track: track.id,
                states: track.states.len(),
                steps,
            });
        }
    }
    Ok(())
}
