//! Lane changes: the target track, whether there is room, and the lateral path.

use super::mover::{Act, Mover, Shift};
use super::state::{Body, Traffic};
use super::track::Track;
use planagent_world::geometry::wrap_angle;
use std::sync::Arc;

/// What the expert does about the ego's lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum LaneCommand {
    Keep,
    /// Change to the neighboring lane as soon as there is room.
    Change {
        left: bool,
        /// Distance for the lane change, meters.
        within: f64,
    },
    /// Keep this offset from the centerline, meters to the left.
    Offset(f64),
}

/// Room that a driver needs for a lane change.
#[derive(Debug, Clone, Copy)]
struct Room {
    /// Minimum gap ahead and behind, meters.
    gap: f64,
    /// Headway of the vehicle behind, seconds.
    behind: f64,
}

/// Minimum length of a lane change, meters.
const MIN_LENGTH: f64 = 12.0;
const POLITE: Room = Room {
    gap: 3.0,
    behind: 0.6,
};
const PUSHY: Room = Room {
    gap: 3.5,
    behind: 0.15,
};

impl Traffic<'_> {
    /// Executes the scripted actions whose time has come.
    pub(super) fn play_scripts(&mut self, bodies: &[Body]) {
        /// Time after which a lane change without room is tried again, seconds.
        const RETRY: f64 = 0.3;
        for i in 0..self.movers.len() {
            while let Some(&act) = self.movers[i]
                .script
                .last()
                .filter(|act| act.at() <= self.time)
            {
                self.movers[i].script.pop();
                match act {
                    Act::Limit { speed, .. } => self.movers[i].speed_cap = speed,
                    Act::ChangeLane { left, .. } => {
                        if !self.change_lane(i, left, f64::INFINITY, PUSHY, bodies) {
                            let again = Act::ChangeLane {
                                at: self.time + RETRY,
                                left,
                            };
                            let place = self.movers[i]
                                .script
                                .partition_point(|act| act.at() > again.at());
                            self.movers[i].script.insert(place, again);
                        }
                    }
                }
            }
        }
    }

    pub(super) fn follow_command(&mut self, command: LaneCommand, bodies: &[Body]) {
        match command {
            LaneCommand::Keep => {}
            LaneCommand::Change { left, within } => {
                self.change_lane(0, left, within, POLITE, bodies);
            }
            LaneCommand::Offset(lateral) => {
                let ego = &mut self.movers[0];
                if !ego.is_changing() && (ego.shift.to_d - lateral).abs() > 0.05 {
                    let length = (ego.speed * 2.5).max(9.0);
                    let (from_d, from_slope) = ego.shift.at(ego.s);
                    ego.shift = Shift {
                        from_s: ego.s,
                        to_s: ego.s + length,
                        from_d,
                        to_d: lateral,
                        from_slope,
                    };
                }
            }
        }
    }

    /// Starts a lane change if there is a lane on that side and room on it; true if it did.
    fn change_lane(
        &mut self,
        i: usize,
        left: bool,
        within: f64,
        room: Room,
        bodies: &[Body],
    ) -> bool {
        let mover = &self.movers[i];
        let Some(track) = self.track_beside(mover, left) else {
            return false;
        };
        let reference = mover.pose().position();
        let (s, lateral) = track.project_exactly(reference);
        let length = (mover.speed * 4.0).min(within).clamp(MIN_LENGTH, 70.0);
        if mover.is_between_lanes()
            || (mover.is_changing() && mover.speed > 1.0)
            || s + length > track.length()
        {
            return false;
        }
        // The lane change ends before the next junction.
        if track.span_at(s + length * 0.8).lane != track.span_at(s).lane
            && !self.has_no_crossing(&track, s, s + length)
        {
            return false;
        }
        if !has_room(mover, &track, s, room, bodies, i) {
            return false;
        }
        self.movers[i].change_track(Arc::new(track), s, lateral, length);
        true
    }

    /// True if there are only joints (no crossings) between two arc lengths.
    fn has_no_crossing(&self, track: &Track, from: f64, to: f64) -> bool {
        let within = track
            .spans
            .iter()
            .filter(|span| span.connector && span.to > from && span.from < to);
        within.into_iter().all(|span| {
            self.roads.passages[span.lane.index()]
                .as_ref()
                .is_none_or(|passage| passage.conflicts.is_empty())
        })
    }

    /// The track from the lane beside a mover's own. The ego's stays on its route.
    fn track_beside(&self, mover: &Mover, left: bool) -> Option<Track> {
        let span = mover.track.span_at(mover.s);
        let along = mover.s - span.from;
        let lane = &self.roads.map[span.lane];
        let beside = if left {
            lane.left_at(along)
        } else {
            lane.right_at(along)
        }?;
        if lane.is_connector() {
            return None;
        }
        let place = self
            .roads
            .route_lanes
            .iter()
            .position(|lanes| lanes.contains(&beside));
        let chain = match place {
            Some(place) => self.roads.chain_on_route(place, beside),
            None => self.roads.straight_chain(beside),
        };
        Track::along(self.roads, chain)
    }
}

/// True if a mover has room on a track at arc length `s`.
fn has_room(mover: &Mover, track: &Track, s: f64, room: Room, bodies: &[Body], i: usize) -> bool {
    let (front, rear) = (s + mover.front, s - mover.back());
    bodies
        .iter()
        .filter(|body| body.mover != Some(i))
        .all(|body| {
            let half = body.shape.length / 2.0;
            let center = body.shape.center.position();
            let (at, lateral) = track.project(center, s - 60.0, s + 60.0);
            let turned = wrap_angle(body.shape.center.heading - track.pose_at(at).heading);
            let across =
                (half * turned.sin()).abs() + (body.shape.width / 2.0 * turned.cos()).abs();
            if lateral.abs() > across + mover.width / 2.0 + 0.3 {
                return true;
            }
            let speed = body.speed * turned.cos();
            let along = (half * turned.cos()).abs() + (body.shape.width / 2.0 * turned.sin()).abs();
            if at >= s {
                let closing = (mover.speed - speed).max(0.0);
                at - along - front > room.gap + closing * closing / 3.0 + closing
            } else {
                let closing = (speed - mover.speed).max(0.0);
                rear - at - along > room.gap + speed * room.behind + 1.5 * closing
            }
        })
}
