//! The generator's expert: a rule-based driver with privileged knowledge, whose drive becomes the log.
//!
//! It drives along the lanes of its way with the intelligent driver model against everything that is in its way or about
//! to be: leads, cut-ins, red lights, stop signs, pedestrians on their way across, drivers who go first. It slows down
//! ahead of bends (1.8 m/s² across at most) and lower limits, never exceeds the limit, and limits its jerk. Where its own path
//! bends more sharply than the lane (a lane change, a tight turn), it slows down until the front wheels turn at no more than
//! 0.25 rad/s and the path asks for no more than 2.2 m/s² across: what nuPlan's tracker follows. It changes lanes
//! where its own is blocked, where its lane leads off its way, to pass slow traffic, or when its recipe says so, along a
//! quintic path within about four seconds, if there is room; from nearer than 8 m behind an obstacle it stays. On a single
//! lane it passes what stands at the kerb within its lane. What it knows beyond a planner: which vehicles stand for good,
//! and what the recipe wants.

use super::traffic::{DriverProfile, Mover, Steering, Traffic, Wish};
use crate::geometry::wrap_angle;

/// How the expert drives.
pub(crate) const EXPERT: DriverProfile = DriverProfile {
    speed_factor: 0.97,
    min_gap: 2.0,
    headway: 1.3,
    accel: 1.6,
    decel: 2.2,
    gap_margin: 2.0,
    jerk: 2.6,
    max_braking: 3.9,
    steering: Some(Steering { rate: STEERING_RATE, lateral: LATERAL_ACCELERATION }),
};
/// How fast the expert turns the front wheels at most, rad/s. nuPlan's tracker follows a log that is sampled every 0.5 s
/// within about a metre up to this rate; above it the tracked ego cuts corners and swings wide.
const STEERING_RATE: f64 = 0.25;
/// Lateral acceleration that the expert accepts on its path, m/s².
const LATERAL_ACCELERATION: f64 = 2.2;
/// How far ahead the expert looks for what blocks its lane, metres.
const BLOCKED_SIGHT: f64 = 75.0;
/// Nearer than this to what blocks its lane it no longer goes round it, metres: the wheels would have to be turned harder
/// than nuPlan's tracker follows from a standstill.
const ROOM_TO_GO_ROUND: f64 = 8.0;
/// How far ahead it looks for what it can pass within its lane, metres.
const NUDGE_SIGHT: f64 = 35.0;
/// A lead slower than this share of the allowed speed is worth passing.
const SLOW_SHARE: f64 = 0.6;
/// How far before its lane leads off the way the expert leaves it, metres.
const OFF_WAY_SIGHT: f64 = 140.0;
/// Room kept to what is passed within the lane, metres.
const NUDGE_ROOM: f64 = 0.55;
/// Furthest move off the centreline within the lane, metres.
const MAX_NUDGE: f64 = 1.3;

/// What the recipe wants of the expert.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Task {
    /// Change lanes at this moment (seconds), to the left or not.
    pub(crate) change: Option<(f64, bool)>,
    /// Whether it passes slow traffic.
    pub(crate) overtakes: bool,
}

/// The expert with what it remembers between steps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Expert {
    task: Task,
    changed: bool,
    slowed_for: f64,
}

impl Expert {
    /// An expert with a task.
    pub(crate) fn new(task: Task) -> Self {
        Self { task, changed: false, slowed_for: 0.0 }
    }

    /// Where it wants to stop of its own accord: so far before a closed lane that there is room to leave it, or, when a
    /// vehicle breaks down nearer than that, where it can stop comfortably.
    pub(crate) fn halt(traffic: &Traffic<'_>) -> Option<f64> {
        /// Distance kept to what closes the lane, metres.
        const ROOM_TO_LEAVE: f64 = 9.5;
        let ego = &traffic.movers[0];
        let comfortable = ego.front_s() + ego.speed * ego.speed / (2.0 * EXPERT.decel);
        match blocked(traffic) {
            Some(Obstacle::Lane(at)) if !ego.is_between_lanes() => Some((at - ROOM_TO_LEAVE).max(comfortable)),
            _ => None,
        }
    }

    /// What it wants to do with its place across the road now.
    pub(crate) fn wish(&mut self, traffic: &Traffic<'_>) -> Wish {
        let ego = &traffic.movers[0];
        // A lane change is finished first; keeping clear within the lane may be given up for one when it has come to a stop.
        if ego.is_changing() && (ego.is_between_lanes() || ego.speed > 1.0) {
            return Wish::Keep;
        }
        if let Some((moment, left)) = self.task.change.filter(|task| !self.changed && traffic.time >= task.0) {
            let lane = ego.track.span_at(ego.s).lane;
            self.changed = self.changed || traffic.time > moment + 8.0;
            let target = traffic.roads.map[lane].left.iter().chain(&traffic.roads.map[lane].right).any(|_| true);
            if target {
                return Wish::Change { left, within: f64::INFINITY };
            }
        }
        if let Some(left) = leaves_way(traffic) {
            return Wish::Change { left, within: f64::INFINITY };
        }
        let nudge = match blocked(traffic) {
            Some(Obstacle::Lane(at)) => {
                let within = at - ego.front_s();
                if let Some(left) = better_side(traffic).filter(|_| within > ROOM_TO_GO_ROUND) {
                    return Wish::Change { left, within };
                }
                0.0
            }
            Some(Obstacle::Edge(lateral)) => lateral,
            None => 0.0,
        };
        self.slowed_for = if self.task.overtakes && behind_slow_traffic(traffic) { self.slowed_for + 0.1 } else { 0.0 };
        if self.slowed_for > 1.5
            && let Some(left) = better_side(traffic)
        {
            return Wish::Change { left, within: f64::INFINITY };
        }
        Wish::Nudge(nudge)
    }

    /// Tells the expert that a lane change has begun.
    pub(crate) fn note_change(&mut self) {
        self.changed = true;
        self.slowed_for = 0.0;
    }
}

/// What stands in the ego's lane for good.
enum Obstacle {
    /// The lane is closed from this arc length on.
    Lane(f64),
    /// There is room to pass at this offset, metres to the left.
    Edge(f64),
}

/// What stands for good in the ego's lane ahead.
fn blocked(traffic: &Traffic<'_>) -> Option<Obstacle> {
    let ego = &traffic.movers[0];
    let half = ego.width / 2.0;
    let standing = traffic.fixtures.iter().map(|object| object.shape);
    let broken = traffic.movers[1..].iter().filter(|m| !m.gone && m.speed_cap < 0.3 && m.speed < 0.3).map(Mover::shape);
    // What stands to the right pushes the ego to the left and the other way round.
    let (mut to_left, mut to_right, mut begins) = (0.0f64, 0.0f64, f64::INFINITY);
    for shape in standing.chain(broken) {
        let reach = shape.length / 2.0;
        let pose = ego.track.pose_at(ego.s);
        let to = shape.center.position() - pose.position();
        if to.norm() > BLOCKED_SIGHT + reach || pose.direction().dot(&to) < -reach - 6.0 {
            continue;
        }
        let (s, lateral) = ego.track.project(shape.center.position(), ego.s - 8.0, ego.s + BLOCKED_SIGHT);
        let turned = wrap_angle(shape.center.heading - ego.track.pose_at(s).heading);
        let across = (reach * turned.sin()).abs() + (shape.width / 2.0 * turned.cos()).abs();
        // Behind the rear bumper there is nothing left to pass.
        if s + reach < ego.rear_s() - 1.0 || lateral.abs() - across > half + NUDGE_ROOM {
            continue;
        }
        let pushes = if lateral < 0.0 { lateral + across } else { across - lateral } + half + NUDGE_ROOM;
        if pushes <= MAX_NUDGE && s - ego.front_s() > NUDGE_SIGHT {
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

/// Whether the present lane leads off the way while a neighbour stays on it, and on which side that one is.
fn leaves_way(traffic: &Traffic<'_>) -> Option<bool> {
    let (ego, roads) = (&traffic.movers[0], traffic.roads);
    let span = ego.track.span_at(ego.s);
    let place = roads.way.iter().position(|lanes| lanes.contains(&span.lane))?;
    if span.to - ego.s > OFF_WAY_SIGHT {
        return None;
    }
    let lanes = &roads.way[place];
    let here = lanes.iter().position(|&lane| lane == span.lane)?;
    let own = roads.reach(place, span.lane);
    let best = lanes.iter().map(|&lane| roads.reach(place, lane)).max()?;
    if own > place || best <= own {
        return None;
    }
    let target =
        (0..lanes.len()).filter(|&i| roads.reach(place, lanes[i]) == best).min_by_key(|&i| i.abs_diff(here))?;
    Some(target < here)
}

/// The side to which the ego can go round: left first, if that lane goes as far.
fn better_side(traffic: &Traffic<'_>) -> Option<bool> {
    let (ego, roads) = (&traffic.movers[0], traffic.roads);
    let span = ego.track.span_at(ego.s);
    let place = roads.way.iter().position(|lanes| lanes.contains(&span.lane))?;
    let lanes = &roads.way[place];
    let here = lanes.iter().position(|&lane| lane == span.lane)?;
    let stays = |i: usize| roads.reach(place, lanes[i]) > place || roads.reach(place, lanes[here]) == place;
    if here > 0 && stays(here - 1) {
        Some(true)
    } else if here + 1 < lanes.len() && stays(here + 1) {
        Some(false)
    } else {
        None
    }
}

/// Whether a driver ahead in the ego's lane is much slower than the road allows.
fn behind_slow_traffic(traffic: &Traffic<'_>) -> bool {
    let ego = &traffic.movers[0];
    let allowed = ego.track.allowed_at(ego.s);
    traffic.movers[1..].iter().filter(|mover| !mover.gone && mover.speed_cap < SLOW_SHARE * allowed).any(|mover| {
        let center = mover.shape().center.position();
        let (s, lateral) = ego.track.project(center, ego.s, ego.s + 40.0);
        s > ego.s + 1.0 && lateral.abs() < 1.5 && (ego.track.pose_at(s).position() - center).norm() < 2.0
    })
}
