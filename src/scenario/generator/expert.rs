//! The generator's expert: a rule-based driver with privileged knowledge, which controls the ego
//! and so makes the log.
//!
//! * It follows the lanes of its route with the intelligent driver model. It reacts to everything
//!   in its path or about to enter it: lead vehicles, cut-ins, red lights, stop signs, crossing
//!   pedestrians, and drivers with the right of way.
//! * It slows down ahead of bends (1.8 m/s² of lateral acceleration at most) and lower limits,
//!   never exceeds the limit, and bounds its jerk.
//! * Where its path bends more sharply than the lane, it slows down further: to 0.25 rad/s of the
//!   front wheels' angle and 2.2 m/s² of lateral acceleration. nuPlan's tracker follows that.
//! * It changes lanes where its lane is blocked or leads off its route, to pass slow traffic, or
//!   when its task says so. The path is a quintic of about four seconds and needs room. Within 8 m
//!   behind an obstacle it stays.
//! * On a single lane it passes objects at the curb within its lane.
//!
//! Its privileged knowledge: which vehicles stand permanently, and the task of the scenario type.

use super::traffic::{DriverProfile, LaneCommand, Mover, Steering, Traffic};
use planagent_world::geometry::wrap_angle;

/// How the expert drives, in the units of [`DriverProfile`]: values of ours, within nuPlan's bounds
/// of comfort.
pub(crate) const EXPERT: DriverProfile = DriverProfile {
    speed_factor: 0.97,
    min_gap: 2.0,
    headway: 1.3,
    accel: 1.6,
    decel: 2.2,
    gap_margin: 2.0,
    jerk: 2.6,
    max_braking: 3.9,
    steering: Some(Steering {
        rate: MAX_STEERING_RATE,
        lateral: MAX_LATERAL_ACCELERATION,
    }),
};
/// Maximum rate of the front wheels' angle, rad/s. Up to this rate, nuPlan's tracker follows a log
/// that is sampled every 0.5 s within about a meter; above it, the tracked ego cuts corners and
/// swings wide.
const MAX_STEERING_RATE: f64 = 0.25;
/// Maximum lateral acceleration on the path, m/s².
const MAX_LATERAL_ACCELERATION: f64 = 2.2;
/// Range ahead in which obstacles in the lane count, meters.
const BLOCKED_LOOKAHEAD: f64 = 75.0;
/// Minimum distance to an obstacle for a lane change, meters. From nearer, the wheels would have to
/// turn faster than nuPlan's tracker follows from a standstill.
const MIN_ROOM_TO_LEAVE: f64 = 8.0;
/// Range ahead in which objects that can be passed within the lane count, meters.
const NUDGE_LOOKAHEAD: f64 = 35.0;
/// The expert passes a lead vehicle that is slower than this share of the allowed speed.
const SLOW_SHARE: f64 = 0.6;
/// Distance at which the expert leaves a lane that leads off the route, meters.
const OFF_ROUTE_LOOKAHEAD: f64 = 140.0;
/// Clearance to an object that is passed within the lane, meters.
const NUDGE_ROOM: f64 = 0.55;
/// Maximum offset from the centerline within the lane, meters.
const MAX_NUDGE: f64 = 1.3;

/// What the scenario type asks of the expert.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct ExpertTask {
    /// Time of a lane change, seconds, and whether it is to the left.
    pub(crate) change: Option<(f64, bool)>,
    /// True if it passes slow traffic.
    pub(crate) overtakes: bool,
}

/// The expert and its memory between steps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Expert {
    task: ExpertTask,
    /// True after the lane change of the task.
    changed: bool,
    /// Seconds behind slow traffic.
    slowed_for: f64,
}

impl Expert {
    pub(crate) fn new(task: ExpertTask) -> Self {
        Self {
            task,
            changed: false,
            slowed_for: 0.0,
        }
    }

    /// Where it stops its front before an obstacle in its lane: with room to leave the lane. If the
    /// obstacle appears nearer than that (a breakdown), where it can stop comfortably.
    pub(crate) fn stop_s(traffic: &Traffic<'_>) -> Option<f64> {
        /// Distance to the obstacle, meters.
        const ROOM_TO_LEAVE: f64 = 9.5;
        let ego = &traffic.movers[0];
        let comfortable = ego.front_s() + ego.speed * ego.speed / (2.0 * EXPERT.decel);
        match blocked(traffic) {
            Some(Obstacle::Lane(at)) if !ego.is_between_lanes() => {
                Some((at - ROOM_TO_LEAVE).max(comfortable))
            }
            _ => None,
        }
    }

    /// What it does about its lane now.
    pub(crate) fn lane_command(&mut self, traffic: &Traffic<'_>) -> LaneCommand {
        let ego = &traffic.movers[0];
        // A lane change is finished first. An offset within the lane may become a lane change after
        // a stop.
        if ego.is_changing() && (ego.is_between_lanes() || ego.speed > 1.0) {
            return LaneCommand::Keep;
        }
        if let Some((moment, left)) = self
            .task
            .change
            .filter(|task| !self.changed && traffic.time >= task.0)
        {
            let lane = ego.track.span_at(ego.s).lane;
            self.changed = self.changed || traffic.time > moment + 8.0;
            let target = traffic.roads.map[lane]
                .left
                .iter()
                .chain(&traffic.roads.map[lane].right)
                .any(|_| true);
            if target {
                return LaneCommand::Change {
                    left,
                    within: f64::INFINITY,
                };
            }
        }
        if let Some(left) = leaves_route(traffic) {
            return LaneCommand::Change {
                left,
                within: f64::INFINITY,
            };
        }
        let nudge = match blocked(traffic) {
            Some(Obstacle::Lane(at)) => {
                let within = at - ego.front_s();
                if let Some(left) = better_side(traffic).filter(|_| within > MIN_ROOM_TO_LEAVE) {
                    return LaneCommand::Change { left, within };
                }
                0.0
            }
            Some(Obstacle::Edge(lateral)) => lateral,
            None => 0.0,
        };
        self.slowed_for = if self.task.overtakes && behind_slow_traffic(traffic) {
            self.slowed_for + 0.1
        } else {
            0.0
        };
        if self.slowed_for > 1.5
            && let Some(left) = better_side(traffic)
        {
            return LaneCommand::Change {
                left,
                within: f64::INFINITY,
            };
        }
        LaneCommand::Offset(nudge)
    }

    /// Notes that a lane change has begun.
    pub(crate) fn note_change(&mut self) {
        self.changed = true;
        self.slowed_for = 0.0;
    }
}

/// What permanent obstacles leave of the ego's lane.
enum Obstacle {
    /// The lane is blocked from this arc length on.
    Lane(f64),
    /// There is room to pass at this offset, meters to the left.
    Edge(f64),
}

/// The permanent obstacles in the ego's lane ahead: objects and broken-down vehicles.
fn blocked(traffic: &Traffic<'_>) -> Option<Obstacle> {
    let ego = &traffic.movers[0];
    let half = ego.width / 2.0;
    let standing = traffic.fixtures.iter().map(|object| object.shape);
    let broken = traffic.movers[1..]
        .iter()
        .filter(|m| !m.gone && m.speed_cap < 0.3 && m.speed < 0.3)
        .map(Mover::shape);
    // An object on the right pushes the ego to the left, and one on the left to the right.
    let (mut to_left, mut to_right, mut begins) = (0.0f64, 0.0f64, f64::INFINITY);
    for shape in standing.chain(broken) {
        let reach = shape.length / 2.0;
        let pose = ego.track.pose_at(ego.s);
        let to = shape.center.position() - pose.position();
        if to.norm() > BLOCKED_LOOKAHEAD + reach || pose.direction().dot(&to) < -reach - 6.0 {
            continue;
        }
        let (s, lateral) = ego.track.project(
            shape.center.position(),
            ego.s - 8.0,
            ego.s + BLOCKED_LOOKAHEAD,
        );
        let turned = wrap_angle(shape.center.heading - ego.track.pose_at(s).heading);
        let across = (reach * turned.sin()).abs() + (shape.width / 2.0 * turned.cos()).abs();
        // An object behind the rear bumper is passed.
        if s + reach < ego.rear_s() - 1.0 || lateral.abs() - across > half + NUDGE_ROOM {
            continue;
        }
        let pushes = if lateral < 0.0 {
            lateral + across
        } else {
            across - lateral
        } + half
            + NUDGE_ROOM;
        if pushes <= MAX_NUDGE && s - ego.front_s() > NUDGE_LOOKAHEAD {
            continue;
        }
        let along = (reach * turned.cos()).abs() + (shape.width / 2.0 * turned.sin()).abs();
        begins = begins.min(s - along);
        if lateral < 0.0 {
            to_left = to_left.max(lateral + across + half + NUDGE_ROOM);
        } else {
            to_right = to_right.min(lateral - across - half - NUDGE_ROOM);
        }
    }
    if to_left > MAX_NUDGE || to_right < -MAX_NUDGE || (to_left > 0.0 && to_right < 0.0) {
        Some(Obstacle::Lane(begins))
    } else if to_left > 0.0 || to_right < 0.0 {
        Some(Obstacle::Edge(to_left + to_right))
    } else {
        None
    }
}

/// True (left) or false (right) if the lane leads off the route and a lane on that side stays on it
/// longest.
fn leaves_route(traffic: &Traffic<'_>) -> Option<bool> {
    let (ego, roads) = (&traffic.movers[0], traffic.roads);
    let span = ego.track.span_at(ego.s);
    let place = roads
        .route_lanes
        .iter()
        .position(|lanes| lanes.contains(&span.lane))?;
    if span.to - ego.s > OFF_ROUTE_LOOKAHEAD {
        return None;
    }
    let lanes = &roads.route_lanes[place];
    let here = lanes.iter().position(|&lane| lane == span.lane)?;
    let own = roads.reach(place, span.lane);
    let best = lanes.iter().map(|&lane| roads.reach(place, lane)).max()?;
    if own > place || best <= own {
        return None;
    }
    let target = (0..lanes.len())
        .filter(|&i| roads.reach(place, lanes[i]) == best)
        .min_by_key(|&i| i.abs_diff(here))?;
    Some(target < here)
}

/// The side on which the ego can pass, true for the left: left first, if that lane stays on the
/// route as long.
fn better_side(traffic: &Traffic<'_>) -> Option<bool> {
    let (ego, roads) = (&traffic.movers[0], traffic.roads);
    let span = ego.track.span_at(ego.s);
    let place = roads
        .route_lanes
        .iter()
        .position(|lanes| lanes.contains(&span.lane))?;
    let lanes = &roads.route_lanes[place];
    let here = lanes.iter().position(|&lane| lane == span.lane)?;
    let stays =
        |i: usize| roads.reach(place, lanes[i]) > place || roads.reach(place, lanes[here]) == place;
    if here > 0 && stays(here - 1) {
        Some(true)
    } else if here + 1 < lanes.len() && stays(here + 1) {
        Some(false)
    } else {
        None
    }
}

/// True if a driver ahead in the ego's lane is much slower than the road allows.
fn behind_slow_traffic(traffic: &Traffic<'_>) -> bool {
    let ego = &traffic.movers[0];
    let allowed = ego.track.allowed_at(ego.s);
    traffic.movers[1..]
        .iter()
        .filter(|mover| !mover.gone && mover.speed_cap < SLOW_SHARE * allowed)
        .any(|mover| {
            let center = mover.shape().center.position();
            let (s, lateral) = ego.track.project(center, ego.s, ego.s + 40.0);
            s > ego.s + 1.0
                && lateral.abs() < 1.5
                && (ego.track.pose_at(s).position() - center).norm() < 2.0
        })
}
