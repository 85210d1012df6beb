//! A driver's acceleration: the intelligent driver model against everything ahead.

use super::mover::{Mover, Steering};
use super::right_of_way::Claims;
use super::state::{Body, Traffic};
use super::walker::Walker;
use planagent_world::dynamics::Lead;
use planagent_world::{PACIFICA, TrafficLights};

/// Lateral clearance below which a body blocks the path, meters.
const SIDE_MARGIN: f64 = 0.25;
/// Horizon for bodies that move sideways into the path, seconds.
const SIDE_LOOKAHEAD: f64 = 1.0;
/// Distance to a stop line or yield line at a stop, meters.
const BEFORE_LINE: f64 = 0.8;
/// Deceleration toward a lower speed that the driver's own path asks for, m/s².
const ANTICIPATION: f64 = 0.9;
/// Distance to a pedestrian's path at a stop, meters.
const BEFORE_WALKER: f64 = 1.8;

impl Traffic<'_> {
    /// Acceleration that the driver of mover `i` chooses, m/s².
    pub(super) fn wanted_acceleration(
        &self,
        i: usize,
        bodies: &[Body],
        claims: &Claims,
        lights: &TrafficLights,
    ) -> f64 {
        let me = &self.movers[i];
        let mut wanted = me.free_acceleration();
        let (place, ahead) = (
            me.track.pose_at(me.s).position(),
            me.track.direction_at(me.s),
        );
        for body in bodies.iter().filter(|body| body.mover != Some(i)) {
            // Most bodies are far away or behind; this test is cheap.
            let to = body.shape.center.position() - place;
            let (lookahead, reach) = (me.lookahead(), body.shape.length / 2.0);
            if to.norm_squared() > (lookahead + reach).powi(2) || ahead.dot(&to) < -(reach + 8.0) {
                continue;
            }
            if let Some(lead) = me.lead(body, lookahead + reach) {
                wanted = wanted.min(me.following(lead));
            }
        }
        if let Some(s) = self.place_to_stop(i, claims, lights) {
            wanted = wanted.min(me.stopping(s - BEFORE_LINE));
        }
        if let Some(s) = me.stop_s {
            wanted = wanted.min(me.stopping(s));
        }
        for walker in &self.walkers {
            if let Some(s) = walker
                .crosses_in(self.time)
                .and_then(|wait| me.yield_to(walker, wait))
            {
                wanted = wanted.min(me.stopping(s - BEFORE_WALKER));
            }
        }
        wanted
    }
}

impl Mover {
    /// Desired speed here, m/s.
    fn desired_speed(&self) -> f64 {
        let by_path = self
            .profile
            .steering
            .map_or(f64::INFINITY, |steering| self.steerable_speed(steering));
        (self.track.allowed_at(self.s) * self.profile.speed_factor)
            .min(self.speed_cap)
            .min(by_path)
    }

    /// Maximum speed from which the vehicle can slow down comfortably to the speeds that its path
    /// allows, m/s.
    fn steerable_speed(&self, steering: Steering) -> f64 {
        /// Samples of the path ahead and the distance between them, meters.
        const AHEAD: usize = 30;
        const STEP: f64 = 1.0;
        let angle = |k: usize| {
            (PACIFICA.wheel_base * self.path_curvature(self.s + (k as f64 - 1.0) * STEP)).atan()
        };
        let angles: Vec<f64> = (0..=AHEAD + 2).map(angle).collect();
        let allowed = angles.windows(3).enumerate().map(|(k, window)| {
            let curvature = window[1].tan() / PACIFICA.wheel_base;
            let turned_per_meter = (window[2] - window[0]) / (2.0 * STEP);
            let by_rate = steering.rate / turned_per_meter.abs().max(1e-6);
            let by_lateral = (steering.lateral / curvature.abs().max(1e-6)).sqrt();
            (by_rate.min(by_lateral).powi(2) + 2.0 * ANTICIPATION * k as f64 * STEP).sqrt()
        });
        allowed.fold(f64::INFINITY, f64::min)
    }

    fn free_acceleration(&self) -> f64 {
        self.profile
            .idm(self.desired_speed())
            .acceleration(self.speed, None)
    }

    /// Acceleration behind a lead vehicle: the intelligent driver model, or harder braking where
    /// that would come too late.
    fn following(&self, lead: Lead) -> f64 {
        let by_law = self
            .profile
            .idm(self.desired_speed())
            .acceleration(self.speed, Some(lead));
        let closing = self.speed - lead.speed;
        if closing <= 0.0 {
            return by_law;
        }
        let needed = closing * closing / (2.0 * (lead.gap - 0.5).max(0.2));
        if needed > self.profile.decel {
            by_law.min(-needed)
        } else {
            by_law
        }
    }

    /// Acceleration toward a stop with the front at arc length `s`.
    fn stopping(&self, s: f64) -> f64 {
        // The model keeps its minimum gap to a lead, so the virtual lead stands farther away by
        // that gap.
        self.following(Lead {
            gap: s - self.front_s() + self.profile.min_gap,
            speed: 0.0,
        })
    }

    /// Distance ahead that matters at this speed, meters.
    pub(super) fn lookahead(&self) -> f64 {
        25.0 + 4.0 * self.speed
    }

    /// A body within `lookahead` meters as a lead, if it blocks the path.
    fn lead(&self, body: &Body, lookahead: f64) -> Option<Lead> {
        /// A body farther beside the track than this and half its length cannot block it, meters.
        const ASIDE: f64 = 6.0;
        let (s, lateral) = self.track.project(
            body.shape.center.position(),
            self.s - 10.0,
            self.s + lookahead,
        );
        let sideways_reach = if body.speed > 0.0 {
            body.speed * SIDE_LOOKAHEAD
        } else {
            0.0
        };
        if lateral.abs() > ASIDE + body.shape.length / 2.0 + sideways_reach || s <= self.s {
            return None;
        }
        let along_track = self.track.direction_at(s);
        let (sin, cos) = (
            along_track.perp(&body.direction),
            along_track.dot(&body.direction),
        );
        let (half_length, half_width) = (body.shape.length / 2.0, body.shape.width / 2.0);
        let along = (half_length * cos).abs() + (half_width * sin).abs();
        let across = (half_length * sin).abs() + (half_width * cos).abs();
        let sideways = body.speed * sin;
        let now = self.clearance(s - along, s + along, lateral, across);
        // A moment later as well: what moves across the path blocks it before it is there.
        let soon = self.clearance(
            s - along,
            s + along,
            lateral + sideways * SIDE_LOOKAHEAD,
            across,
        );
        let blocks = now < SIDE_MARGIN || (sideways.abs() > 0.4 && soon < 0.0 && now < 3.0);
        blocks.then(|| Lead {
            gap: s - along - self.front_s(),
            speed: (body.speed * cos).max(0.0),
        })
    }

    /// Lateral clearance between this vehicle, while it passes from `from` to `to`, and a body
    /// `across` meters to both sides of `lateral`. Negative where they would touch.
    fn clearance(&self, from: f64, to: f64, lateral: f64, across: f64) -> f64 {
        let (a, b) = (
            self.shift.at(from.max(self.s)).0,
            self.shift.at(to.max(self.s)).0,
        );
        let half = self.width / 2.0;
        let (right, left) = (a.min(b) - half, a.max(b) + half);
        (lateral - across - left).max(right - (lateral + across))
    }

    /// Where this driver must stop for a pedestrian who starts to cross in `wait` seconds: the near
    /// edge of the crosswalk, or of the pedestrian's path where there is none. `None` if it need
    /// not stop.
    fn yield_to(&self, walker: &Walker, wait: f64) -> Option<f64> {
        let lookahead = self.lookahead().min(50.0);
        let position = walker.position();
        if (position - self.track.pose_at(self.s).position()).norm() > lookahead + 10.0 {
            return None;
        }
        let (s, lateral) = self
            .track
            .project(position, self.s, self.s + lookahead + 5.0);
        if s <= self.front_s() - 0.5 || lateral.abs() > 25.0 {
            return None;
        }
        let sideways = self.track.direction_at(s).perp(&walker.stride());
        let offset = lateral - self.shift.at(s).0;
        let half = self.width / 2.0 + walker.size / 2.0 + 0.5;
        let approaching = offset * sideways < 0.0;
        if offset.abs() > half {
            if !approaching || sideways.abs() < 0.1 {
                return None;
            }
            let enters = wait + (offset.abs() - half) / sideways.abs();
            let gap = (s - self.front_s()).max(0.0);
            let passed = (gap + self.length + 2.0) / self.speed.max(0.5);
            let left = wait + (offset.abs() + half) / sideways.abs();
            // Rules of thumb, ours: the driver is past in time, the crossing is far off, or it ends
            // in time.
            if passed + 1.0 < enters
                || (enters > 6.0 && gap > 15.0)
                || gap > self.speed * (left + 2.0) + 8.0
            {
                return None;
            }
        }
        let edge = self
            .track
            .crosswalks
            .iter()
            .find(|walk| walk[0] - 1.5 < s && s < walk[1] + 1.5)
            .map(|walk| walk[0]);
        let stop = edge.unwrap_or(s - walker.size / 2.0);
        (stop > self.front_s() - 1.0 || s > self.front_s() + 0.3)
            .then_some(stop.max(self.front_s() - 1.0))
    }
}
