//! The box of an ego state, computed once for all terms of the score.

use planagent_world::geometry::{Bounds, OrientedBox, Point, Pose, Vector};
use planagent_world::{EgoState, PACIFICA};

/// The box of an ego state with its corners and direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    /// The box, map frame.
    pub(super) shape: OrientedBox,
    /// Its corners in nuPlan's order.
    pub(super) corners: [Point; 4],
    /// Unit vector along the heading.
    pub(super) direction: Vector,
    /// Norm of the rear-axle velocity, m/s.
    pub(super) speed: f64,
}

impl Placed {
    pub(super) fn from_state(ego: &EgoState) -> Self {
        let rear = ego.rear_axle;
        let (sin, cos) = rear.heading.sin_cos();
        let at =
            |from: Point, x: f64, y: f64| from + Vector::new(cos * x - sin * y, sin * x + cos * y);
        let center = at(rear.position(), PACIFICA.rear_axle_to_center(), 0.0);
        let shape = OrientedBox::new(
            Pose::at(center, rear.heading),
            PACIFICA.length(),
            PACIFICA.width,
        );
        let (l, w) = (shape.length / 2.0, shape.width / 2.0);
        let corners = [(l, w), (-l, w), (-l, -w), (l, -w)].map(|(x, y)| at(center, x, y));
        Self {
            shape,
            corners,
            direction: Vector::new(cos, sin),
            speed: ego.speed(),
        }
    }

    pub(super) fn bounds(&self) -> Bounds {
        Bounds::around(&self.corners)
    }

    /// The box after some seconds straight ahead at its speed.
    pub(super) fn moved(&self, seconds: f64) -> OrientedBox {
        let moved = self.shape.center.position() + self.direction * (self.speed * seconds);
        self.shape
            .moved_to(Pose::at(moved, self.shape.center.heading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_that_of_the_state() {
        let ego = EgoState::from_log(
            0,
            Pose::new(3.0, -4.0, 2.1),
            Vector::new(5.0, 0.1),
            Vector::zeros(),
        );
        let placed = Placed::from_state(&ego);
        assert_eq!(placed.shape, ego.footprint());
        assert_eq!(placed.corners, ego.footprint().corners());
        let moved = placed.moved(0.3).center;
        assert!((moved.distance(&ego.center()) - 0.3 * ego.speed()).abs() < 1e-12);
    }
}
