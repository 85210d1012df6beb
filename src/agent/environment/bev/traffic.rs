//! Objects on the BEV map: obstacles, agents, the ego, speed arrows.

use super::canvas::Canvas;
use super::{ARROW, BevElement, Palette};
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{SceneView, TrackedObject};

/// An arrow is as long as the distance of its agent in this time, seconds.
pub(crate) const ARROW_SECONDS: f64 = 0.8;
/// Slower agents stand still and get no arrow, m/s.
pub(crate) const MOVING_SPEED: f64 = 0.5;
/// Minimum length and width of a drawn object, pixels: a pedestrian or a cone stays visible beside
/// its arrow.
pub(crate) const MIN_SIZE_PX: f64 = 4.0;
/// Minimum length and width of a drawn object as a share of the image's side: large images go to
/// towers with large patches.
pub(crate) const MIN_SIZE_SHARE: f64 = 1.0 / 56.0;
/// Width of an arrow's shaft, meters.
const SHAFT_M: f64 = 0.35;
/// Minimum width of an arrow's shaft, pixels.
const MIN_SHAFT_PX: f64 = 1.2;
/// Width of an arrow's head in widths of its shaft.
const HEAD_SHAFTS: f64 = 3.0;
/// The head takes at most this share of the arrow.
const HEAD_SHARE: f64 = 0.6;

/// Drawing order, later over earlier.
const ORDER: [BevElement; 4] = [
    BevElement::StaticObstacles,
    BevElement::Vehicles,
    BevElement::Bicycles,
    BevElement::Pedestrians,
];

pub(super) fn draw(canvas: &mut Canvas, scene: &SceneView<'_>) {
    let mut objects: Vec<&TrackedObject> = scene
        .objects
        .iter()
        .filter(|object| may_show(canvas, object))
        .collect();
    // Overlapping objects are drawn in a fixed order, so that a scene always has the same picture.
    objects.sort_by_key(|object| object.token);
    for element in ORDER {
        let drawn: Vec<&TrackedObject> = objects
            .iter()
            .copied()
            .filter(|object| BevElement::from_object_kind(object.kind) == element)
            .collect();
        if element == BevElement::Pedestrians {
            draw_discs(canvas, &drawn);
        } else {
            let boxes: Vec<OrientedBox> = drawn.iter().map(|object| object.shape).collect();
            draw_boxes(canvas, &boxes, element);
        }
    }
    draw_boxes(canvas, &[scene.ego.footprint()], BevElement::Ego);
    let agents = objects.iter().filter(|object| object.kind.is_agent());
    let moving = agents.map(|object| (object.shape.center.position(), object.velocity));
    let ego = (
        scene.ego.center().position(),
        scene.ego.rear_axle.rotate(scene.ego.center_velocity()),
    );
    for (from, velocity) in moving
        .chain(std::iter::once(ego))
        .filter(|(_, v)| v.norm() >= MOVING_SPEED)
    {
        draw_arrow(canvas, from, velocity);
    }
}

/// Whether the object or its arrow may reach into the image.
fn may_show(canvas: &Canvas, object: &TrackedObject) -> bool {
    let distance = (object.shape.center.position() - canvas.center().position()).norm();
    distance <= canvas.reach() + object.shape.diagonal() + ARROW_SECONDS * object.speed()
}

/// Minimum length and width of an object, meters.
fn least_size(canvas: &Canvas) -> f64 {
    let view = canvas.view();
    MIN_SIZE_PX.max(MIN_SIZE_SHARE * f64::from(view.pixels())) / view.scale()
}

fn draw_discs(canvas: &mut Canvas, pedestrians: &[&TrackedObject]) {
    for pedestrian in pedestrians {
        let shape = pedestrian.shape;
        let diameter = shape.length.max(shape.width).max(least_size(canvas));
        canvas.disc(
            shape.center.position(),
            diameter,
            Palette::color(BevElement::Pedestrians),
        );
    }
}

fn draw_boxes(canvas: &mut Canvas, boxes: &[OrientedBox], element: BevElement) {
    let least = least_size(canvas);
    let visible = boxes
        .iter()
        .map(|b| OrientedBox::new(b.center, b.length.max(least), b.width.max(least)).corners());
    canvas.outlines(visible, Palette::color(element));
}

fn draw_arrow(canvas: &mut Canvas, from: Point, velocity: Vector) {
    // A longer arrow shows no more, and the rasterizer needs pixels of a sane size.
    let length = (ARROW_SECONDS * velocity.norm()).min(2.0 * canvas.view().meters());
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
    canvas.outlines([outline.map(|(x, y)| tail.to_map(Point::new(x, y)))], ARROW);
}
