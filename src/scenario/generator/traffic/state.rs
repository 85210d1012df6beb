//! The state of the traffic.

use super::mover::Mover;
use super::walker::Walker;
use crate::generator::road::Roads;
use planagent_world::geometry::{OrientedBox, Vector};
use planagent_world::{ObjectKind, TrackedObject, TrafficLights};

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
        let body = |shape: OrientedBox, speed, mover| Body {
            shape,
            direction: shape.center.direction(),
            speed,
            mover,
        };
        let movers = self
            .movers
            .iter()
            .enumerate()
            .filter(|(_, mover)| !mover.gone);
        let movers = movers.map(|(i, mover)| body(mover.shape(), mover.speed, Some(i)));
        let fixtures = self
            .fixtures
            .iter()
            .map(|object| body(object.shape, 0.0, None));
        movers.chain(fixtures).collect()
    }

    /// Agents and objects within `reach` meters of the ego, in order of their tokens.
    pub(crate) fn objects(&self, reach: f64) -> Vec<TrackedObject> {
        let ego = self.movers[0].shape().center.position();
        let near = |object: &TrackedObject| (object.shape.center.position() - ego).norm() <= reach;
        let movers = self.movers[1..]
            .iter()
            .filter(|mover| !mover.gone)
            .map(|mover| TrackedObject {
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
        let mut seen: Vec<TrackedObject> = movers
            .chain(walkers)
            .chain(self.fixtures.iter().copied())
            .filter(near)
            .collect();
        seen.sort_by_key(|object| object.token);
        seen
    }
}
