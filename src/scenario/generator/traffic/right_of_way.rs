//! Traffic lights, stop signs and the right of way.

use super::mover::Mover;
use super::state::Traffic;
use crate::generator::road::{Conflict, Passage};
use planagent_world::{SignalStatus, TrafficLights};

/// Distance before a junction at which other drivers notice a vehicle, meters.
const NOTICED: f64 = 70.0;
/// Speed below which a vehicle counts as standing, m/s.
const STANDING: f64 = 0.5;
/// Assumed speed when crossing a junction from a standstill, m/s.
const CROSSING_SPEED: f64 = 7.0;
/// Assumed acceleration, m/s².
const CROSSING_ACCELERATION: f64 = 1.4;
/// A driver who would have to brake harder than this continues through yellow, m/s².
const YELLOW_DECELERATION: f64 = 2.2;

/// Connectors that movers are about to use: for each lane, the movers and the arc length on their
/// track at which it begins.
#[derive(Debug, Clone)]
pub(crate) struct Claims {
    by_lane: Vec<Vec<(usize, f64)>>,
}

impl Claims {
    pub(crate) fn new(traffic: &Traffic<'_>) -> Self {
        let mut by_lane = vec![Vec::new(); traffic.roads.passages.len()];
        for (i, mover) in traffic
            .movers
            .iter()
            .enumerate()
            .filter(|(_, mover)| !mover.gone)
        {
            for span in mover.track.spans.iter().filter(|span| span.connector) {
                if span.from < mover.front_s() + NOTICED && span.to > mover.rear_s() {
                    by_lane[span.lane.index()].push((i, span.from));
                }
            }
        }
        Self { by_lane }
    }
}

impl Traffic<'_> {
    /// Arc length at which the front of mover `i` must stop now for lights, signs or the right of
    /// way of others.
    pub(super) fn place_to_stop(
        &self,
        i: usize,
        claims: &Claims,
        lights: &TrafficLights,
    ) -> Option<f64> {
        let me = &self.movers[i];
        let lookahead = me.lookahead();
        let upcoming = me
            .track
            .spans
            .iter()
            .filter(|span| span.connector && span.to > me.s);
        for span in upcoming.take_while(|span| span.from < me.front_s() + lookahead) {
            let Some(passage) = self.roads.passages[span.lane.index()].as_ref() else {
                continue;
            };
            let before = me.front_s() <= span.from + 0.5;
            if before {
                if must_stop_at_light(me, span.from, lights.status(span.lane)) {
                    return Some(span.from);
                }
                if passage.stop_sign && me.served != Some(span.lane) {
                    return Some(span.from);
                }
            }
            if let Some(conflict) = self.conflict_ahead(i, span.from, passage, claims, lights) {
                // A vehicle inside the junction may still stop short of the conflict, but no longer
                // at the line.
                let edge = span.from + conflict.own[0] - 1.0;
                if before {
                    return Some(span.from);
                }
                if me.front_s() < edge + 0.5 {
                    return Some(edge);
                }
            }
        }
        None
    }

    /// The first conflict on a connector at which mover `i` must yield now.
    fn conflict_ahead(
        &self,
        i: usize,
        start: f64,
        passage: &Passage,
        claims: &Claims,
        lights: &TrafficLights,
    ) -> Option<Conflict> {
        let me = &self.movers[i];
        if start - me.front_s() > 2.5 * me.speed + 12.0 {
            return None;
        }
        let yields = |conflict: &&Conflict| {
            // A driver past the start of the conflict continues.
            me.front_s() < start + conflict.own[0]
                && claims.by_lane[conflict.other.index()]
                    .iter()
                    .any(|&(j, begins)| {
                        j != i && self.must_yield_to(me, start, conflict, j, begins, lights)
                    })
        };
        passage
            .conflicts
            .iter()
            .filter(yields)
            .min_by(|a, b| a.own[0].total_cmp(&b.own[0]))
            .copied()
    }

    /// True if a driver must yield to mover `j`, whose connector begins at `begins` on its track.
    fn must_yield_to(
        &self,
        me: &Mover,
        start: f64,
        conflict: &Conflict,
        j: usize,
        begins: f64,
        lights: &TrafficLights,
    ) -> bool {
        let other = &self.movers[j];
        let (enters, leaves) = (begins + conflict.others[0], begins + conflict.others[1]);
        if other.rear_s() > leaves {
            return false;
        }
        if other.front_s() >= enters {
            // The other vehicle is inside. Where paths merge, car following takes over once it is
            // ahead.
            return true;
        }
        if !conflict.yields {
            return false;
        }
        let waits = other.front_s() < begins + 0.5
            && matches!(
                lights.status(conflict.other),
                Some(SignalStatus::Red | SignalStatus::Yellow)
            );
        if waits {
            return false;
        }
        let to_enter = enters - other.front_s();
        let (arrives, clears) = if other.speed < STANDING {
            (to_enter / 3.0 + 1.2, to_enter / 3.0 + 4.0)
        } else {
            let speed = other.speed.max(2.0);
            (
                to_enter / speed,
                (leaves + other.length - other.front_s()) / speed,
            )
        };
        let mine_in = travel_time(start + conflict.own[0] - me.front_s(), me.speed);
        let mine_out = travel_time(start + conflict.own[1] + me.length - me.front_s(), me.speed);
        let margin = me.profile.gap_margin;
        mine_out + margin > arrives && mine_in < clears + 0.5
    }

    /// Notes which vehicles have stopped at a sign.
    pub(super) fn note_stops(&mut self) {
        /// Maximum distance to the line for a stop to count, meters.
        const AT_LINE: f64 = 3.0;
        for mover in self
            .movers
            .iter_mut()
            .filter(|mover| !mover.gone && mover.speed < 0.2)
        {
            let (front, s) = (mover.front_s(), mover.s);
            let next = mover
                .track
                .spans
                .iter()
                .find(|span| span.connector && span.from > s);
            if let Some(span) = next.filter(|span| span.from - front < AT_LINE) {
                mover.served = Some(span.lane);
            }
        }
    }
}

fn must_stop_at_light(me: &Mover, line: f64, status: Option<SignalStatus>) -> bool {
    match status {
        Some(SignalStatus::Red) => {
            // A driver who can no longer stop before a light that has just turned red continues.
            let needed = me.speed * me.speed / (2.0 * (line - me.front_s()).max(0.1));
            needed < me.profile.max_braking + 1.0 || me.speed < 1.0
        }
        Some(SignalStatus::Yellow) => {
            me.speed * me.speed / (2.0 * (line - me.front_s()).max(0.1)) < YELLOW_DECELERATION
        }
        _ => false,
    }
}

/// Time to cover a distance while accelerating to the crossing speed, seconds.
fn travel_time(distance: f64, speed: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    let top = speed.max(CROSSING_SPEED);
    let rising = (top - speed) / CROSSING_ACCELERATION;
    let covered = f64::midpoint(speed, top) * rising;
    if covered >= distance {
        ((speed * speed + 2.0 * CROSSING_ACCELERATION * distance).sqrt() - speed)
            / CROSSING_ACCELERATION
    } else {
        rising + (distance - covered) / top
    }
}
