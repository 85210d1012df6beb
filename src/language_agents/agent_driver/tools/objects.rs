//! Objects as the tools see them.

use super::REACH;
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{ObjectKind, SceneView};

/// Half seconds of a forecast.
pub(crate) const STEPS: usize = 6;
/// Length of one of them, seconds.
pub(crate) const STEP_S: f64 = 0.5;

/// An object, seen from the ego's center: x to the right, y ahead.
#[derive(Debug, Clone)]
pub(crate) struct SeenObject {
    /// Its number in a call: the nearest has 0.
    pub(crate) id: usize,
    pub(crate) kind: ObjectKind,
    /// Its places now and after every half second at its velocity, meters.
    pub(crate) places: [(f64, f64); STEPS + 1],
    /// Width and length, meters.
    pub(crate) size: (f64, f64),
    /// Its boxes at these times in the frame of the ego's center, whose x is ahead and y to the left.
    boxes: [OrientedBox; STEPS + 1],
}

impl SeenObject {
    /// Whether it is right ahead.
    pub(crate) fn leads(&self) -> bool {
        self.within([-3.0, 3.0, 0.0, 10.0])
    }

    /// Whether it is now within bounds: from and to to the right, from and to ahead.
    pub(crate) fn within(&self, [x_start, x_end, y_start, y_end]: [f64; 4]) -> bool {
        let (x, y) = self.places[0];
        (x_start..=x_end).contains(&x) && (y_start..=y_end).contains(&y)
    }

    /// Its box after a number of half seconds.
    pub(crate) fn box_at(&self, step: usize) -> &OrientedBox {
        &self.boxes[step.min(STEPS)]
    }

    /// Whether it covers a place after a number of half seconds.
    pub(crate) fn covers(&self, (x, y): (f64, f64), step: usize) -> bool {
        self.box_at(step).contains(Point::new(y, -x))
    }
}

/// The objects within reach, the nearest first.
pub(crate) fn seen(scene: &SceneView<'_>) -> Vec<SeenObject> {
    let ego = scene.ego.center();
    let mut objects: Vec<SeenObject> = scene
        .objects
        .iter()
        .map(|object| {
            let boxes: [OrientedBox; STEPS + 1] = std::array::from_fn(|step| {
                let moved: Vector = object.velocity * (step as f64 * STEP_S);
                let center = object.shape.center;
                let place = ego.to_local(center.position() + moved);
                let local = Pose::at(place, center.heading - ego.heading);
                object.shape.moved_to(local)
            });
            let places = boxes.map(|shape: OrientedBox| (-shape.center.y, shape.center.x));
            SeenObject {
                id: 0,
                kind: object.kind,
                places,
                size: (object.shape.width, object.shape.length),
                boxes,
            }
        })
        .filter(|object| object.within([-REACH, REACH, -REACH, REACH]))
        .collect();
    let distance = |object: &SeenObject| {
        let (x, y) = object.places[0];
        x.hypot(y)
    };
    objects.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    // Numbered after sorting: the grammar allows ids from 0 up to a limit, so these name the
    // nearest objects.
    for (id, object) in objects.iter_mut().enumerate() {
        object.id = id;
    }
    objects
}
