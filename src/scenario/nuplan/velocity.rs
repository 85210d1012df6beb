//! Velocities that a log lacks, from the positions of the track. nuPlan's tables allow NULL. A
//! program that takes it for a number, or for standing still, judges traffic that the log does not
//! hold.

use crate::Frame;
use planagent_world::geometry::{Point, Vector};
use planagent_world::{MICROS_PER_SECOND, TrackToken};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Longest time between the two positions of a velocity, s. Over a longer one the track may have
/// turned.
const MAX_SPAN_S: f64 = 1.0;

/// A track in a frame.
#[derive(Clone, Copy)]
struct TrackedCenter {
    frame: usize,
    time_us: i64,
    center: Point,
}

/// Sets the velocities that are NaN: the change of position between the frames before and after, at
/// the ends of a track between the frame and its neighbor; zero for a track of one frame. Gives
/// their number.
pub(super) fn derive_missing(frames: &mut [Frame]) -> usize {
    let is_missing = |velocity: &Vector| velocity.x.is_nan() || velocity.y.is_nan();
    let all = || frames.iter().flat_map(|frame| frame.objects.iter());
    let tracks: BTreeSet<TrackToken> = all()
        .filter(|object| is_missing(&object.velocity))
        .map(|object| object.token)
        .collect();
    // Most logs lack none, and then no object is copied.
    if tracks.is_empty() {
        return 0;
    }
    let mut places: BTreeMap<TrackToken, Vec<TrackedCenter>> = BTreeMap::new();
    for (number, frame) in frames.iter().enumerate() {
        for object in frame
            .objects
            .iter()
            .filter(|object| tracks.contains(&object.token))
        {
            let center = object.shape.center.position();
            let seen = TrackedCenter {
                frame: number,
                time_us: frame.ego.time_us,
                center,
            };
            places.entry(object.token).or_default().push(seen);
        }
    }
    let mut derived = 0;
    for (number, frame) in frames.iter_mut().enumerate() {
        if !frame
            .objects
            .iter()
            .any(|object| is_missing(&object.velocity))
        {
            continue;
        }
        let mut objects = frame.objects.to_vec();
        for object in objects
            .iter_mut()
            .filter(|object| is_missing(&object.velocity))
        {
            object.velocity = places
                .get(&object.token)
                .map_or_else(Vector::zeros, |places| velocity(places, number));
            derived += 1;
        }
        frame.objects = Arc::from(objects);
    }
    derived
}

/// The velocity of a track in a frame; `places` are in order of time.
fn velocity(places: &[TrackedCenter], frame: usize) -> Vector {
    let own = places.partition_point(|place| place.frame < frame);
    let at = |place: usize| places.get(place).copied();
    let before = own.checked_sub(1).and_then(at);
    let pairs = [
        (before, at(own + 1)),
        (before, at(own)),
        (at(own), at(own + 1)),
    ];
    let over = |(from, to): (Option<TrackedCenter>, Option<TrackedCenter>)| {
        let (from, to) = (from?, to?);
        let seconds = (to.time_us - from.time_us) as f64 / MICROS_PER_SECOND;
        (seconds > 0.0 && seconds <= MAX_SPAN_S).then(|| (to.center - from.center) / seconds)
    };
    pairs
        .into_iter()
        .find_map(over)
        .unwrap_or_else(Vector::zeros)
}
