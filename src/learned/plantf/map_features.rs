//! The map as PlanTF sees it: three lines a polygon.

use super::crosswalk::crosswalk_edges;
use super::network::PlanTfMap;
use candle_core::{Device, Result, Tensor};
use planagent_world::geometry::{Borders, OrientedBox, Point, Polyline, Pose, borders};
use planagent_world::{Lane, LaneKind, RoadblockId, SceneView, SignalStatus};

/// Half side of the square of the map, meters.
const RADIUS: f64 = 100.0;
/// Vectors of a line.
pub const VECTORS: usize = 20;
/// The vector that stands for a polygon.
const MIDDLE: usize = VECTORS / 2;

/// A line as twenty vectors, in the frame of the rear axle.
#[derive(Debug, Clone, PartialEq)]
pub struct LineFeatures {
    /// Starts of the vectors, meters.
    pub point: [[f32; 2]; VECTORS],
    /// The vectors.
    pub vector: [[f32; 2]; VECTORS],
    /// Their directions without wrapping, radians.
    pub orientation: [f32; VECTORS],
}

/// A lane, a connector or a crosswalk.
#[derive(Debug, Clone, PartialEq)]
pub struct PolygonFeatures {
    /// Center line, left and right border.
    pub lines: [LineFeatures; 3],
    /// Which points of the center line are inside the square.
    pub valid: [bool; VECTORS],
    /// 0 lane, 1 connector, 2 crosswalk.
    pub kind: u32,
    /// Whether it is on the route.
    pub on_route: bool,
    /// 0 green, 1 yellow, 2 red, 3 unknown.
    pub light: u32,
    /// Speed limit, m/s.
    pub speed_limit: Option<f32>,
}

impl PolygonFeatures {
    /// x, y and direction of the middle.
    pub fn center(&self) -> [f32; 3] {
        let [
            LineFeatures {
                point, orientation, ..
            },
            ..,
        ] = &self.lines;
        let [x, y] = point[MIDDLE];
        [x, y, orientation[MIDDLE]]
    }
}

/// Lanes, connectors and crosswalks, in this order.
#[derive(Debug, Clone, PartialEq)]
pub struct MapFeatures {
    /// Those with a valid point.
    pub polygons: Vec<PolygonFeatures>,
}

impl MapFeatures {
    /// Those around the ego.
    pub fn from_scene(scene: &SceneView<'_>, route: &[RoadblockId]) -> Self {
        let (map, frame, center) = (
            scene.map,
            scene.ego.rear_axle,
            scene.ego.center().position(),
        );
        let mut lanes: Vec<&Lane> = map
            .lanes_near(center, RADIUS)
            .into_iter()
            .map(|lane| &map[lane])
            .collect();
        // Upstream asks for lanes first and for connectors after them. The sort is stable, which
        // keeps the order of each.
        lanes.sort_by_key(|lane| lane.kind == LaneKind::Connector);
        let lanes = lanes.into_iter().map(|lane| {
            let Borders { left, right } = borders(&lane.centerline, &lane.polygon);
            let lines = [&lane.centerline, &left, &right].map(resampled);
            let (kind, on_route) = (
                u32::from(lane.is_connector()),
                route.contains(&lane.roadblock),
            );
            let light = light(scene.lights.status(lane.id));
            let speed_limit = lane.speed_limit.map(|limit| limit as f32);
            polygon(
                &lines,
                frame,
                PolygonAttributes {
                    kind,
                    on_route,
                    light,
                    speed_limit,
                },
            )
        });
        let square = OrientedBox::new(Pose::at(center, 0.0), 2.0 * RADIUS, 2.0 * RADIUS);
        let crosswalks = map
            .crosswalks_near(center, RADIUS)
            .filter(|area| area.meets_box(&square));
        let crosswalks = crosswalks.filter_map(crosswalk_edges).map(|edges| {
            let lines =
                edges.map(|[from, to]| std::array::from_fn(|i| from + (to - from) * share(i)));
            let unknown = PolygonAttributes {
                kind: 2,
                on_route: false,
                light: light(None),
                speed_limit: None,
            };
            polygon(&lines, frame, unknown)
        });
        let polygons = lanes
            .chain(crosswalks)
            .filter(|polygon| polygon.valid.contains(&true));
        Self {
            polygons: polygons.collect(),
        }
    }

    /// A batch of one. Without any polygon, one stands there whose every point is masked.
    pub(super) fn inputs(&self) -> Result<PlanTfMap> {
        // A masked polygon stands for none, so that no layer meets a tensor without rows.
        let nothing = [PolygonFeatures::masked()];
        let polygons = if self.polygons.is_empty() {
            &nothing[..]
        } else {
            &self.polygons
        };
        let count = polygons.len();
        let center_lines = || polygons.iter().map(|polygon| &polygon.lines[0]);
        let pairs =
            |values: Vec<f32>| Tensor::from_vec(values, (1, count, VECTORS, 2), &Device::Cpu);
        let point = center_lines()
            .flat_map(|line| line.point.as_flattened())
            .copied()
            .collect();
        let vector = center_lines()
            .flat_map(|line| line.vector.as_flattened())
            .copied()
            .collect();
        let orientation: Vec<f32> = center_lines().flat_map(|line| line.orientation).collect();
        let center: Vec<f32> = polygons.iter().flat_map(PolygonFeatures::center).collect();
        let indices = |read: fn(&PolygonFeatures) -> u32| {
            Tensor::from_vec(
                polygons.iter().map(read).collect::<Vec<u32>>(),
                (1, count),
                &Device::Cpu,
            )
        };
        let limit: Vec<f32> = polygons
            .iter()
            .map(|polygon| polygon.speed_limit.unwrap_or_default())
            .collect();
        let limited: Vec<u8> = polygons
            .iter()
            .map(|polygon| u8::from(polygon.speed_limit.is_some()))
            .collect();
        let valid: Vec<u8> = polygons
            .iter()
            .flat_map(|polygon| polygon.valid)
            .map(u8::from)
            .collect();
        Ok(PlanTfMap {
            point: pairs(point)?,
            vector: pairs(vector)?,
            orientation: Tensor::from_vec(orientation, (1, count, VECTORS), &Device::Cpu)?,
            center: Tensor::from_vec(center, (1, count, 3), &Device::Cpu)?,
            kind: indices(|polygon| polygon.kind)?,
            on_route: indices(|polygon| u32::from(polygon.on_route))?,
            light: indices(|polygon| polygon.light)?,
            speed_limit: Tensor::from_vec(limit, (1, count), &Device::Cpu)?,
            has_speed_limit: Tensor::from_vec(limited, (1, count), &Device::Cpu)?,
            valid: Tensor::from_vec(valid, (1, count, VECTORS), &Device::Cpu)?,
        })
    }
}

impl PolygonFeatures {
    /// A polygon that the network does not see.
    fn masked() -> Self {
        let line = LineFeatures {
            point: [[0.0; 2]; VECTORS],
            vector: [[0.0; 2]; VECTORS],
            orientation: [0.0; VECTORS],
        };
        Self {
            lines: [line.clone(), line.clone(), line],
            valid: [false; VECTORS],
            kind: 0,
            on_route: false,
            light: light(None),
            speed_limit: None,
        }
    }
}

/// What a polygon is apart from its lines.
#[derive(Debug, Clone, Copy)]
struct PolygonAttributes {
    kind: u32,
    on_route: bool,
    light: u32,
    speed_limit: Option<f32>,
}

fn light(status: Option<SignalStatus>) -> u32 {
    match status {
        Some(SignalStatus::Green) => 0,
        Some(SignalStatus::Yellow) => 1,
        Some(SignalStatus::Red) => 2,
        Some(SignalStatus::Unknown) | None => 3,
    }
}

fn share(i: usize) -> f64 {
    i as f64 / VECTORS as f64
}

/// Points that divide a line into vectors of equal arc length.
fn resampled(line: &Polyline) -> [Point; VECTORS + 1] {
    std::array::from_fn(|i| line.point_at(line.length() * share(i)))
}

fn polygon(
    lines: &[[Point; VECTORS + 1]; 3],
    frame: Pose,
    attributes: PolygonAttributes,
) -> PolygonFeatures {
    let PolygonAttributes {
        kind,
        on_route,
        light,
        speed_limit,
    } = attributes;
    let lines = [0, 1, 2].map(|i| local(&lines[i], frame));
    let inside = |[x, y]: [f32; 2]| f64::from(x).abs() < RADIUS && f64::from(y).abs() < RADIUS;
    PolygonFeatures {
        valid: lines[0].point.map(inside),
        lines,
        kind,
        on_route,
        light,
        speed_limit,
    }
}

fn local(points: &[Point; VECTORS + 1], frame: Pose) -> LineFeatures {
    let places = points.map(|point| frame.to_local(point));
    let vector = |i: usize| places[i + 1] - places[i];
    let direction = |i: usize| {
        let along = points[i + 1] - points[i];
        along.y.atan2(along.x) - frame.heading
    };
    LineFeatures {
        point: std::array::from_fn(|i| [places[i].x as f32, places[i].y as f32]),
        vector: std::array::from_fn(|i| [vector(i).x as f32, vector(i).y as f32]),
        orientation: std::array::from_fn(|i| direction(i) as f32),
    }
}
