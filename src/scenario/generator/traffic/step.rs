//! One step of the traffic: all drivers decide on the same instant.

use super::lane_change::LaneCommand;
use super::right_of_way::Claims;
use super::state::{Body, Traffic};
use super::walker::Walker;
use planagent_world::STEP_S;

impl Traffic<'_> {
    /// Advances everything by one step of 0.1 s.
    pub(crate) fn step(&mut self, command: LaneCommand) {
        let lights = self.lights();
        let bodies = self.bodies();
        self.play_scripts(&bodies);
        self.follow_command(command, &bodies);
        let claims = Claims::new(self);
        // Everything is decided before anything moves, so that the order of movers has no
        // influence.
        let wanted: Vec<f64> = (0..self.movers.len())
            .map(|i| {
                if self.movers[i].gone {
                    0.0
                } else {
                    self.wanted_acceleration(i, &bodies, &claims, &lights)
                }
            })
            .collect();
        let clear: Vec<bool> = self
            .walkers
            .iter()
            .map(|walker| leaves_room(walker, &bodies))
            .collect();
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
}

/// True if a pedestrian may step onto the road: every vehicle near is far in time, stands or has
/// passed.
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
