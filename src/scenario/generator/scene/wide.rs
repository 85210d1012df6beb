//! Wider ranges of draws, for scenarios whose name says `wide` or `wider`: what recordings show and
//! the first ranges do not.
//!
//! The values are ours, chosen so that `planagent scenarios statistics` tells generated scenes from
//! the validation recordings of Waymo and Argoverse 2 less often. Draws of `wide` never change.

use super::builder::{TrafficBuilder, VehicleKind};
use super::habits::Habits;
use crate::generator::rng::SeededRng;
use crate::generator::road::{ExtraWidths, MAX_LANES, RoadStyle};
use crate::generator::traffic::{Departure, Sway};
use planagent_world::SignalStatus;
use std::f64::consts::PI;

/// Maximum number of vehicles and cyclists that move.
pub(super) const MAX_MOVERS: usize = 60;
/// Maximum number of objects that stand for the whole scenario.
pub(super) const MAX_PARKED: usize = 90;
/// Share of roads with a parking strip.
const PARKING: f64 = 0.5;
/// How much wider a lane is than the narrowest one, at most, meters.
const MAX_EXTRA: f64 = 1.6;
/// Share of trucks and buses.
pub(super) const LONG: f64 = 0.03;
/// In still wider ranges: share of roads that are faster than the limits of their type, and by
/// which factor.
const FAST: f64 = 0.45;
const FASTER: [f64; 2] = [1.2, 1.8];
/// Highest limit, m/s (65 mph).
const HIGHEST_LIMIT: f64 = 29.06;

/// A cross-section with lanes of different widths, more parking and lower limits; in still wider
/// ranges, many have higher ones.
pub(super) fn style(
    rng: &mut SeededRng,
    own: [usize; 2],
    oncoming: [usize; 2],
    limits: &[f64],
) -> RoadStyle {
    let shoulder = |rng: &mut SeededRng| {
        let kind = rng.unit();
        if kind < PARKING {
            rng.uniform(2.4, 3.2)
        } else if kind < PARKING + 0.15 {
            rng.uniform(1.4, 2.0)
        } else {
            rng.uniform(0.4, 0.9)
        }
    };
    let wider = rng.is_wider();
    let max_extra = if wider {
        0.7 + 2.6 * rng.unit().powi(2)
    } else {
        MAX_EXTRA
    };
    // Most lanes are about as wide as the narrowest, few are far wider.
    let mut widths = [[0.0; MAX_LANES]; 2];
    for width in widths.iter_mut().flatten() {
        *width = max_extra * rng.unit().powi(2);
    }
    let (own, oncoming) = (
        rng.range(own[0], own[1]),
        rng.range(oncoming[0], oncoming[1]),
    );
    let left = if oncoming == 0 { 0.6 } else { shoulder(rng) };
    let narrowest = if wider { [2.7, 3.0] } else { [2.75, 3.15] };
    RoadStyle {
        own,
        oncoming,
        lane_width: rng.uniform(narrowest[0], narrowest[1]),
        extra: Some(ExtraWidths(widths)),
        speed_limit: if wider && rng.bool(FAST) {
            (rng.choose(limits) * rng.uniform(FASTER[0], FASTER[1])).min(HIGHEST_LIMIT)
        } else {
            rng.choose(limits).min(rng.choose(limits))
        },
        shoulder: [shoulder(rng), left],
    }
}

/// Length and width of a vehicle, meters.
pub(super) fn size(rng: &mut SeededRng, kind: VehicleKind, habits: Habits) -> (f64, f64) {
    match kind {
        VehicleKind::Car => {
            let [low, high] = habits.car_widths;
            (rng.uniform(4.1, 5.3), rng.uniform(low, high))
        }
        VehicleKind::Long => (rng.uniform(6.5, 12.0), rng.uniform(2.4, 2.9)),
        VehicleKind::Bicycle => (rng.uniform(1.6, 2.0), rng.uniform(0.6, 0.9)),
    }
}

/// Vehicles per hundred meters of lane, from a draw of the first ranges.
pub(super) fn density(rng: &mut SeededRng, density: f64) -> f64 {
    if rng.is_wider() {
        // Most recordings have little traffic, few have much.
        return density * (0.3 + 2.2 * rng.unit().powf(1.7));
    }
    density * rng.uniform(0.8, 2.5)
}

/// Where a driver keeps in its lane, meters to the left of its middle, and how it sways.
pub(super) fn sideways(
    rng: &mut SeededRng,
    kind: VehicleKind,
    width: f64,
    lane_width: f64,
    habits: Habits,
) -> (f64, Option<Sway>) {
    if kind == VehicleKind::Bicycle {
        return (0.0, None);
    }
    let amplitude = rng.uniform(0.05, 0.3) * habits.sway;
    let room = ((lane_width - width) / 2.0 - amplitude - 0.1).clamp(0.0, habits.max_aside);
    let aside = rng.sign() * (room + habits.beyond) * rng.unit().sqrt() + habits.bias;
    let sway = Sway {
        amplitude,
        frequency: 2.0 * PI / rng.uniform(22.0, 45.0),
        phase: rng.uniform(0.0, 2.0 * PI),
        skew: if rng.is_wider() {
            rng.uniform(-habits.max_skew, habits.max_skew)
        } else {
            0.0
        },
    };
    (aside, Some(sway))
}

impl TrafficBuilder<'_, '_> {
    /// Adds clutter: parked cars in most strips, cyclists, groups of pedestrians.
    pub(super) fn add_wide_clutter(&mut self) {
        let wider = self.rng.is_wider();
        let parked = if wider && self.rng.bool(0.15) {
            0.05
        } else {
            self.rng.uniform(0.3, 1.0)
        };
        let cyclists = self.rng.bool(if wider { 0.3 } else { 0.4 });
        // A function of its own beside `add_clutter`, because seeds of the first ranges must keep
        // their draws.
        for (lane, lane_width, strip) in self.curb_lanes() {
            if strip >= 2.3 {
                self.park_along(lane, lane_width / 2.0 + strip / 2.0 + 0.1, parked);
            }
            if cyclists && self.rng.bool(0.5) {
                let beside = if (1.3..2.3).contains(&strip) {
                    lane_width / 2.0 + 0.75
                } else {
                    lane_width / 2.0 - 0.5
                };
                self.cycle_along(lane, -beside);
            }
        }
        let group = if self.rng.bool(0.2) {
            let [least, most] = if wider { [6, 30] } else { [4, 14] };
            self.rng.range(least, most)
        } else {
            0
        };
        let single = if wider && self.rng.bool(0.5) {
            0
        } else {
            self.rng.range(0, 4)
        };
        for _ in 0..single + group {
            self.stroll();
        }
        for walk in self.roads().map.crosswalks().to_vec() {
            if self.rng.bool(0.3) {
                let leaves = self.rng.uniform(-3.0, 12.0);
                let departure = if self.rng.bool(0.6) {
                    Departure::WhenClear(leaves)
                } else {
                    Departure::Never
                };
                let from_far_side = self.rng.bool(0.5);
                self.wait_at(&walk, departure, from_far_side);
            }
        }
        if self.rng.bool(0.12) {
            self.road_works_beside();
        }
    }

    /// Lets vehicles wait in line where a light is red or a sign says stop, but not in the ego's
    /// lane.
    pub(super) fn queue_at_lines(&mut self) {
        let lights = self.traffic.lights();
        let own = self.ego().track.clone();
        let lanes: Vec<_> = self
            .roads()
            .road_lanes()
            .filter(|lane| own.spans.iter().all(|span| span.lane != *lane))
            .collect();
        for lane in lanes {
            let onward = self.roads().map[lane].outgoing.clone();
            // Yellow counts as red, because a driver who arrives then stops.
            let red = onward.iter().any(|&next| {
                lights
                    .status(next)
                    .is_some_and(|status| status != SignalStatus::Green)
            });
            let sign = onward.iter().any(|next| {
                self.roads().passages[next.index()]
                    .as_ref()
                    .is_some_and(|p| p.stop_sign)
            });
            if !(red && self.rng.bool(0.85) || sign && self.rng.bool(0.5)) {
                continue;
            }
            let count = if red {
                self.rng.range(1, 6)
            } else {
                self.rng.range(1, 2)
            };
            let mut s = self.roads().map[lane].centerline.length() - self.rng.uniform(3.5, 5.0);
            for _ in 0..count {
                if s < 5.0 || self.traffic.movers.len() >= MAX_MOVERS {
                    break;
                }
                let kind = self.car_or_long(LONG);
                let chain = self.wander(lane);
                self.put(kind, chain, s, 0.0, 0.0);
                s -= self.rng.uniform(6.8, 9.0);
            }
        }
    }
}
