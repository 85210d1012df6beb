//! The log of a generated scenario: runs the traffic with the expert as the ego's driver, records
//! it and checks it.

use super::expert::Expert;
use super::scene::setting::SETTLING;
use super::traffic::Traffic;
use crate::{FUTURE_FRAMES, Frame};
use planagent_world::geometry::{Point, Vector, wrap_angle};
use planagent_world::{
    EgoState, HISTORY_SAMPLES, LaneId, LaneMap, ObjectKind, PACIFICA, STEP_S, STEP_US,
    SignalStatus, TrackedObject, TrafficLights,
};
use std::sync::Arc;

/// Iterations of a scenario: 15 s at 10 Hz, both ends included.
pub(super) const ITERATIONS: usize = 151;
/// Frames before iteration 0.
pub(super) const PAST: usize = HISTORY_SAMPLES - 1;
/// Objects farther from the ego than this are not recorded, meters.
const RECORDED_WITHIN: f64 = 100.0;
/// Objects nearer to the ego than this must not collide with each other, meters.
const CHECKED_WITHIN: f64 = 100.0;
/// Time stamp of iteration 0, µs.
const START_US: i64 = 10_000_000;

/// Why a draw is discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum Discard {
    #[error("the expert collides")]
    Collision,
    #[error("other agents collide near the ego")]
    OthersCollide,
    #[error("the expert leaves the drivable area")]
    OffRoad,
    #[error("the ego reaches the end of the roads")]
    RoadEnds,
    #[error("the log does not show what its scenario type says")]
    OtherType,
    #[error("the situation differs from that of the seed")]
    OtherSituation,
    #[error("the roads overlap or have no extent")]
    Roads,
}

/// A recorded log, and what the checks of the scenario types need.
pub struct GeneratedLog {
    pub(super) frames: Vec<Frame>,
    map: Arc<LaneMap>,
    /// Lane under the center of the ego's box, by frame.
    lanes: Vec<LaneId>,
    /// Curvature of the ego's path, 1/m, by frame.
    curvatures: Vec<f64>,
    /// True where the ego is between two lanes, by frame.
    changing: Vec<bool>,
}

impl GeneratedLog {
    /// Runs the traffic and records it until a draw must be discarded.
    pub(super) fn record(traffic: &mut Traffic<'_>, expert: &mut Expert) -> Result<Self, Discard> {
        let map = traffic.roads.map.clone();
        let settling = (SETTLING / STEP_S).round() as usize;
        let mut log = Self {
            frames: Vec::with_capacity(PAST + ITERATIONS),
            map: map.clone(),
            lanes: Vec::new(),
            curvatures: Vec::new(),
            changing: Vec::new(),
        };
        let mut lights = Arc::new(traffic.lights());
        for step in 0..settling + PAST + ITERATIONS {
            if step >= settling {
                let now = traffic.lights();
                if *lights != now {
                    lights = Arc::new(now);
                }
                log.record_frame(
                    traffic,
                    (step - settling) as i64 - PAST as i64,
                    lights.clone(),
                )?;
            }
            advance(traffic, expert);
        }
        Ok(log)
    }

    fn record_frame(
        &mut self,
        traffic: &Traffic<'_>,
        iteration: i64,
        lights: Arc<TrafficLights>,
    ) -> Result<(), Discard> {
        let ego = &traffic.movers[0];
        let (state, objects) = observe(traffic, &self.map, iteration)?;
        self.frames.push(Frame {
            ego: state,
            objects,
            lights,
        });
        self.lanes.push(
            ego.track
                .span_at(ego.s + PACIFICA.rear_axle_to_center())
                .lane,
        );
        self.curvatures.push(ego.path_curvature(ego.s));
        self.changing.push(ego.is_between_lanes());
        Ok(())
    }

    /// The ego after the last frame: the traffic runs on, for eight seconds or until the ego
    /// collides or leaves the roads.
    pub(super) fn future(&self, traffic: &mut Traffic<'_>, expert: &mut Expert) -> Vec<EgoState> {
        let mut future = Vec::with_capacity(FUTURE_FRAMES);
        for step in 0..FUTURE_FRAMES {
            let Ok((ego, _)) = observe(traffic, &self.map, (ITERATIONS + step) as i64) else {
                break;
            };
            future.push(ego);
            advance(traffic, expert);
        }
        future
    }

    /// The frames from iteration 0 on, with their indices.
    fn simulated(&self) -> impl Iterator<Item = (usize, &Frame)> {
        self.frames.iter().enumerate().skip(PAST)
    }

    /// True if the heading changes by more than `angle` radians (negative: to the right) within 8
    /// s.
    pub fn turns(&self, angle: f64) -> bool {
        let headings: Vec<f64> = self
            .simulated()
            .map(|(_, frame)| frame.ego.rear_axle.heading)
            .collect();
        (0..headings.len()).any(|i| {
            let end = (i + 80).min(headings.len() - 1);
            wrap_angle(headings[end] - headings[i]) * angle.signum() > angle.abs()
        })
    }

    /// True if the ego drives on a connector with traffic lights.
    pub(crate) fn crosses_a_light(&self) -> bool {
        self.simulated()
            .any(|(i, frame)| self.map[self.lanes[i]].has_traffic_lights && frame.ego.speed() > 1.0)
    }

    /// True if the ego is on a connector that others cross or join.
    pub fn in_intersection(&self) -> bool {
        self.simulated().any(|(i, frame)| {
            let point = frame.ego.center().position();
            self.map[self.lanes[i]].is_connector() && self.map.lanes_at(point).len() > 1
        })
    }

    /// The lead vehicle in a frame, and the gap to it, meters.
    fn lead(frame: &Frame) -> Option<(f64, &TrackedObject)> {
        let (front, own) = (frame.ego.center(), frame.ego.footprint());
        let leads = frame
            .objects
            .iter()
            .filter(|object| object.kind == ObjectKind::Vehicle)
            .filter_map(move |object| {
                let local = front.to_local(object.shape.center.position());
                let turned = wrap_angle(object.shape.center.heading - front.heading).abs();
                let ahead = local.x > 0.0 && local.y.abs() < 1.2 + 0.03 * local.x && turned < 0.6;
                ahead.then(|| (own.distance(&object.shape), object))
            });
        leads.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// True if the ego drives and then stops, or nearly so, behind a vehicle.
    pub(crate) fn stops_behind_lead(&self) -> bool {
        let (mut moved, mut stopped) = (false, false);
        for (_, frame) in self.simulated() {
            moved |= frame.ego.speed() > 3.0;
            stopped |= moved
                && frame.ego.speed() < 0.4
                && Self::lead(frame).is_some_and(|(gap, _)| gap < 7.0);
        }
        stopped
    }

    /// True if the ego follows a vehicle within `gap` meters at more than `speed` m/s for two
    /// seconds in all.
    pub fn follows(&self, gap: f64, speed: f64) -> bool {
        let follows = |frame: &Frame| {
            frame.ego.speed() > speed
                && Self::lead(frame).is_some_and(|(d, o)| d < gap && o.speed() > speed / 2.0)
        };
        self.simulated().filter(|(_, frame)| follows(frame)).count() >= 20
    }

    /// True if the ego is within 25 m behind a vehicle longer than 8 m for two seconds in all.
    pub(crate) fn behind_long(&self) -> bool {
        let long = |frame: &Frame| {
            Self::lead(frame).is_some_and(|(gap, o)| gap < 25.0 && o.shape.length > 8.0)
        };
        self.simulated().filter(|(_, frame)| long(frame)).count() >= 20
    }

    /// True if the ego stands with at least four vehicles within 25 m in the first 6 s.
    pub(crate) fn stands_in_traffic(&self) -> bool {
        self.simulated()
            .take(60)
            .any(|(_, frame)| frame.ego.speed() < 0.1 && vehicles_within(frame, 25.0) >= 4)
    }

    /// True if the ego moves faster than 3 m/s with at least `count` vehicles within 25 m.
    pub(crate) fn near_vehicles(&self, count: usize) -> bool {
        self.simulated()
            .any(|(_, frame)| frame.ego.speed() > 3.0 && vehicles_within(frame, 25.0) >= count)
    }

    /// True if the ego moves, but slower than `speed` m/s, for two seconds in all.
    pub fn slow(&self, speed: f64) -> bool {
        self.simulated()
            .filter(|(_, frame)| (0.2..speed).contains(&frame.ego.speed()))
            .count()
            >= 20
    }

    /// True if the ego is faster than `speed` m/s.
    pub fn fast(&self, speed: f64) -> bool {
        self.simulated().any(|(_, frame)| frame.ego.speed() > speed)
    }

    /// True if the lateral acceleration exceeds `bound` m/s².
    pub fn lateral(&self, bound: f64) -> bool {
        self.simulated()
            .any(|(i, frame)| self.curvatures[i].abs() * frame.ego.speed().powi(2) > bound)
    }

    /// True if the ego is between two lanes for 1.5 s in all.
    pub fn changes_lane(&self) -> bool {
        self.simulated().filter(|&(i, _)| self.changing[i]).count() >= 15
    }

    /// True if the ego drives slower than 1.5 m/s while a pedestrian walks within 20 m ahead.
    pub(crate) fn waits_for_pedestrian(&self) -> bool {
        self.simulated().any(|(_, frame)| {
            let front = frame.ego.center();
            frame.ego.speed() < 1.5
                && frame.objects.iter().any(|object| {
                    let local = front.to_local(object.shape.center.position());
                    object.kind == ObjectKind::Pedestrian
                        && object.speed() > 0.3
                        && local.x > 0.0
                        && local.coords.norm() < 20.0
                })
        })
    }

    /// True if the ego drives and later stands on a lane within 6 m before a red light.
    pub(crate) fn stops_before_red(&self) -> bool {
        let mut moved = false;
        self.simulated().any(|(i, frame)| {
            moved |= frame.ego.speed() > 5.0;
            let lane = &self.map[self.lanes[i]];
            let front = frame
                .ego
                .footprint()
                .center
                .translated(frame.ego.footprint().length / 2.0, 0.0);
            let left = lane.centerline.length() - lane.centerline.project(front.position()).s;
            let red = |onward: &LaneId| frame.lights.status(*onward) == Some(SignalStatus::Red);
            moved
                && frame.ego.speed() < 0.1
                && !lane.is_connector()
                && left < 6.0
                && lane.outgoing.iter().any(red)
        })
    }

    /// True if the ego is within 14 m of a bay at the curb for 1.5 s in all.
    pub(crate) fn passes_bay(&self) -> bool {
        let near = |frame: &Frame| {
            let point = frame.ego.center().position();
            self.map
                .carparks()
                .iter()
                .any(|bay| bay.distance_to(point) < 14.0)
        };
        self.simulated().filter(|(_, frame)| near(frame)).count() >= 15
    }
}

fn vehicles_within(frame: &Frame, reach: f64) -> usize {
    let center = frame.ego.center();
    let near = |object: &&TrackedObject| {
        object.kind == ObjectKind::Vehicle && object.shape.center.distance(&center) < reach
    };
    frame.objects.iter().filter(near).count()
}

/// One step of the traffic, with the expert as the ego's driver.
fn advance(traffic: &mut Traffic<'_>, expert: &mut Expert) {
    let (command, stop_s) = (expert.lane_command(traffic), Expert::stop_s(traffic));
    traffic.movers[0].stop_s = stop_s;
    let track = traffic.movers[0].track.clone();
    traffic.step(command);
    if !Arc::ptr_eq(&track, &traffic.movers[0].track) {
        expert.note_change();
    }
}

/// The ego and the objects around it, unless the draw must be discarded.
fn observe(
    traffic: &Traffic<'_>,
    map: &LaneMap,
    iteration: i64,
) -> Result<(EgoState, Arc<[TrackedObject]>), Discard> {
    let ego = &traffic.movers[0];
    if ego.gone || ego.track.length() < ego.front_s() + 25.0 {
        return Err(Discard::RoadEnds);
    }
    let objects: Arc<[TrackedObject]> = traffic.objects(RECORDED_WITHIN).into();
    let shape = ego.shape();
    if objects.iter().any(|object| object.shape.overlaps(&shape)) {
        return Err(Discard::Collision);
    }
    // All pairs of objects are costly to compare, and 0.2 s are short against any overlap.
    if iteration % 2 == 0 && collide(&objects, shape.center.position()) {
        return Err(Discard::OthersCollide);
    }
    if !shape
        .corners()
        .iter()
        .all(|&corner| map.is_drivable(corner))
    {
        return Err(Discard::OffRoad);
    }
    let acceleration = Vector::new(ego.accel, ego.path_curvature(ego.s) * ego.speed * ego.speed);
    let time_us = START_US + iteration * STEP_US;
    Ok((
        EgoState::from_log(
            time_us,
            ego.pose(),
            Vector::new(ego.speed, 0.0),
            acceleration,
        ),
        objects,
    ))
}

/// True if two objects near the ego overlap. Pedestrians may stand close together.
fn collide(objects: &[TrackedObject], ego: Point) -> bool {
    let near: Vec<&TrackedObject> = objects
        .iter()
        .filter(|object| (object.shape.center.position() - ego).norm() < CHECKED_WITHIN)
        .collect();
    near.iter().enumerate().any(|(i, a)| {
        near[i + 1..].iter().any(|b| {
            let moves = a.speed() > 0.0 || b.speed() > 0.0;
            let people = a.kind == ObjectKind::Pedestrian && b.kind == ObjectKind::Pedestrian;
            moves && !people && a.shape.overlaps(&b.shape)
        })
    })
}
