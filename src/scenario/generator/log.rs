//! One drive: the traffic is run with the expert at the wheel, recorded, and judged.

use super::expert::Expert;
use super::recipe::SETTLING;
use super::traffic::Traffic;
use crate::geometry::{Vector, wrap_angle};
use crate::scenario::Frame;
use crate::world::{
    EgoState, HISTORY_SAMPLES, LaneId, LaneMap, ObjectKind, STEP_S, STEP_US, SignalStatus, TrackedObject,
};
use std::sync::Arc;

/// Iterations of a drive: 15 s at 10 Hz, both ends included.
pub(super) const ITERATIONS: usize = 151;
/// Frames before iteration 0.
pub(super) const PAST: usize = HISTORY_SAMPLES - 1;
/// Objects further from the ego than this are not recorded, metres.
const SEEN: f64 = 100.0;
/// Vehicles nearer to the ego than this must not run into each other, metres.
const WATCHED: f64 = 100.0;
/// Time stamp of iteration 0, µs.
const START_US: i64 = 10_000_000;

/// Why a drive is thrown away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Discard {
    /// The expert touches something.
    #[error("the expert collides")]
    Collision,
    /// Other road users touch each other near the ego.
    #[error("others collide")]
    OthersCollide,
    /// A corner of the ego leaves the drivable area.
    #[error("the expert leaves the road")]
    OffRoad,
    /// The ego reaches the end of the roads.
    #[error("the road ends")]
    RoadEnds,
    /// It is not what its type says.
    #[error("the drive is not of its type")]
    OtherType,
    /// Among other traffic, the situation of the seed did not come about.
    #[error("the situation is not that of its seed")]
    OtherSituation,
    /// The roads cannot be laid so.
    #[error("the roads do not fit")]
    Roads,
}

/// A recorded drive with what its judges need.
pub(super) struct GeneratedLog {
    /// The log.
    pub(super) frames: Vec<Frame>,
    /// Where it took place.
    pub(super) map: Arc<LaneMap>,
    /// The lane under the ego's box centre, by frame.
    pub(super) lanes: Vec<LaneId>,
    /// Curvature of the ego's path, 1/m, by frame.
    pub(super) curvatures: Vec<f64>,
    /// Whether the ego was between two lanes, by frame.
    pub(super) changing: Vec<bool>,
}

impl GeneratedLog {
    /// Runs the traffic and records it.
    ///
    /// # Errors
    /// When the expert collides or leaves the road, others collide, or the road ends.
    pub(super) fn record(mut traffic: Traffic<'_>, mut expert: Expert) -> Result<Self, Discard> {
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
                log.take(&traffic, (step - settling) as i64 - PAST as i64, lights.clone())?;
            }
            let (wish, halt) = (expert.wish(&traffic), Expert::halt(&traffic));
            traffic.movers[0].halt = halt;
            let track = traffic.movers[0].track.clone();
            traffic.step(wish);
            if !Arc::ptr_eq(&track, &traffic.movers[0].track) {
                expert.note_change();
            }
        }
        Ok(log)
    }

    /// Records one instant.
    fn take(
        &mut self,
        traffic: &Traffic<'_>,
        iteration: i64,
        lights: Arc<crate::world::TrafficLights>,
    ) -> Result<(), Discard> {
        let ego = &traffic.movers[0];
        if ego.gone || ego.track.length() < ego.front_s() + 25.0 {
            return Err(Discard::RoadEnds);
        }
        let objects: Arc<[TrackedObject]> = traffic.objects(SEEN).into();
        let shape = ego.shape();
        if objects.iter().any(|object| object.shape.overlaps(&shape)) {
            return Err(Discard::Collision);
        }
        if iteration % 2 == 0 && collide(&objects, shape.center.position()) {
            return Err(Discard::OthersCollide);
        }
        if !shape.corners().iter().all(|&corner| self.map.is_drivable(corner)) {
            return Err(Discard::OffRoad);
        }
        let curvature = ego.path_curvature(ego.s);
        let acceleration = Vector::new(ego.accel, curvature * ego.speed * ego.speed);
        let time_us = START_US + iteration * STEP_US;
        self.frames.push(Frame {
            ego: EgoState::from_log(time_us, ego.pose(), Vector::new(ego.speed, 0.0), acceleration),
            objects,
            lights,
        });
        self.lanes.push(ego.track.span_at(ego.s + crate::world::PACIFICA.rear_axle_to_center()).lane);
        self.curvatures.push(curvature);
        self.changing.push(ego.is_between_lanes());
        Ok(())
    }

    /// Iterations and the frame of each.
    fn driven(&self) -> impl Iterator<Item = (usize, &Frame)> {
        self.frames.iter().enumerate().skip(PAST)
    }

    /// Heading change between two frames of the log reaches `angle` (negative: to the right) within 8 s.
    pub(super) fn turns(&self, angle: f64) -> bool {
        let headings: Vec<f64> = self.driven().map(|(_, frame)| frame.ego.rear_axle.heading).collect();
        (0..headings.len()).any(|i| {
            let end = (i + 80).min(headings.len() - 1);
            wrap_angle(headings[end] - headings[i]) * angle.signum() > angle.abs()
        })
    }

    /// The ego crosses a signalled connector.
    pub(super) fn crosses_a_light(&self) -> bool {
        self.driven().any(|(i, frame)| self.map[self.lanes[i]].has_traffic_lights && frame.ego.speed() > 1.0)
    }

    /// The ego is inside a crossing or roundabout: on a connector among others that cross or join its own.
    pub(super) fn in_intersection(&self) -> bool {
        self.driven().any(|(i, frame)| {
            let point = frame.ego.center().position();
            self.map[self.lanes[i]].is_connector() && self.map.lanes_at(point).len() > 1
        })
    }

    /// Gap to and speed of the vehicle ahead of the ego in its lane at a frame.
    fn lead(frame: &Frame) -> Option<(f64, &TrackedObject)> {
        let (front, own) = (frame.ego.center(), frame.ego.footprint());
        let leads =
            frame.objects.iter().filter(|object| object.kind == ObjectKind::Vehicle).filter_map(move |object| {
                let local = front.to_local(object.shape.center.position());
                let turned = wrap_angle(object.shape.center.heading - front.heading).abs();
                let ahead = local.x > 0.0 && local.y.abs() < 1.2 + 0.03 * local.x && turned < 0.6;
                ahead.then(|| (own.distance(&object.shape), object))
            });
        leads.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Comes to a stop, or nearly so, behind a vehicle.
    pub(super) fn stops_behind_lead(&self) -> bool {
        let (mut moved, mut stopped) = (false, false);
        for (_, frame) in self.driven() {
            moved |= frame.ego.speed() > 3.0;
            stopped |= moved && frame.ego.speed() < 0.4 && Self::lead(frame).is_some_and(|(gap, _)| gap < 7.0);
        }
        stopped
    }

    /// Follows a vehicle no further than `gap` metres ahead at more than `speed` m/s for two seconds in all.
    pub(super) fn follows(&self, gap: f64, speed: f64) -> bool {
        let follows = |frame: &Frame| {
            frame.ego.speed() > speed && Self::lead(frame).is_some_and(|(d, o)| d < gap && o.speed() > speed / 2.0)
        };
        self.driven().filter(|(_, frame)| follows(frame)).count() >= 20
    }

    /// Drives or stands within 25 m behind a vehicle longer than 8 m.
    pub(super) fn behind_long(&self) -> bool {
        let long = |frame: &Frame| Self::lead(frame).is_some_and(|(gap, o)| gap < 25.0 && o.shape.length > 8.0);
        self.driven().filter(|(_, frame)| long(frame)).count() >= 20
    }

    /// Stands with at least four vehicles within 25 m.
    pub(super) fn stands_in_traffic(&self) -> bool {
        self.driven().take(60).any(|(_, frame)| frame.ego.speed() < 0.1 && vehicles_within(frame, 25.0) >= 4)
    }

    /// Moves faster than 3 m/s with at least `count` moving vehicles within 25 m.
    pub(super) fn near_vehicles(&self, count: usize) -> bool {
        self.driven().any(|(_, frame)| frame.ego.speed() > 3.0 && vehicles_within(frame, 25.0) >= count)
    }

    /// Moves, but slower than `speed`, for two seconds in all.
    pub(super) fn slow(&self, speed: f64) -> bool {
        self.driven().filter(|(_, frame)| (0.2..speed).contains(&frame.ego.speed())).count() >= 20
    }

    /// Is faster than `speed`.
    pub(super) fn fast(&self, speed: f64) -> bool {
        self.driven().any(|(_, frame)| frame.ego.speed() > speed)
    }

    /// Has a lateral acceleration above `bound`.
    pub(super) fn lateral(&self, bound: f64) -> bool {
        self.driven().any(|(i, frame)| self.curvatures[i].abs() * frame.ego.speed().powi(2) > bound)
    }

    /// Changes lanes.
    pub(super) fn changes_lane(&self) -> bool {
        self.driven().filter(|&(i, _)| self.changing[i]).count() >= 15
    }

    /// Slows down or stands while a pedestrian crosses within 20 m ahead.
    pub(super) fn waits_for_pedestrian(&self) -> bool {
        self.driven().any(|(_, frame)| {
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

    /// Drives, and later stands, with a red light within 6 m ahead and nothing of itself on its connector.
    pub(super) fn stops_before_red(&self) -> bool {
        let mut moved = false;
        self.driven().any(|(i, frame)| {
            moved |= frame.ego.speed() > 5.0;
            let lane = &self.map[self.lanes[i]];
            let front = frame.ego.footprint().center.translated(frame.ego.footprint().length / 2.0, 0.0);
            let left = lane.centerline.length() - lane.centerline.project(front.position()).s;
            let red = |onward: &LaneId| frame.lights.status(*onward) == Some(SignalStatus::Red);
            moved && frame.ego.speed() < 0.1 && !lane.is_connector() && left < 6.0 && lane.outgoing.iter().any(red)
        })
    }

    /// Passes a kerb-side bay.
    pub(super) fn passes_bay(&self) -> bool {
        let near = |frame: &Frame| {
            let point = frame.ego.center().position();
            self.map.carparks().iter().any(|bay| bay.distance_to(point) < 14.0)
        };
        self.driven().filter(|(_, frame)| near(frame)).count() >= 15
    }
}

fn vehicles_within(frame: &Frame, reach: f64) -> usize {
    let center = frame.ego.center();
    let near =
        |object: &&TrackedObject| object.kind == ObjectKind::Vehicle && object.shape.center.distance(&center) < reach;
    frame.objects.iter().filter(near).count()
}

/// Whether two of the objects near a place overlap; people may stand close together.
fn collide(objects: &[TrackedObject], ego: crate::geometry::Point) -> bool {
    let solid: Vec<&TrackedObject> =
        objects.iter().filter(|object| (object.shape.center.position() - ego).norm() < WATCHED).collect();
    solid.iter().enumerate().any(|(i, a)| {
        solid[i + 1..].iter().any(|b| {
            let moves = a.speed() > 0.0 || b.speed() > 0.0;
            let people = a.kind == ObjectKind::Pedestrian && b.kind == ObjectKind::Pedestrian;
            moves && !people && a.shape.overlaps(&b.shape)
        })
    })
}
