//! The collision multiplier and the time-to-collision term of a proposal (`tuplan_garage` `pdm_scorer.py`).

use super::{EgoAreas, Forecast};
use crate::geometry::Pose;
use crate::metrics::{CollisionGroup, classify_collision, is_ahead, is_behind};
use crate::world::{EgoState, LaneMap, STEP_S, TrackToken};
use std::collections::BTreeSet;

/// Steps by which the ego is projected in the test of the time to collision: 0, 0.3, 0.6, 0.9 s.
const PROJECTED_STEPS: [usize; 4] = [0, 3, 6, 9];
/// An ego slower than this cannot run into anyone, m/s.
const STOPPED_SPEED: f64 = 5e-3;

/// A term of the score and the first state that lowered it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstTouch {
    /// 1 when nothing happened.
    pub score: f64,
    /// The state at which it first did.
    pub state: Option<usize>,
}

/// 0 after a collision at fault with a vehicle, pedestrian or bicycle, 0.5 after one with a thing. A track that the ego
/// first touches without fault is never its fault later. `areas` has one entry a state.
pub fn no_at_fault_collisions(states: &[EgoState], areas: &[EgoAreas], forecast: &Forecast) -> FirstTouch {
    let mut ignored: BTreeSet<TrackToken> = BTreeSet::new();
    let mut result = FirstTouch { score: 1.0, state: None };
    for (i, (ego, areas)) in states.iter().zip(areas).enumerate() {
        for track in forecast.touching(&ego.footprint(), i) {
            if ignored.contains(&track.token) {
                continue;
            }
            if classify_collision(ego, &track).is_at_fault(areas.in_multiple_lanes_or_off_road()) {
                let left = if CollisionGroup::of(track.kind) == CollisionGroup::Object { 0.5 } else { 0.0 };
                result.score = result.score.min(left);
                result.state.get_or_insert(i);
            } else {
                ignored.insert(track.token);
            }
        }
    }
    result
}

/// 0 when, going straight on at its speed, the ego would touch someone relevant within 0.9 s. Tracks ahead are
/// relevant; those beside only while the ego is in multiple lanes, off the road or in an intersection. A track that was
/// touched while not relevant is ignored from then on: PDM's behaviour.
pub fn time_to_collision(map: &LaneMap, states: &[EgoState], areas: &[EgoAreas], forecast: &Forecast) -> FirstTouch {
    let mut ignored: BTreeSet<TrackToken> = BTreeSet::new();
    for (i, (ego, areas)) in states.iter().zip(areas).enumerate() {
        if ego.speed() < STOPPED_SPEED {
            continue;
        }
        let here = ego.footprint();
        let mut sideways: Option<bool> = None;
        for ahead in PROJECTED_STEPS {
            let moved = here.center.position() + here.center.direction() * (ego.speed() * ahead as f64 * STEP_S);
            let shape = here.moved_to(Pose::at(moved, here.center.heading));
            for track in forecast.touching(&shape, i + ahead) {
                if ignored.contains(&track.token) {
                    continue;
                }
                let center = track.shape.center.position();
                let sideways = *sideways.get_or_insert_with(|| {
                    areas.in_multiple_lanes_or_off_road() || map.in_intersection(ego.rear_axle.position())
                });
                if is_ahead(ego.rear_axle, center) || (sideways && !is_behind(ego.rear_axle, center)) {
                    return FirstTouch { score: 0.0, state: Some(i) };
                }
                ignored.insert(track.token);
            }
        }
    }
    FirstTouch { score: 1.0, state: None }
}
