//! What stands and moves on the BEV map: obstacles, agents, the ego, speed arrows.

use super::canvas::Canvas;
use super::{ARROW, BevElement, Palette};
use crate::geometry::{OrientedBox, Point, Pose, Vector};
use crate::world::{Scene, TrackedObject};

/// An arrow is as long as its agent goes in this time, seconds.
pub const ARROW_SECONDS: f64 = 0.8;
/// Slower agents stand still and get no arrow, m/s.
pub const MOVING_SPEED: f64 = 0.5;
/// Least length and width of a drawn object, pixels: a pedestrian or a cone stays visible beside its arrow.
pub const MIN_SIZE_PX: f64 = 4.0;
/// Least length and width of a drawn object as a share of the image's side: large images go to towers with large patches.
pub const MIN_SIZE_SHARE: f64 = 1.0 / 56.0;
/// Width of an arrow's shaft, metres.
const SHAFT_M: f64 = 0.35;
/// Least width of an arrow's shaft, pixels.
const MIN_SHAFT_PX: f64 = 1.2;
/// Width of an arrow's head in widths of its shaft.
const HEAD_SHAFTS: f64 = 3.0;
/// The head takes at most this share of the arrow.
const HEAD_SHARE: f64 = 0.6;

/// Order of drawing, later over earlier.
const ORDER: [BevElement; 4] =
    [BevElement::StaticObstacles, BevElement::Vehicles, BevElement::Bicycles, BevElement::Pedestrians];

/// Draws objects, ego and arrows.
pub(super) fn draw(canvas: &mut Canvas, scene: &Scene<'_>) {
    let mut objects: Vec<&TrackedObject> = scene.objects.iter().filter(|object| may_show(canvas, object)).collect();
    objects.sort_by_key(|object| object.token);
    for element in ORDER {
        for object in objects.iter().filter(|object| BevElement::of(object.kind) == element) {
            draw_object(canvas, object, element);
        }
    }
    let ego = scene.ego;
    draw_box(canvas, &ego.footprint(), BevElement::Ego);
    for object in objects.iter().filter(|object| object.kind.is_agent()) {
        draw_arrow(canvas, object.shape.center.position(), object.velocity);
    }
    draw_arrow(canvas, ego.center().position(), ego.rear_axle.rotate(ego.center_velocity()));
}

/// Whether the object or its arrow may reach into the image.
fn may_show(canvas: &Canvas, object: &TrackedObject) -> bool {
    let distance = (object.shape.center.position() - canvas.center().position()).norm();
    distance <= canvas.reach() + object.shape.diagonal() + ARROW_SECONDS * object.speed()
}

/// Least length and width of an object, metres.
fn least_size(canvas: &Canvas) -> f64 {
    let view = canvas.view();
    MIN_SIZE_PX.max(MIN_SIZE_SHARE * f64::from(view.pixels())) / view.scale()
}

fn draw_object(canvas: &mut Canvas, object: &TrackedObject, element: BevElement) {
    if element == BevElement::Pedestrians {
        let diameter = object.shape.length.max(object.shape.width).max(least_size(canvas));
        canvas.disc(object.shape.center.position(), diameter, Palette::color(element));
    } else {
        draw_box(canvas, &object.shape, element);
    }
}

fn draw_box(canvas: &mut Canvas, shape: &OrientedBox, element: BevElement) {
    let least = least_size(canvas);
    let visible = OrientedBox::new(shape.center, shape.length.max(least), shape.width.max(least));
    canvas.area(&visible.corners(), Palette::color(element));
}

fn draw_arrow(canvas: &mut Canvas, from: Point, velocity: Vector) {
    if velocity.norm() < MOVING_SPEED {
        return;
    }
    let length = ARROW_SECONDS * velocity.norm();
    let tail = Pose::at(from, velocity.y.atan2(velocity.x));
    let shaft = SHAFT_M.max(MIN_SHAFT_PX / canvas.view().scale());
    let head = shaft * HEAD_SHAFTS;
    let neck = length - head.min(HEAD_SHARE * length);
    let outline = [
        (0.0, shaft / 2.0),
        (neck, shaft / 2.0),
        (neck, head / 2.0),
        (length, 0.0),
        (neck, -head / 2.0),
        (neck, -shaft / 2.0),
        (0.0, -shaft / 2.0),
    ];
    canvas.area(&outline.map(|(x, y)| tail.to_map(Point::new(x, y))), ARROW);
}
