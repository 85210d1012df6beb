//! The collision multiplier and the time-to-collision term of a proposal (`tuplan_garage`
//! `pdm_scorer.py`).

use super::encounters::{Encounters, PROJECTED_STEPS};
use super::{EgoAreas, Forecast, Placed};
use crate::metrics::{CollisionGroup, classify_collision, is_ahead, is_behind};
use planagent_world::{EgoState, LaneMap, STEP_S, TrackToken};

/// An ego slower than this is never at fault, m/s.
const STOPPED_SPEED: f64 = 5e-3;

/// The input of the terms for one proposal; the lists have one entry per state.
#[derive(Clone, Copy)]
pub(super) struct SimulatedProposal<'a> {
    pub(super) states: &'a [EgoState],
    pub(super) placed: &'a [Placed],
    pub(super) areas: &'a [EgoAreas],
}

/// A term of the score and the first state that lowered it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstTouch {
    /// 1 when nothing happened.
    pub score: f64,
    /// The state at which it first did.
    pub state: Option<usize>,
}

/// 0 after a collision at fault with a vehicle, pedestrian or bicycle, 0.5 after one with another
/// object. A track that the ego first touches without fault is never its fault later. `areas` has
/// one entry per state.
pub fn no_at_fault_collisions(
    states: &[EgoState],
    areas: &[EgoAreas],
    forecast: &Forecast,
) -> FirstTouch {
    let batch: [Vec<Placed>; 1] = [states.iter().map(Placed::from_state).collect()];
    let [placed] = &batch;
    collide(
        SimulatedProposal {
            states,
            placed,
            areas,
        },
        &Encounters::from_forecast(forecast, &batch),
    )
}

/// [`no_at_fault_collisions`] for one of a batch.
pub(super) fn collide(proposal: SimulatedProposal<'_>, encounters: &Encounters<'_>) -> FirstTouch {
    let mut ignored: Vec<TrackToken> = Vec::new();
    let mut result = FirstTouch {
        score: 1.0,
        state: None,
    };
    for (i, placed) in proposal.placed.iter().enumerate() {
        for track in encounters.touching(&placed.shape, i, 0) {
            if ignored.contains(&track.token) {
                continue;
            }
            let off_lane = proposal.areas[i].in_multiple_lanes_or_off_road();
            if classify_collision(&proposal.states[i], &track).is_at_fault(off_lane) {
                let left = if CollisionGroup::from_kind(track.kind) == CollisionGroup::Object {
                    0.5
                } else {
                    0.0
                };
                result.score = result.score.min(left);
                result.state.get_or_insert(i);
            } else {
                ignored.push(track.token);
            }
        }
    }
    result
}

/// 0 when the ego, straight ahead at its speed, would touch a relevant track within 0.9 s. Tracks
/// ahead are relevant; those beside only while the ego is in multiple lanes, off the road or in an
/// intersection. A track that was touched while not relevant is ignored from then on: PDM's
/// behaviour.
pub fn time_to_collision(
    map: &LaneMap,
    states: &[EgoState],
    areas: &[EgoAreas],
    forecast: &Forecast,
) -> FirstTouch {
    let batch: [Vec<Placed>; 1] = [states.iter().map(Placed::from_state).collect()];
    let [placed] = &batch;
    approach(
        map,
        SimulatedProposal {
            states,
            placed,
            areas,
        },
        &Encounters::from_forecast(forecast, &batch),
    )
}

/// [`time_to_collision`] for one of a batch.
pub(super) fn approach(
    map: &LaneMap,
    proposal: SimulatedProposal<'_>,
    encounters: &Encounters<'_>,
) -> FirstTouch {
    let mut ignored: Vec<TrackToken> = Vec::new();
    for (i, placed) in proposal.placed.iter().enumerate() {
        if placed.speed < STOPPED_SPEED || encounters.is_clear(i) {
            continue;
        }
        let rear_axle = proposal.states[i].rear_axle;
        let mut sideways: Option<bool> = None;
        for ahead in PROJECTED_STEPS {
            let shape = placed.moved(ahead as f64 * STEP_S);
            for track in encounters.touching(&shape, i, ahead) {
                if ignored.contains(&track.token) {
                    continue;
                }
                let center = track.shape.center.position();
                let sideways = *sideways.get_or_insert_with(|| {
                    proposal.areas[i].in_multiple_lanes_or_off_road()
                        || map.in_intersection(rear_axle.position())
                });
                if is_ahead(rear_axle, center) || (sideways && !is_behind(rear_axle, center)) {
                    return FirstTouch {
                        score: 0.0,
                        state: Some(i),
                    };
                }
                // As upstream: an object whose first touch is not the ego's fault is ignored from
                // then on.
                ignored.push(track.token);
            }
        }
    }
    FirstTouch {
        score: 1.0,
        state: None,
    }
}
