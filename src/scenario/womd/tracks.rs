//! The recorded ego and the objects around it at each step.
//!
//! * A state counts if it is flagged valid and its numbers are plausible. Any other state counts as
//!   not observed. A box needs a length and a width.
//! * nuPlan's vehicle replaces the recording car around the same box center, since all scores
//!   assume that vehicle.
//! * Short gaps of the ego are interpolated. Longer gaps, and gaps at either end, are an error.
//! * Waymo records no accelerations. They are slopes of the rear-axle velocity in the map frame
//!   (`recording::motion`).

use super::error::WomdFault;
use super::proto::{ObjectState, ObjectType, Track};
use crate::recording::motion::{self, MAX_BOX, MAX_COORDINATE, MAX_SPEED, slope};
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector, unwrap_angles, wrap_angle};
use planagent_world::{
    EgoState, MICROS_PER_SECOND, ObjectKind, PACIFICA, TrackToken, TrackedObject,
};
use std::sync::Arc;

/// Maximum gap of the ego that is interpolated, steps.
const MAX_EGO_GAP: usize = 5;

/// Way of an ego that stands, meters: positions jitter.
const MAX_STANDING_M: f64 = 2.0;

/// The center of a box and its velocity in the map frame.
#[derive(Debug, Clone, Copy)]
struct BoxState {
    center: Pose,
    velocity: Vector,
}

impl BoxState {
    fn from_state(state: &ObjectState, origin: Vector) -> Option<Self> {
        let center = Pose::new(
            state.center_x.unwrap_or(0.0) - origin.x,
            state.center_y.unwrap_or(0.0) - origin.y,
            f64::from(state.heading),
        );
        let velocity = Vector::new(
            f64::from(state.velocity_x.unwrap_or(0.0)),
            f64::from(state.velocity_y.unwrap_or(0.0)),
        );
        let sound = state.valid
            && center.is_finite()
            && center.position().coords.norm() < MAX_COORDINATE
            && center.heading.abs() < MAX_COORDINATE
            && velocity.norm() < MAX_SPEED;
        sound.then(|| Self {
            center: Pose {
                heading: wrap_angle(center.heading),
                ..center
            },
            velocity,
        })
    }

    fn between(self, other: Self, share: f64) -> Self {
        let turn = wrap_angle(other.center.heading - self.center.heading);
        let position =
            self.center.position() + (other.center.position() - self.center.position()) * share;
        Self {
            center: Pose::at(position, wrap_angle(self.center.heading + turn * share)),
            velocity: self.velocity.lerp(&other.velocity, share),
        }
    }
}

/// First valid position of the recording car, in recorded coordinates.
pub(super) fn first_position(track: &Track) -> Option<Point> {
    let seen = track
        .states
        .iter()
        .find_map(|state| BoxState::from_state(state, Vector::zeros()));
    seen.map(|state| state.center.position())
}

/// Checks that the ego's track has positions, and velocities where it moves. A writer of proto3
/// leaves out what is 0, so one field may be absent, but not all of them.
pub(super) fn check_ego_fields(track: &Track) -> Result<(), WomdFault> {
    let valid = || track.states.iter().filter(|state| state.valid);
    if valid().next().is_none() {
        // The error about the states says more.
        return Ok(());
    }
    let absent = |fields| {
        Err(WomdFault::NoEgoField {
            track: track.id,
            fields,
        })
    };
    if valid().all(|state| state.center_x.is_none() && state.center_y.is_none()) {
        return absent("center_x or center_y");
    }
    let position = |state: &ObjectState| {
        Point::new(state.center_x.unwrap_or(0.0), state.center_y.unwrap_or(0.0))
    };
    let moves = || {
        let (Some(first), Some(last)) = (valid().next(), valid().next_back()) else {
            return false;
        };
        (position(last) - position(first)).norm() > MAX_STANDING_M
    };
    if valid().all(|state| state.velocity_x.is_none() && state.velocity_y.is_none()) && moves() {
        return absent("velocity_x or velocity_y, and the ego moves");
    }
    Ok(())
}

/// The recorded ego, one state per step. Fails if it is missing for more than [`MAX_EGO_GAP`]
/// steps, or at either end.
pub(super) fn ego_states(
    track: &Track,
    times_us: &[i64],
    origin: Vector,
) -> Result<Vec<EgoState>, WomdFault> {
    let seen: Vec<Option<BoxState>> = track
        .states
        .iter()
        .map(|state| BoxState::from_state(state, origin))
        .collect();
    let boxes = fill_gaps(&seen, times_us)?;
    let seconds: Vec<f64> = times_us
        .iter()
        .map(|&t| t as f64 / MICROS_PER_SECOND)
        .collect();
    let headings = unwrap_angles(&boxes.iter().map(|s| s.center.heading).collect::<Vec<_>>());
    let to_axle = PACIFICA.rear_axle_to_center();
    // The rear axle of a turning car does not move sideways with the center of its box.
    let velocities: Vec<Vector> = boxes
        .iter()
        .enumerate()
        .map(|(i, s)| {
            s.velocity
                - s.center
                    .rotate(Vector::new(0.0, to_axle * slope(&seconds, &headings, i)))
        })
        .collect();
    let rear_axles: Vec<Pose> = boxes
        .iter()
        .map(|state| PACIFICA.rear_axle_of(state.center))
        .collect();
    Ok(motion::ego_states(
        times_us,
        &seconds,
        &rear_axles,
        &velocities,
    ))
}

fn fill_gaps(seen: &[Option<BoxState>], times_us: &[i64]) -> Result<Vec<BoxState>, WomdFault> {
    let mut filled: Vec<BoxState> = Vec::with_capacity(seen.len());
    let mut step = 0;
    while step < seen.len() {
        if let Some(state) = seen[step] {
            filled.push(state);
            step += 1;
            continue;
        }
        let missing = seen[step..].iter().take_while(|s| s.is_none()).count();
        let fault = WomdFault::EgoMissing { step, missing };
        let (Some(&before), Some(Some(after))) = (filled.last(), seen.get(step + missing)) else {
            return Err(fault);
        };
        if missing > MAX_EGO_GAP {
            return Err(fault);
        }
        let (from, to) = (times_us[step - 1], times_us[step + missing]);
        for &time in &times_us[step..step + missing] {
            filled.push(before.between(*after, (time - from) as f64 / (to - from) as f64));
        }
        step += missing;
    }
    Ok(filled)
}

/// Objects around the ego at a step, in order of track.
pub(super) fn objects_at(
    tracks: &[Track],
    ego: usize,
    step: usize,
    origin: Vector,
) -> Arc<[TrackedObject]> {
    let others = tracks
        .iter()
        .enumerate()
        .filter(|&(index, _)| index != ego)
        .map(|(_, track)| track);
    others
        .filter_map(|track| object(track, track.states.get(step)?, origin))
        .collect()
}

/// A state as nuPlan's object. Cyclists are bicycles. Other types are generic objects, which are
/// static in nuPlan: their velocity is zero.
fn object(track: &Track, state: &ObjectState, origin: Vector) -> Option<TrackedObject> {
    let BoxState { center, velocity } = BoxState::from_state(state, origin)?;
    let (length, width) = (f64::from(state.length), f64::from(state.width));
    let has_size = length > 0.0 && length < MAX_BOX && width > 0.0 && width < MAX_BOX;
    let kind = match ObjectType::try_from(track.object_type) {
        Ok(ObjectType::Vehicle) => ObjectKind::Vehicle,
        Ok(ObjectType::Pedestrian) => ObjectKind::Pedestrian,
        Ok(ObjectType::Cyclist) => ObjectKind::Bicycle,
        Ok(ObjectType::Other | ObjectType::Unset) | Err(_) => ObjectKind::GenericObject,
    };
    has_size.then(|| TrackedObject {
        token: TrackToken(track.id.cast_unsigned()),
        kind,
        shape: OrientedBox::new(center, length, width),
        velocity: if kind.is_agent() {
            velocity
        } else {
            Vector::zeros()
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Full circles of radius 20 m at 5 m/s.
    fn circling(steps: usize) -> (Track, Vec<i64>) {
        let states = (0..steps).map(|i| {
            let angle = 0.25 * i as f64 * 0.1;
            ObjectState {
                center_x: Some(20.0 * angle.cos()),
                center_y: Some(20.0 * angle.sin()),
                length: 4.8,
                width: 2.1,
                heading: wrap_angle(angle + std::f64::consts::FRAC_PI_2) as f32,
                velocity_x: Some((-5.0 * angle.sin()) as f32),
                velocity_y: Some((5.0 * angle.cos()) as f32),
                valid: true,
                ..ObjectState::default()
            }
        });
        let track = Track {
            id: 7,
            object_type: ObjectType::Vehicle as i32,
            states: states.collect(),
        };
        (track, (0..steps as i64).map(|i| i * 100_000).collect())
    }

    #[test]
    fn a_circle_has_its_centripetal_acceleration() {
        let (track, times) = circling(300);
        let states = ego_states(&track, &times, Vector::zeros()).unwrap();
        for state in &states[5..295] {
            assert!((state.velocity.x - 5.0).abs() < 1e-3, "{state:?}");
            assert!(
                (state.velocity.y + PACIFICA.rear_axle_to_center() * 0.25).abs() < 1e-3,
                "{state:?}"
            );
            // v²/r of the box center, less what the rear axle turns: 5 · 0.25, and d·ω² forward.
            assert!((state.acceleration.y - 1.25).abs() < 0.01, "{state:?}");
            assert!(
                (state.acceleration.x - PACIFICA.rear_axle_to_center() * 0.0625).abs() < 0.01,
                "{state:?}"
            );
        }
    }

    #[test]
    fn short_gaps_are_interpolated_and_long_ones_are_errors() {
        let (mut track, times) = circling(40);
        let whole = ego_states(&track, &times, Vector::zeros()).unwrap();
        for state in &mut track.states[10..15] {
            state.valid = false;
        }
        let bridged = ego_states(&track, &times, Vector::zeros()).unwrap();
        assert!(
            bridged
                .iter()
                .zip(&whole)
                .all(|(a, b)| a.rear_axle.distance(&b.rear_axle) < 0.1)
        );
        track.states[15].center_x = Some(f64::NAN);
        let fault = ego_states(&track, &times, Vector::zeros()).unwrap_err();
        assert!(
            matches!(
                fault,
                WomdFault::EgoMissing {
                    step: 10,
                    missing: 6
                }
            ),
            "{fault}"
        );
        let (mut track, times) = circling(40);
        track.states[39].valid = false;
        let fault = ego_states(&track, &times, Vector::zeros()).unwrap_err();
        assert!(
            matches!(
                fault,
                WomdFault::EgoMissing {
                    step: 39,
                    missing: 1
                }
            ),
            "{fault}"
        );
    }

    #[test]
    fn implausible_states_are_not_observed() {
        let (track, _) = circling(3);
        let mut tracks = vec![track.clone(), track];
        tracks[1].states[0].heading = f32::NAN;
        tracks[1].states[1].width = 0.0;
        assert!(objects_at(&tracks, 0, 0, Vector::zeros()).is_empty());
        assert!(objects_at(&tracks, 0, 1, Vector::zeros()).is_empty());
        assert_eq!(objects_at(&tracks, 0, 2, Vector::zeros()).len(), 1);
        tracks[1].object_type = ObjectType::Other as i32;
        let seen = objects_at(&tracks, 0, 2, Vector::zeros());
        assert_eq!(
            (seen[0].kind, seen[0].speed()),
            (ObjectKind::GenericObject, 0.0)
        );
    }
}
