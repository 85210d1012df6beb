//! Tracks to frames: the recorded ego and the objects around it, step by step.
//!
//! * A state counts when it is flagged valid and all its numbers are finite and near Earth; any other is as if the object had
//!   not been seen. A box must have a length and a width.
//! * The recording car's own size is replaced by nuPlan's vehicle around the same box centre: all scores assume that vehicle.
//! * Short gaps of the ego are interpolated; longer ones, and gaps at either end, are an error.
//! * Waymo records no acceleration. It is the slope of the rear-axle velocity (map frame) over five samples
//!   (`recording::motion`), turned into the body frame.

use super::error::RecordingFault;
use super::proto::{ObjectState, ObjectType, Track};
use crate::geometry::{OrientedBox, Point, Pose, Vector, unwrap_angles, wrap_angle};
use crate::scenario::recording::motion::slope;
use crate::world::{EgoState, MICROS_PER_SECOND, ObjectKind, PACIFICA, TrackToken, TrackedObject};
use std::sync::Arc;

/// Longest gap of the ego that is interpolated, steps.
pub(super) const LONGEST_EGO_GAP: usize = 5;
/// Coordinates beyond this are no place on Earth, metres.
const FARTHEST: f64 = 1e8;
/// Speeds beyond this are no road user's, m/s.
const FASTEST: f64 = 200.0;
/// Boxes beyond this are no road user's, metres.
const LONGEST: f64 = 100.0;

/// The centre of a box and its velocity, map frame.
#[derive(Debug, Clone, Copy)]
struct Sighting {
    center: Pose,
    velocity: Vector,
}

impl Sighting {
    fn of(state: &ObjectState, origin: Vector) -> Option<Self> {
        let center = Pose::new(state.center_x - origin.x, state.center_y - origin.y, f64::from(state.heading));
        let velocity = Vector::new(f64::from(state.velocity_x), f64::from(state.velocity_y));
        let sound = state.valid
            && center.is_finite()
            && center.position().coords.norm() < FARTHEST
            && center.heading.abs() < FARTHEST
            && velocity.norm() < FASTEST;
        sound.then(|| Self { center: Pose { heading: wrap_angle(center.heading), ..center }, velocity })
    }

    fn between(self, other: Self, share: f64) -> Self {
        let turn = wrap_angle(other.center.heading - self.center.heading);
        let position = self.center.position() + (other.center.position() - self.center.position()) * share;
        Self {
            center: Pose::at(position, wrap_angle(self.center.heading + turn * share)),
            velocity: self.velocity.lerp(&other.velocity, share),
        }
    }
}

/// Where the recording car is first seen, in the recording's own coordinates.
pub(super) fn first_position(track: &Track) -> Option<Point> {
    let seen = track.states.iter().find_map(|state| Sighting::of(state, Vector::zeros()));
    seen.map(|sighting| sighting.center.position())
}

/// The recorded ego, a state a step.
///
/// # Errors
/// When it is missing for longer than [`LONGEST_EGO_GAP`] steps, or at either end.
pub(super) fn ego_states(track: &Track, times_us: &[i64], origin: Vector) -> Result<Vec<EgoState>, RecordingFault> {
    let seen: Vec<Option<Sighting>> = track.states.iter().map(|state| Sighting::of(state, origin)).collect();
    let sightings = fill_gaps(&seen, times_us)?;
    let seconds: Vec<f64> = times_us.iter().map(|&t| t as f64 / MICROS_PER_SECOND).collect();
    let headings = unwrap_angles(&sightings.iter().map(|s| s.center.heading).collect::<Vec<_>>());
    let to_axle = PACIFICA.rear_axle_to_center();
    // The rear axle of a turning car does not slide sideways with the centre of its box.
    let velocities: Vec<Vector> = sightings
        .iter()
        .enumerate()
        .map(|(i, s)| s.velocity - s.center.rotate(Vector::new(0.0, to_axle * slope(&seconds, &headings, i))))
        .collect();
    let east: Vec<f64> = velocities.iter().map(|v| v.x).collect();
    let north: Vec<f64> = velocities.iter().map(|v| v.y).collect();
    let states = sightings.iter().enumerate().map(|(i, sighting)| {
        let rear_axle = PACIFICA.rear_axle_of(sighting.center);
        let into_body = Pose::new(0.0, 0.0, -rear_axle.heading);
        let acceleration = Vector::new(slope(&seconds, &east, i), slope(&seconds, &north, i));
        EgoState::from_log(times_us[i], rear_axle, into_body.rotate(velocities[i]), into_body.rotate(acceleration))
    });
    Ok(states.collect())
}

fn fill_gaps(seen: &[Option<Sighting>], times_us: &[i64]) -> Result<Vec<Sighting>, RecordingFault> {
    let mut filled: Vec<Sighting> = Vec::with_capacity(seen.len());
    let mut step = 0;
    while step < seen.len() {
        if let Some(sighting) = seen[step] {
            filled.push(sighting);
            step += 1;
            continue;
        }
        let missing = seen[step..].iter().take_while(|s| s.is_none()).count();
        let fault = RecordingFault::EgoMissing { step, missing };
        let (Some(&before), Some(Some(after))) = (filled.last(), seen.get(step + missing)) else { return Err(fault) };
        if missing > LONGEST_EGO_GAP {
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

/// What stands around the ego at a step, in order of track.
pub(super) fn objects_at(tracks: &[Track], ego: usize, step: usize, origin: Vector) -> Arc<[TrackedObject]> {
    let others = tracks.iter().enumerate().filter(|&(index, _)| index != ego).map(|(_, track)| track);
    others.filter_map(|track| object(track, track.states.get(step)?, origin)).collect()
}

/// A state as nuPlan's object. Waymo's cyclists are bicycles; what is neither vehicle, pedestrian nor cyclist is a generic
/// object, which nuPlan takes for static: its velocity is zero.
fn object(track: &Track, state: &ObjectState, origin: Vector) -> Option<TrackedObject> {
    let sighting = Sighting::of(state, origin)?;
    let (length, width) = (f64::from(state.length), f64::from(state.width));
    let has_size = length > 0.0 && length < LONGEST && width > 0.0 && width < LONGEST;
    let kind = match ObjectType::try_from(track.object_type) {
        Ok(ObjectType::Vehicle) => ObjectKind::Vehicle,
        Ok(ObjectType::Pedestrian) => ObjectKind::Pedestrian,
        Ok(ObjectType::Cyclist) => ObjectKind::Bicycle,
        Ok(ObjectType::Other | ObjectType::Unset) | Err(_) => ObjectKind::GenericObject,
    };
    has_size.then(|| TrackedObject {
        token: TrackToken(track.id.cast_unsigned()),
        kind,
        shape: OrientedBox::new(sighting.center, length, width),
        velocity: if kind.is_agent() { sighting.velocity } else { Vector::zeros() },
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
                center_x: 20.0 * angle.cos(),
                center_y: 20.0 * angle.sin(),
                length: 4.8,
                width: 2.1,
                heading: wrap_angle(angle + std::f64::consts::FRAC_PI_2) as f32,
                velocity_x: (-5.0 * angle.sin()) as f32,
                velocity_y: (5.0 * angle.cos()) as f32,
                valid: true,
                ..ObjectState::default()
            }
        });
        let track = Track { id: 7, object_type: ObjectType::Vehicle as i32, states: states.collect() };
        (track, (0..steps as i64).map(|i| i * 100_000).collect())
    }

    #[test]
    fn a_circle_has_its_centripetal_acceleration() {
        let (track, times) = circling(300);
        let states = ego_states(&track, &times, Vector::zeros()).unwrap();
        for state in &states[5..295] {
            assert!((state.velocity.x - 5.0).abs() < 1e-3, "{state:?}");
            assert!((state.velocity.y + PACIFICA.rear_axle_to_center() * 0.25).abs() < 1e-3, "{state:?}");
            // v²/r of the box centre, less what the rear axle turns: 5 · 0.25, and d·ω² forward.
            assert!((state.acceleration.y - 1.25).abs() < 0.01, "{state:?}");
            assert!((state.acceleration.x - PACIFICA.rear_axle_to_center() * 0.0625).abs() < 0.01, "{state:?}");
        }
    }

    #[test]
    fn short_gaps_are_bridged_and_long_ones_told() {
        let (mut track, times) = circling(40);
        let whole = ego_states(&track, &times, Vector::zeros()).unwrap();
        for state in &mut track.states[10..15] {
            state.valid = false;
        }
        let bridged = ego_states(&track, &times, Vector::zeros()).unwrap();
        assert!(bridged.iter().zip(&whole).all(|(a, b)| a.rear_axle.distance(&b.rear_axle) < 0.1));
        track.states[15].center_x = f64::NAN;
        let fault = ego_states(&track, &times, Vector::zeros()).unwrap_err();
        assert_eq!(fault, RecordingFault::EgoMissing { step: 10, missing: 6 });
        let (mut track, times) = circling(40);
        track.states[39].valid = false;
        let fault = ego_states(&track, &times, Vector::zeros()).unwrap_err();
        assert_eq!(fault, RecordingFault::EgoMissing { step: 39, missing: 1 });
    }

    #[test]
    fn unsound_states_are_not_seen() {
        let (track, _) = circling(3);
        let mut tracks = vec![track.clone(), track];
        tracks[1].states[0].heading = f32::NAN;
        tracks[1].states[1].width = 0.0;
        assert!(objects_at(&tracks, 0, 0, Vector::zeros()).is_empty());
        assert!(objects_at(&tracks, 0, 1, Vector::zeros()).is_empty());
        assert_eq!(objects_at(&tracks, 0, 2, Vector::zeros()).len(), 1);
        tracks[1].object_type = ObjectType::Other as i32;
        let seen = objects_at(&tracks, 0, 2, Vector::zeros());
        assert_eq!((seen[0].kind, seen[0].speed()), (ObjectKind::GenericObject, 0.0));
    }
}
