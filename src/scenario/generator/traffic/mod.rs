//! Reactive traffic of the generator: in each step, all drivers decide on the same instant.

mod driver;
mod lane_change;
mod mover;
mod right_of_way;
mod track;
mod walker;

pub(crate) use lane_change::LaneCommand;
pub(crate) use mover::{Act, DriverProfile, Mover, Shift, Steering};
pub(crate) use track::Track;
pub(crate) use walker::{Departure, Walker};

use super::road::Roads;
use crate::geometry::{OrientedBox, Vector};
use crate::world::{ObjectKind, STEP_S, TrackedObject, TrafficLights};
use right_of_way::Claims;

/// A vehicle or object to keep clear of, as it is now.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    pub(crate) shape: OrientedBox,
    /// Unit vector along its heading.
    pub(crate) direction: Vector,
    /// m/s.
    pub(crate) speed: f64,
    /// Index of the mover; `None` for a static object.
    pub(crate) mover: Option<usize>,
}

/// All agents and objects on the roads.
#[derive(Debug, Clone)]
pub(crate) struct Traffic<'a> {
    pub(crate) roads: &'a Roads,
    /// Vehicles and cyclists; the first is the ego.
    pub(crate) movers: Vec<Mover>,
    pub(crate) walkers: Vec<Walker>,
    /// Static objects: parked vehicles, cones, barriers.
    pub(crate) fixtures: Vec<TrackedObject>,
    /// Seconds from iteration 0.
    pub(crate) time: f64,
}

impl Traffic<'_> {
    pub(crate) fn lights(&self) -> TrafficLights {
        self.roads.lights(self.time)
    }

    /// Movers in order, then static objects, as they are now.
    pub(crate) fn bodies(&self) -> Vec<Body> {
        let body = |shape: OrientedBox, speed, mover| Body { shape, direction: shape.center.direction(), speed, mover };
        let movers = self.movers.iter().enumerate().filter(|(_, mover)| !mover.gone);
        let movers = movers.map(|(i, mover)| body(mover.shape(), mover.speed, Some(i)));
        let fixtures = self.fixtures.iter().map(|object| body(object.shape, 0.0, None));
        movers.chain(fixtures).collect()
    }

    /// Advances everything by one step of 0.1 s.
    pub(crate) fn step(&mut self, command: LaneCommand) {
        let lights = self.lights();
        let bodies = self.bodies();
        self.play_scripts(&bodies);
        self.follow_command(command, &bodies);
        let claims = Claims::new(self);
        let wanted: Vec<f64> = (0..self.movers.len())
            .map(|i| if self.movers[i].gone { 0.0 } else { self.wanted_acceleration(i, &bodies, &claims, &lights) })
            .collect();
        let clear: Vec<bool> = self.walkers.iter().map(|walker| leaves_room(walker, &bodies)).collect();
        for (mover, &acceleration) in self.movers.iter_mut().zip(&wanted) {
            if !mover.gone {
                mover.advance(acceleration);
            }
        }
        self.note_stops();
        for (walker, &clear) in self.walkers.iter_mut().zip(&clear) {
            walker.advance(self.time, clear);
        }
        self.time += STEP_S;
    }

    /// Agents and objects within `reach` meters of the ego, in order of their tokens.
    pub(crate) fn objects(&self, reach: f64) -> Vec<TrackedObject> {
        let ego = self.movers[0].shape().center.position();
        let near = |object: &TrackedObject| (object.shape.center.position() - ego).norm() <= reach;
        let movers = self.movers[1..].iter().filter(|mover| !mover.gone).map(|mover| TrackedObject {
            token: mover.token,
            kind: mover.kind,
            shape: mover.shape(),
            velocity: mover.velocity(),
        });
        let walkers = self.walkers.iter().map(|walker| TrackedObject {
            token: walker.token,
            kind: ObjectKind::Pedestrian,
            shape: walker.shape(),
            velocity: walker.velocity(),
        });
        let mut seen: Vec<TrackedObject> =
            movers.chain(walkers).chain(self.fixtures.iter().copied()).filter(near).collect();
        seen.sort_by_key(|object| object.token);
        seen
    }
}

/// True if a pedestrian may step onto the road: every vehicle near is far in time, stands or has passed.
fn leaves_room(walker: &Walker, bodies: &[Body]) -> bool {
    /// Minimum time to the arrival of a vehicle, seconds.
    const TIME_GAP: f64 = 4.5;
    let middle = nalgebra::center(&walker.from, &walker.to);
    bodies.iter().all(|body| {
        let to = middle - body.shape.center.position();
        let closing = to.normalize().dot(&body.direction) * body.speed;
        let distance = to.norm() - body.shape.length / 2.0 - walker.distance() / 2.0;
        closing < 0.7 || distance > closing * TIME_GAP
    })
}
