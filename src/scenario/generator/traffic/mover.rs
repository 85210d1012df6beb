//! Vehicles and cyclists, each on its track.

use super::track::Track;
use planagent_world::dynamics::IdmParameters;
use planagent_world::geometry::{OrientedBox, Pose, Vector, wrap_angle};
use planagent_world::{LaneId, ObjectKind, PACIFICA, STEP_S, TrackToken};
use std::sync::Arc;

/// Parameters of a driver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DriverProfile {
    /// Desired speed as a share of the allowed speed.
    pub(crate) speed_factor: f64,
    /// Gap at a standstill, meters.
    pub(crate) min_gap: f64,
    /// Time headway, seconds.
    pub(crate) headway: f64,
    /// m/s².
    pub(crate) accel: f64,
    /// Comfortable deceleration, m/s².
    pub(crate) decel: f64,
    /// Time that must remain after clearing a conflicting path, seconds.
    pub(crate) gap_margin: f64,
    /// Maximum increase of the acceleration, m/s³.
    pub(crate) jerk: f64,
    /// m/s².
    pub(crate) max_braking: f64,
    /// Bounds for the bends of the driver's own path; `None` if only the road's bends slow it down.
    pub(crate) steering: Option<Steering>,
}

/// Bounds of the steering. The speed is reduced to stay within them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Steering {
    /// Maximum rate of the front wheels' angle, rad/s.
    pub(crate) rate: f64,
    /// Maximum lateral acceleration on the path, m/s².
    pub(crate) lateral: f64,
}

impl DriverProfile {
    /// The intelligent driver model for a desired speed.
    pub(crate) fn idm(&self, target_velocity: f64) -> IdmParameters {
        IdmParameters {
            target_velocity: target_velocity.max(0.1),
            min_gap: self.min_gap,
            headway: self.headway,
            accel_max: self.accel,
            decel_max: self.decel,
            exponent: 4,
        }
    }
}

/// A lateral movement along the track: a quintic from an offset and slope to another offset,
/// without curvature at its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shift {
    /// Start, meters along the track.
    pub(crate) from_s: f64,
    pub(crate) to_s: f64,
    /// Offset before it, meters to the left.
    pub(crate) from_d: f64,
    /// Offset after it, meters to the left.
    pub(crate) to_d: f64,
    /// Slope of the offset at the start.
    pub(crate) from_slope: f64,
}

impl Shift {
    pub(crate) fn constant(lateral: f64) -> Self {
        Self {
            from_s: 0.0,
            to_s: 0.0,
            from_d: lateral,
            to_d: lateral,
            from_slope: 0.0,
        }
    }

    /// Offset at `s` and its slope.
    pub(crate) fn at(&self, s: f64) -> (f64, f64) {
        let length = self.to_s - self.from_s;
        if length <= 0.0 || s >= self.to_s {
            return (self.to_d, 0.0);
        }
        if s <= self.from_s {
            return (self.from_d, self.from_slope);
        }
        let t = (s - self.from_s) / length;
        let share = t.powi(3) * (10.0 - 15.0 * t + 6.0 * t * t);
        let slope = 30.0 * t * t * (1.0 - t).powi(2);
        let by = self.to_d - self.from_d;
        // The part that reduces the initial slope to zero.
        let lead_in = t - 6.0 * t.powi(3) + 8.0 * t.powi(4) - 3.0 * t.powi(5);
        let lead_in_slope = 1.0 - 18.0 * t * t + 32.0 * t.powi(3) - 15.0 * t.powi(4);
        let offset = self.from_d + by * share + self.from_slope * length * lead_in;
        (
            offset,
            by * slope / length + self.from_slope * lead_in_slope,
        )
    }
}

/// How a driver sways about its path: a sine along the track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sway {
    /// Meters.
    pub(crate) amplitude: f64,
    /// Radians per meter of the track.
    pub(crate) frequency: f64,
    /// Radians.
    pub(crate) phase: f64,
    /// Angle of the box to its course, radians.
    pub(crate) skew: f64,
}

impl Sway {
    /// Offset to the left at `s`, and its slope.
    fn at(&self, s: f64) -> (f64, f64) {
        let angle = self.frequency * s + self.phase;
        (
            self.amplitude * angle.sin(),
            self.amplitude * self.frequency * angle.cos(),
        )
    }
}

/// A scripted action at a given time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Act {
    /// Limits the speed, m/s, from a time on, seconds.
    Limit { at: f64, speed: f64 },
    /// Changes to the neighboring lane at a time, seconds.
    ChangeLane { at: f64, left: bool },
}

impl Act {
    pub(crate) fn at(&self) -> f64 {
        match *self {
            Self::Limit { at, .. } | Self::ChangeLane { at, .. } => at,
        }
    }
}

/// A vehicle or cyclist with its driver. The reference point is the center of its box, for the ego
/// the rear axle.
#[derive(Debug, Clone)]
pub(crate) struct Mover {
    /// The ego's is not used.
    pub(crate) token: TrackToken,
    pub(crate) kind: ObjectKind,
    /// Meters.
    pub(crate) length: f64,
    /// Meters.
    pub(crate) width: f64,
    /// From the reference point to the front bumper, meters.
    pub(crate) front: f64,
    pub(crate) track: Arc<Track>,
    /// Reference point along the track, meters.
    pub(crate) s: f64,
    /// m/s.
    pub(crate) speed: f64,
    /// m/s².
    pub(crate) accel: f64,
    /// Offset from the track.
    pub(crate) shift: Shift,
    /// `None` for drivers who keep their path exactly.
    pub(crate) sway: Option<Sway>,
    pub(crate) profile: DriverProfile,
    /// Maximum speed beside the road's limit, m/s.
    pub(crate) speed_cap: f64,
    /// Arc length at which the driver stops its front for now.
    pub(crate) stop_s: Option<f64>,
    /// Scripted actions, soonest last.
    pub(crate) script: Vec<Act>,
    /// The connector at whose stop sign it has stopped.
    pub(crate) served: Option<LaneId>,
    /// True after it has left the roads.
    pub(crate) gone: bool,
}

impl Mover {
    /// From the reference point to the rear bumper, meters.
    pub(crate) fn back(&self) -> f64 {
        self.length - self.front
    }

    /// Front bumper along the track, meters.
    pub(crate) fn front_s(&self) -> f64 {
        self.s + self.front
    }

    /// Rear bumper along the track, meters.
    pub(crate) fn rear_s(&self) -> f64 {
        self.s - self.back()
    }

    /// Pose of the reference point.
    pub(crate) fn pose(&self) -> Pose {
        let base = self.track.pose_at(self.s);
        let (mut lateral, mut slope) = self.shift.at(self.s);
        if let Some((aside, turned)) = self.sway.map(|sway| sway.at(self.s)) {
            (lateral, slope) = (lateral + aside, slope + turned);
        }
        let along = 1.0 - self.track.curvature_at(self.s) * lateral;
        let moved = base.translated(0.0, lateral);
        Pose::new(
            moved.x,
            moved.y,
            wrap_angle(base.heading + slope.atan2(along)),
        )
    }

    /// Heading of the path at arc length `s` of the track, radians, not wrapped.
    pub(crate) fn heading_at(&self, s: f64) -> f64 {
        let (lateral, slope) = self.shift.at(s);
        self.track.pose_at(s).heading + slope.atan2(1.0 - self.track.curvature_at(s) * lateral)
    }

    /// Curvature of the path at arc length `s` of the track, 1/m, from the headings before and
    /// after.
    pub(crate) fn path_curvature(&self, s: f64) -> f64 {
        /// Distance of both headings from the place, meters.
        const SPAN: f64 = 1.2;
        wrap_angle(self.heading_at(s + SPAN) - self.heading_at(s - SPAN)) / (2.0 * SPAN)
    }

    pub(crate) fn shape(&self) -> OrientedBox {
        let ahead = self.front - self.length / 2.0;
        let skew = self.sway.map_or(0.0, |sway| sway.skew);
        let center = self.pose().translated(ahead, 0.0);
        let turned = Pose::new(center.x, center.y, wrap_angle(center.heading + skew));
        OrientedBox::new(turned, self.length, self.width)
    }

    /// Velocity in the map frame, m/s.
    pub(crate) fn velocity(&self) -> Vector {
        self.pose().direction() * self.speed
    }

    /// True during a lateral movement.
    pub(crate) fn is_changing(&self) -> bool {
        let (from_s, to_s) = (self.shift.from_s, self.shift.to_s);
        to_s > from_s && self.s < to_s
    }

    /// True during a lane change, not during an offset within the lane.
    pub(crate) fn is_between_lanes(&self) -> bool {
        /// Larger sideways movements leave the lane, meters: about half of a lane's width.
        const WITHIN_LANE: f64 = 1.6;
        self.is_changing() && (self.shift.to_d - self.shift.from_d).abs() > WITHIN_LANE
    }

    /// Advances by one step with this acceleration, within the driver's jerk.
    pub(crate) fn advance(&mut self, wanted: f64) {
        let rise = self.profile.jerk * STEP_S;
        // Emergency braking may build up faster.
        let fall = if wanted < -self.profile.decel - 0.5 {
            3.0 * rise
        } else {
            1.2 * rise
        };
        self.accel = wanted
            .clamp(self.accel - fall, self.accel + rise)
            .clamp(-self.profile.max_braking, self.profile.accel);
        let speed = (self.speed + self.accel * STEP_S).max(0.0);
        let driven = f64::midpoint(self.speed, speed) * STEP_S;
        if speed == 0.0 {
            self.accel = 0.0;
        }
        self.speed = speed;
        let (lateral, slope) = self.shift.at(self.s);
        let along = 1.0 - self.track.curvature_at(self.s) * lateral;
        self.s += driven / along.hypot(slope).max(0.2);
        // It leaves the roads before its track ends.
        self.gone |= self.front_s() + 1.0 > self.track.length();
    }

    /// Moves to another track, from which it is `lateral` meters away at `s`, within `length`
    /// meters. Its pose does not jump.
    pub(crate) fn change_track(&mut self, track: Arc<Track>, s: f64, lateral: f64, length: f64) {
        let turned = wrap_angle(self.pose().heading - track.pose_at(s).heading);
        let from_slope = turned.tan() * (1.0 - track.curvature_at(s) * lateral);
        self.track = track;
        self.s = s;
        self.shift = Shift {
            from_s: s,
            to_s: s + length,
            from_d: lateral,
            to_d: 0.0,
            from_slope,
        };
        self.served = None;
        self.stop_s = None;
    }

    /// The ego at arc length `s` of its track.
    pub(crate) fn ego(track: Arc<Track>, s: f64, speed: f64, profile: DriverProfile) -> Self {
        Self {
            token: TrackToken(0),
            kind: ObjectKind::Vehicle,
            length: PACIFICA.length(),
            width: PACIFICA.width,
            front: PACIFICA.front_length,
            track,
            s,
            speed,
            accel: 0.0,
            shift: Shift::constant(0.0),
            sway: None,
            profile,
            speed_cap: f64::INFINITY,
            stop_s: None,
            script: Vec::new(),
            served: None,
            gone: false,
        }
    }
}
