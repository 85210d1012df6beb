//! Collisions and their fault by nuPlan's rules, for its metrics and PDM's scorer (devkit
//! `collision_utils.py`, `no_ego_at_fault_collisions.py`, `observation/idm/utils.py`).

use super::corners::DrivenLanes;
use planagent_world::geometry::{OrientedBox, Point, Pose};
use planagent_world::{EgoState, HistorySample, ObjectKind, TrackToken, TrackedObject};
use std::collections::BTreeSet;
use std::f64::consts::PI;

/// Up to this speed an agent stands in the classification of collisions, m/s.
pub(crate) const STOPPED_SPEED: f64 = 0.05;
/// Largest bearing of an object ahead, radians (30°).
pub(crate) const AHEAD_ANGLE: f64 = PI / 6.0;
/// Smallest bearing of an object behind, radians (150°).
pub(crate) const BEHIND_ANGLE: f64 = PI * 5.0 / 6.0;

/// Whether a point (the center of an object) lies ahead of a rear axle.
pub fn is_ahead(rear_axle: Pose, point: Point) -> bool {
    rear_axle.bearing_to(point) < AHEAD_ANGLE
}

/// Whether a point (the center of an object) lies behind a rear axle.
pub fn is_behind(rear_axle: Pose, point: Point) -> bool {
    rear_axle.bearing_to(point) > BEHIND_ANGLE
}

/// nuPlan's overlap test: centers nearer than half the sum of the diagonals, and shapes that share
/// a point.
#[inline]
pub(crate) fn in_collision(a: &OrientedBox, b: &OrientedBox) -> bool {
    // Most pairs are far apart: they pay for no diagonal.
    if !a.may_overlap(b) {
        return false;
    }
    let reach = f64::midpoint(a.diagonal(), b.diagonal());
    (a.center.position() - b.center.position()).norm_squared() < reach * reach && a.overlaps(b)
}

/// How the ego and a track collided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CollisionType {
    /// The ego stood.
    StoppedEgo,
    /// The track stood, or is static.
    StoppedTrack,
    /// Both moved; the front edge of the ego touches the track.
    ActiveFront,
    /// Both moved; the track is behind the ego.
    ActiveRear,
    /// Both moved; anything else.
    ActiveLateral,
}

impl CollisionType {
    /// Whether the ego is at fault. In a lateral collision it is when it was in multiple lanes or
    /// off the road.
    pub(crate) fn is_at_fault(self, in_multiple_lanes_or_off_road: bool) -> bool {
        match self {
            Self::StoppedTrack | Self::ActiveFront => true,
            Self::ActiveLateral => in_multiple_lanes_or_off_road,
            Self::StoppedEgo | Self::ActiveRear => false,
        }
    }
}

/// The type of a collision between the ego and an overlapping object; the first matching rule
/// decides.
pub(crate) fn classify_collision(ego: &EgoState, track: &TrackedObject) -> CollisionType {
    if ego.speed() <= STOPPED_SPEED {
        return CollisionType::StoppedEgo;
    }
    if !track.kind.is_agent() || track.speed() <= STOPPED_SPEED {
        return CollisionType::StoppedTrack;
    }
    if is_behind(ego.rear_axle, track.shape.center.position()) {
        return CollisionType::ActiveRear;
    }
    let [left, right] = ego.footprint().front_edge();
    if track.shape.meets_segment(left, right) {
        CollisionType::ActiveFront
    } else {
        CollisionType::ActiveLateral
    }
}

/// nuPlan's "collision energy": the change of the ego's velocity when both masses are equal, m/s.
pub fn delta_v(ego: &EgoState, track: &TrackedObject) -> f64 {
    let (own, other) = (
        ego.speed(),
        if track.kind.is_agent() {
            track.speed()
        } else {
            0.0
        },
    );
    let turn = ego.rear_axle.heading - track.shape.center.heading;
    let squared = own.powi(2) + other.powi(2) - 2.0 * own * other * turn.cos();
    0.5 * squared.max(0.0).sqrt()
}

/// Groups of track types that are counted separately.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CollisionGroup {
    /// Vulnerable road users: pedestrians and bicycles.
    Vru,
    /// Vehicles.
    Vehicle,
    /// Static objects.
    Object,
}

impl CollisionGroup {
    /// In nuPlan's order.
    pub const ALL: [Self; 3] = [Self::Vru, Self::Vehicle, Self::Object];

    /// The group of a kind of object.
    pub(crate) fn from_kind(kind: ObjectKind) -> Self {
        match kind {
            ObjectKind::Pedestrian | ObjectKind::Bicycle => Self::Vru,
            ObjectKind::Vehicle => Self::Vehicle,
            ObjectKind::TrafficCone
            | ObjectKind::Barrier
            | ObjectKind::CzoneSign
            | ObjectKind::GenericObject => Self::Object,
        }
    }

    /// nuPlan's word for the group in the names of statistics.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Vru => "VRUs",
            Self::Vehicle => "vehicles",
            Self::Object => "objects",
        }
    }

    /// At-fault collisions that are still tolerated (devkit
    /// `no_ego_at_fault_collisions_statistics.yaml`).
    pub(crate) fn tolerated(self) -> usize {
        match self {
            Self::Vru | Self::Vehicle => 0,
            Self::Object => 1,
        }
    }
}

/// The first touch of the ego with a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collision {
    /// At which sample.
    pub sample: usize,
    /// When, µs.
    pub time_us: i64,
    /// Which track.
    pub token: TrackToken,
    /// What it is.
    pub kind: ObjectKind,
    /// How it came to it.
    pub collision_type: CollisionType,
    /// Whether the ego could have prevented it.
    pub at_fault: bool,
    /// Change of the ego's velocity, m/s.
    pub delta_v: f64,
}

/// The collisions of a simulation. Each track counts once, at the first sample at which it touches
/// the ego.
pub fn find_collisions(samples: &[HistorySample], lanes: &DrivenLanes) -> Vec<Collision> {
    let mut collided: BTreeSet<TrackToken> = BTreeSet::new();
    let mut found = Vec::new();
    for (i, sample) in samples.iter().enumerate() {
        let shape = sample.ego.footprint();
        for track in sample.objects.iter() {
            if !in_collision(&shape, &track.shape) || !collided.insert(track.token) {
                continue;
            }
            let collision_type = classify_collision(&sample.ego, track);
            found.push(Collision {
                sample: i,
                time_us: sample.ego.time_us,
                token: track.token,
                kind: track.kind,
                collision_type,
                at_fault: collision_type.is_at_fault(!lanes.in_common(i)),
                delta_v: delta_v(&sample.ego, track),
            });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::Vector;

    fn ego(speed: f64) -> EgoState {
        EgoState::from_log(0, Pose::default(), Vector::new(speed, 0.0), Vector::zeros())
    }

    fn track(kind: ObjectKind, center: Pose, speed: f64) -> TrackedObject {
        let velocity = center.direction() * speed;
        TrackedObject {
            token: TrackToken(1),
            kind,
            shape: OrientedBox::new(center, 4.0, 2.0),
            velocity,
        }
    }

    #[test]
    fn the_first_rule_that_holds_decides() {
        let vehicle = |x, y, speed| track(ObjectKind::Vehicle, Pose::new(x, y, 0.0), speed);
        // The ego's box reaches from x = −1.127 to 4.049 and |y| ≤ 1.1485.
        let cases = [
            (ego(0.05), vehicle(5.0, 0.0, 5.0), CollisionType::StoppedEgo),
            (
                ego(5.0),
                vehicle(5.0, 0.0, 0.05),
                CollisionType::StoppedTrack,
            ),
            (
                ego(5.0),
                track(ObjectKind::TrafficCone, Pose::new(-3.0, 0.0, 0.0), 0.0),
                CollisionType::StoppedTrack,
            ),
            (ego(5.0), vehicle(-3.0, 0.5, 6.0), CollisionType::ActiveRear),
            (ego(5.0), vehicle(5.5, 0.5, 3.0), CollisionType::ActiveFront),
            (
                ego(5.0),
                vehicle(0.0, 2.0, 6.0),
                CollisionType::ActiveLateral,
            ),
        ];
        for (ego, track, expected) in cases {
            assert!(in_collision(&ego.footprint(), &track.shape));
            assert_eq!(classify_collision(&ego, &track), expected, "{track:?}");
        }
    }

    #[test]
    fn only_lateral_collisions_depend_on_the_lane() {
        for kind in [CollisionType::StoppedTrack, CollisionType::ActiveFront] {
            assert!(kind.is_at_fault(false) && kind.is_at_fault(true));
        }
        assert!(
            CollisionType::ActiveLateral.is_at_fault(true)
                && !CollisionType::ActiveLateral.is_at_fault(false)
        );
        for kind in [CollisionType::StoppedEgo, CollisionType::ActiveRear] {
            assert!(!kind.is_at_fault(true));
        }
    }

    #[test]
    fn sectors_have_open_limits() {
        let at = |degrees: f64| Point::new(degrees.to_radians().cos(), degrees.to_radians().sin());
        let axle = Pose::default();
        assert!(is_ahead(axle, at(29.9)) && !is_ahead(axle, at(30.1)) && is_ahead(axle, at(-29.9)));
        assert!(is_behind(axle, at(150.1)) && !is_behind(axle, at(149.9)));
    }

    #[test]
    fn equal_masses_share_the_velocity_difference() {
        let head_on = track(ObjectKind::Vehicle, Pose::new(4.0, 0.0, PI), 3.0);
        assert!((delta_v(&ego(5.0), &head_on) - 4.0).abs() < 1e-12);
        let cone = track(ObjectKind::TrafficCone, Pose::new(4.0, 0.0, PI), 0.0);
        assert!((delta_v(&ego(5.0), &cone) - 2.5).abs() < 1e-12);
    }
}
