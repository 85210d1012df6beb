//! The scene from above, as the page draws it: map, lights, paths, agents, the ego, and a scale.

use super::canvas::{Canvas, Pen, Pixel};
use super::colors::{COLORS, Rgb};
use super::lettering::Lettering;
use super::score_labels;
use crate::report::replay::DrawnMap;
use planagent_world::geometry::{OrientedBox, Point, Pose};
use planagent_world::{EgoState, ObjectKind, SignalStatus, TrackedObject};

/// Place of the ego: share of the height below the upper edge.
const EGO_AT: f64 = 0.6;
/// Widths and lengths on the map, meters (as in the page's `bev.js`).
const CENTERLINE_M: f64 = 0.15;
const STRIPE_M: f64 = 1.2;
const LIGHT_M: f64 = 1.5;
const RED_M: f64 = 0.9;
const LIGHT_WIDTH_M: f64 = 0.45;
/// Agents above this speed (m/s) have an arrow, as long as their path in this time (s).
const MOVING: f64 = 0.5;
const ARROW_S: f64 = 0.8;
/// Smallest diameter of a pedestrian, meters.
const PEDESTRIAN_M: f64 = 0.8;
/// A side of this many pixels has the line widths and letters of the page.
const PAGE_PIXELS: f32 = 560.0;

/// What is drawn.
#[derive(Debug)]
pub(in crate::report) struct DrawnScene<'a> {
    pub(in crate::report) map: &'a DrawnMap,
    pub(in crate::report) ego: &'a EgoState,
    pub(in crate::report) objects: &'a [TrackedObject],
    /// The first segment of each connector with a light.
    pub(in crate::report) lights: Vec<([Point; 2], SignalStatus)>,
    /// Where the ego was, to the present.
    pub(in crate::report) trail: Vec<Point>,
    /// The active plan, a point every half second.
    pub(in crate::report) plan: &'a [Point],
    /// Refused plans with their scores; one of them may be executed all the same.
    pub(in crate::report) refused: Vec<(Vec<Point>, Option<f64>)>,
}

/// A square view of the ego, its heading up.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    center: Pose,
    /// Pixels a side.
    side: u32,
    /// Pixels per meter.
    scale: f64,
}

impl View {
    /// The view of a side in pixels and in meters.
    pub(super) fn new(ego: &EgoState, side: u32, meters: f64) -> Self {
        Self {
            center: ego.center(),
            side,
            scale: f64::from(side) / meters,
        }
    }

    pub(super) fn pixel(&self, point: Point) -> Pixel {
        let local = self.center.to_local(point);
        let side = f64::from(self.side);
        (
            (side / 2.0 - local.y * self.scale) as f32,
            (side * EGO_AT - local.x * self.scale) as f32,
        )
    }

    fn pixels(&self, points: &[Point]) -> Vec<Pixel> {
        points.iter().map(|&point| self.pixel(point)).collect()
    }

    /// The lines with a point in or near the view.
    fn all(&self, lines: &[Vec<Point>]) -> Vec<Vec<Pixel>> {
        let far = self.side as f32;
        let is_near = |line: &Vec<Pixel>| {
            let side = |axis: fn(&Pixel) -> f32| {
                let (low, high) = line
                    .iter()
                    .map(axis)
                    .fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(v), h.max(v)));
                low < far && high > 0.0
            };
            side(|pixel| pixel.0) && side(|pixel| pixel.1)
        };
        lines
            .iter()
            .map(|line| self.pixels(line))
            .filter(is_near)
            .collect()
    }

    fn meters(&self, meters: f64) -> f32 {
        (meters * self.scale) as f32
    }

    /// Angle of a heading in the picture, clockwise from the right.
    fn angle(&self, heading: f64) -> f32 {
        -(heading - self.center.heading + std::f64::consts::FRAC_PI_2) as f32
    }

    /// Pixels a side.
    pub(super) fn side(&self) -> f32 {
        self.side as f32
    }

    /// Widths of the page in this picture.
    pub(super) fn zoom(&self) -> f32 {
        self.side as f32 / PAGE_PIXELS
    }
}

/// Draws a scene into the upper left of a canvas.
pub(super) fn draw(canvas: &mut Canvas, scene: &DrawnScene<'_>, view: &View) {
    ground(canvas, scene.map, view);
    lights(canvas, &scene.lights, view);
    paths(canvas, scene, view);
    for object in scene.objects {
        agent(canvas, object, view);
    }
    vehicle(canvas, &scene.ego.footprint(), COLORS.ego, true, view);
    arrow(canvas, scene.ego.center(), scene.ego.velocity.x.abs(), view);
    score_labels::draw(canvas, scene, view);
    scale(canvas, view);
}

fn ground(canvas: &mut Canvas, map: &DrawnMap, view: &View) {
    let colors = &*COLORS;
    for area in &map.drivable {
        canvas.rings(&view.all(area), colors.drivable);
    }
    canvas.areas(&view.all(&map.lanes), colors.road);
    canvas.areas(&view.all(&map.route), colors.route);
    let pen = Pen::solid(colors.centerline, view.meters(CENTERLINE_M).max(0.6));
    canvas.lines(view.all(&map.centerlines).iter().map(Vec::as_slice), pen);
    let faint = Pen {
        opacity: 0.45,
        ..pen
    };
    canvas.lines(view.all(&map.connectors).iter().map(Vec::as_slice), faint);
    let (origin, angle) = (view.pixel(Point::origin()), view.angle(0.0));
    for crosswalk in view.all(&map.crosswalks) {
        canvas.stripes(
            &crosswalk,
            colors.crosswalk,
            view.meters(STRIPE_M),
            angle,
            origin,
        );
    }
    canvas.areas(&view.all(&map.stop_lines), colors.stop);
}

/// A bar across the start of each connector with a light; red bars are wider, for color-blind
/// readers.
fn lights(canvas: &mut Canvas, lights: &[([Point; 2], SignalStatus)], view: &View) {
    for ([start, next], status) in lights {
        let (color, width) = match status {
            SignalStatus::Red => (COLORS.red, RED_M),
            SignalStatus::Yellow => (COLORS.amber, LIGHT_WIDTH_M),
            SignalStatus::Green => (COLORS.green, LIGHT_WIDTH_M),
            SignalStatus::Unknown => continue,
        };
        let along = next - start;
        let heading = along.y.atan2(along.x);
        let pose = Pose::at(*start, heading);
        let bar = [
            pose.translated(0.0, LIGHT_M),
            pose.translated(0.0, -LIGHT_M),
        ]
        .map(|end| view.pixel(end.position()));
        canvas.line(&bar, Pen::solid(color, view.meters(width)));
    }
}

/// The trail, the refused plans, and the active plan with a dot each second.
fn paths(canvas: &mut Canvas, scene: &DrawnScene<'_>, view: &View) {
    let (colors, zoom) = (&*COLORS, view.zoom());
    canvas.line(
        &view.pixels(&scene.trail),
        Pen::solid(colors.ego, 1.6 * zoom),
    );
    for (path, _) in &scene.refused {
        let dash = [view.meters(1.2), view.meters(0.8)];
        canvas.line(
            &view.pixels(path),
            Pen::dashed(colors.tried, 5.0 * zoom, dash),
        );
    }
    let plan = view.pixels(scene.plan);
    canvas.line(&plan, Pen::solid(colors.ego, 3.0 * zoom));
    for &dot in plan.iter().skip(2).step_by(2) {
        canvas.disc(dot, 3.2 * zoom, colors.ego);
    }
}

fn agent(canvas: &mut Canvas, object: &TrackedObject, view: &View) {
    let colors = &*COLORS;
    let shape = &object.shape;
    match object.kind {
        ObjectKind::Pedestrian => {
            let diameter = shape.length.max(shape.width).max(PEDESTRIAN_M);
            canvas.disc(
                view.pixel(shape.center.position()),
                view.meters(diameter / 2.0),
                colors.pedestrian,
            );
        }
        ObjectKind::Vehicle => vehicle(canvas, shape, colors.vehicle, true, view),
        ObjectKind::Bicycle => vehicle(canvas, shape, colors.bicycle, true, view),
        ObjectKind::TrafficCone
        | ObjectKind::Barrier
        | ObjectKind::CzoneSign
        | ObjectKind::GenericObject => {
            vehicle(canvas, shape, colors.fixed, false, view);
        }
    }
    let heading = object.velocity.y.atan2(object.velocity.x);
    arrow(
        canvas,
        Pose::at(shape.center.position(), heading),
        object.speed(),
        view,
    );
}

/// A box, with a mark at its front.
fn vehicle(canvas: &mut Canvas, shape: &OrientedBox, color: Rgb, front: bool, view: &View) {
    let angle = view.angle(shape.center.heading);
    let size = (view.meters(shape.length), view.meters(shape.width));
    canvas.rectangle(view.pixel(shape.center.position()), size, angle, color, 1.0);
    if front {
        let ahead = shape.center.translated(0.26 * shape.length, 0.0);
        let mark = (0.12 * size.0, 0.72 * size.1);
        canvas.rectangle(
            view.pixel(ahead.position()),
            mark,
            angle,
            COLORS.panel,
            0.75,
        );
    }
}

/// The path in [`ARROW_S`] seconds at a speed.
fn arrow(canvas: &mut Canvas, pose: Pose, speed: f64, view: &View) {
    if speed < MOVING {
        return;
    }
    let length = ARROW_S * speed;
    let head = (length / 2.0).min(0.9);
    let at = |forward: f64, left: f64| view.pixel(pose.translated(forward, left).position());
    let tip = at(length, 0.0);
    let pen = Pen::solid(COLORS.ink, 1.2 * view.zoom());
    canvas.line(&[at(0.0, 0.0), tip], pen);
    canvas.line(
        &[
            at(length - head, 0.6 * head),
            tip,
            at(length - head, -0.6 * head),
        ],
        pen,
    );
}

/// The scale: a round number of meters.
fn scale(canvas: &mut Canvas, view: &View) {
    let zoom = view.zoom();
    let meters = [2.0, 5.0, 10.0, 20.0, 50.0]
        .into_iter()
        .find(|&m| view.meters(m) >= 60.0 * zoom)
        .unwrap_or(100.0);
    let (x, y) = (14.0 * zoom, view.side as f32 - 14.0 * zoom);
    let end = x + view.meters(meters);
    let tick = 4.0 * zoom;
    let bar = [(x, y - tick), (x, y), (end, y), (end, y - tick)];
    canvas.line(&bar, Pen::solid(COLORS.ink_soft, 1.5 * zoom));
    let letters = Lettering::regular(12.0 * zoom);
    canvas.label(
        &format!("{meters} m"),
        (x + 6.0 * zoom, y - 6.0 * zoom),
        letters,
        COLORS.ink_soft,
        COLORS.ground,
    );
}
