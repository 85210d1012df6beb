//! The raster (nuplan-devkit `raster_utils.py`).

use super::drawing::{Canvas, Vertex};
use candle_core::{Device, Result, Tensor};
use planagent_world::geometry::{Bounds, OrientedBox, Point, Polygon, Pose};
use planagent_world::{LaneKind, SceneView};

/// Pixels of a side.
pub const SIDE: usize = 224;
/// Half side of the square that is drawn, meters.
const RADIUS: f64 = 56.0;
/// Side of a pixel, meters.
const PIXEL: f64 = 0.5;
/// Bits of the fraction of the map's areas, the agents' boxes and the baselines.
const AREA_SHIFT: u32 = 12;
const BOX_SHIFT: u32 = 9;
const LINE_SHIFT: u32 = 13;
/// Columns and rows of the ego.
const EGO_COLUMNS: [i64; 2] = [110, 114];
const EGO_ROWS: [i64; 2] = [104, 114];
/// Values of lanes and intersections, and of stop lines and crosswalks.
const ROAD: f32 = 1.0;
const MARKING: f32 = 0.5;

/// A raster: ego, agents, road map, baselines.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// The four channels, rows from top to bottom; forward is up.
    pub channels: [Vec<f32>; 4],
}

impl Raster {
    /// Of a scene.
    pub fn from_scene(scene: &SceneView<'_>) -> Self {
        let mut ego = Canvas::new(SIDE);
        ego.rectangle(EGO_COLUMNS, EGO_ROWS, 1.0);
        Self {
            channels: [
                ego.pixels,
                mirrored(&agents(scene)),
                mirrored(&road(scene)),
                mirrored(&baselines(scene)),
            ],
        }
    }

    /// A batch of one (1, 4, 224, 224).
    ///
    /// # Errors
    /// When the tensor cannot be made.
    pub fn inputs(&self) -> Result<Tensor> {
        Tensor::from_vec(
            self.channels.concat(),
            (1, self.channels.len(), SIDE, SIDE),
            &Device::Cpu,
        )
    }
}

/// Upside down.
fn mirrored(canvas: &Canvas) -> Vec<f32> {
    canvas
        .pixels
        .chunks_exact(SIDE)
        .rev()
        .flatten()
        .copied()
        .collect()
}

/// A point relative to a frame as a vertex of the raster before it is mirrored: columns to the
/// right, rows forward.
fn vertex(frame: Pose, point: Point, shift: u32) -> Vertex {
    let local = frame.to_local(point);
    let fixed = |place: f64| ((RADIUS + place) / PIXEL * f64::from(1u32 << shift)) as i64;
    [fixed(-local.y), fixed(local.x)]
}

/// All objects whose center is in the square, from the rear axle.
fn agents(scene: &SceneView<'_>) -> Canvas {
    let frame = scene.ego.rear_axle;
    let mut canvas = Canvas::new(SIDE);
    for object in scene.objects {
        let center = frame.to_local(object.shape.center.position());
        if center.x.abs() < RADIUS && center.y.abs() < RADIUS {
            let corners = object
                .shape
                .corners()
                .map(|corner| vertex(frame, corner, BOX_SHIFT));
            canvas.polygon(&corners, BOX_SHIFT, 1.0);
        }
    }
    canvas
}

/// Lanes, intersections, stop lines and crosswalks, later ones above earlier ones, from the center
/// of the ego.
fn road(scene: &SceneView<'_>) -> Canvas {
    let (map, frame) = (scene.map, scene.ego.center());
    let here = frame.position();
    let square = OrientedBox::new(Pose::at(here, 0.0), 2.0 * RADIUS, 2.0 * RADIUS);
    let mut canvas = Canvas::new(SIDE);
    let mut draw = |area: &Polygon, value: f32| {
        if area.meets_box(&square) {
            let ring: Vec<Vertex> = area
                .ring()
                .iter()
                .map(|&point| vertex(frame, point, AREA_SHIFT))
                .collect();
            canvas.polygon(&ring, AREA_SHIFT, value);
        }
    };
    let lanes = map
        .lanes_near(here, RADIUS)
        .into_iter()
        .filter(|&lane| map[lane].kind == LaneKind::Lane);
    lanes.for_each(|lane| draw(&map[lane].polygon, ROAD));
    map.intersections_within(&Bounds::square(here, RADIUS))
        .for_each(|area| draw(area, ROAD));
    map.stop_lines()
        .iter()
        .for_each(|line| draw(&line.polygon, MARKING));
    map.crosswalks_near(here, RADIUS)
        .for_each(|area| draw(area, MARKING));
    canvas
}

/// The baselines of lanes and connectors, from the center of the ego.
fn baselines(scene: &SceneView<'_>) -> Canvas {
    let (map, frame) = (scene.map, scene.ego.center());
    let mut canvas = Canvas::new(SIDE);
    for lane in map.lanes_near(frame.position(), RADIUS) {
        let vertices = map[lane]
            .centerline
            .vertices()
            .iter()
            .map(|&point| vertex(frame, point, LINE_SHIFT));
        canvas.line(&vertices.collect::<Vec<Vertex>>(), LINE_SHIFT, 1.0);
    }
    canvas
}
