//! GameFormer's reference path (`MCZhi/GameFormer-Planner` `planner.py`,
//! `state_lattice_path_planner.py`).

use crate::lattice::{
    Candidate, Course, MAX_ROWS, bent, candidates, course, curvature, every_tenth, long_enough,
    relative_course, starting_block, starting_lanes,
};
use planagent_world::geometry::{Corridor, OrientedBox, Point, Polyline, borders};
use planagent_world::{LaneId, ObjectKind, PACIFICA, RoadblockId, SceneView};

/// A route farther away has no reference path, meters.
const MAX_ROUTE_DISTANCE: f64 = 5.0;
/// Candidates of this length are long enough, meters.
const ACCEPTABLE_LENGTH: f64 = 24.0;
/// Objects farther from the ego are ignored, meters.
const MAX_OBJECT_DISTANCE: f64 = 30.0;
/// Slower vehicles are obstacles, m/s.
const STANDING: f64 = 0.01;
/// Vertices of a path that are checked, and those checked for a lane to change to.
const CHECKED: usize = 100;
const CHECKED_TARGET: usize = 50;
/// A lane is worth changing to when it is at most this much shorter than the longest, and no moving
/// vehicle is nearer, meters.
const TARGET_LENGTH: f64 = 5.0;
const TARGET_CLEARANCE: f64 = 5.0;
/// Costs of an obstacle, of leaving the road, of curvature; what a lane worth changing to saves.
const OBSTACLE: f64 = 10.0;
const OUT_OF_BOUNDARY: f64 = 2.0;
const CURVATURE: f64 = 0.1;
const TARGET: f64 = 5.0;
/// Factor of the distance from the lane where the ego shall stay on its own.
const STAY: f64 = 5.0;
/// This many lanes side by side, and a speed up to this one (m/s), keep the ego on its lane.
const MANY_LANES: usize = 4;
const SLOW: f64 = 3.0;
/// Speed limit of a lane without one, and the bounds of all, m/s.
const DEFAULT_LIMIT: f64 = 13.0;
const LIMITS: [f64; 2] = [3.0, 15.0];
/// From the first row with more curvature on, the limit is the lower one, 1 per meter.
const SHARP: f64 = 0.1;
/// A red connector with at least this many vertices occupies the rows nearer than this, meters.
const RED_VERTICES: usize = 80;
const RED_DISTANCE: f64 = 0.5;

/// Rows of a reference path, 0.1 m apart, in the frame of the rear axle. A row is x, y, heading,
/// curvature, speed limit (m/s), and 1 where a red light holds. The last row repeats up to 120 m.
pub type ReferencePath = Vec<[f32; 6]>;

/// The parts of a path's cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathCost {
    /// 1 with an obstacle on the path.
    pub obstacle: f64,
    /// 1 when the path crosses the border of the road.
    pub out_of_boundary: f64,
    /// Distance of the lane, meters, times five where the ego shall stay on its own.
    pub distance: f64,
    /// Largest curvature, 1 per meter; `None` where it is not defined.
    pub curvature: Option<f64>,
    /// 1 for a free lane that is long enough.
    pub target: f64,
}

impl PathCost {
    /// The cost; `None` where it is not defined.
    pub fn sum(&self) -> Option<f64> {
        let Self {
            obstacle,
            out_of_boundary,
            distance,
            curvature,
            target,
        } = self;
        Some(
            OBSTACLE * obstacle
                + OUT_OF_BOUNDARY * out_of_boundary
                + distance
                + CURVATURE * (*curvature)?
                - TARGET * target,
        )
    }
}

/// The reference path; `None` where the ego is far from its route or no path can be made.
pub fn reference_path(scene: &SceneView<'_>) -> Option<ReferencePath> {
    let (block, distance) = starting_block(scene)?;
    if distance > MAX_ROUTE_DISTANCE {
        return None;
    }
    let mut best: Option<(f64, Vec<Point>)> = None;
    for (path, cost) in costed_paths(scene, block) {
        if let Some(cost) = cost.sum()
            && best.as_ref().is_none_or(|(least, _)| cost < *least)
        {
            best = Some((cost, path));
        }
    }
    let (_, path) = best?;
    let rows = relative_course(&course(&every_tenth(&path))?, scene.ego.rear_axle);
    annotated(scene, block, &rows)
}

/// All paths from a roadblock on with their costs, the nearest lane's first.
pub fn costed_paths(scene: &SceneView<'_>, block: RoadblockId) -> Vec<(Vec<Point>, PathCost)> {
    let mut lanes = long_enough(
        candidates(scene, &starting_lanes(scene, block)),
        ACCEPTABLE_LENGTH,
    );
    lanes.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    let longest = lanes.iter().map(|lane| lane.length).fold(0.0, f64::max);
    let footprint = scene.ego.footprint();
    let near = scene
        .objects
        .iter()
        .filter(|object| object.shape.distance(&footprint) <= MAX_OBJECT_DISTANCE);
    let (mut obstacles, mut vehicles) = (Vec::new(), Vec::new());
    for object in near {
        match object.kind {
            ObjectKind::Vehicle if object.velocity.norm() >= STANDING => {
                vehicles.push(object.shape);
            }
            ObjectKind::Pedestrian | ObjectKind::Bicycle => {}
            _ => obstacles.push(object.shape),
        }
    }
    // Upstream's rule for where a change of lane costs more: at lights, and slow on a wide road.
    let stay = scene.lights.iter().next().is_some()
        || (scene.map[block].lanes.len() >= MANY_LANES && scene.ego.velocity.x <= SLOW);
    let costed = |lane: &Candidate, path: Vec<Point>| {
        let strip = |count: usize| {
            let line = Polyline::new(path.iter().take(count).copied()).ok()?;
            Some(Corridor::with_square_caps(&line, PACIFICA.width / 2.0))
        };
        let (strip, start) = (strip(CHECKED), strip(CHECKED_TARGET));
        let flag = |holds: Option<bool>| if holds.unwrap_or(false) { 1.0 } else { 0.0 };
        let cost = PathCost {
            obstacle: flag(
                strip
                    .as_ref()
                    .map(|strip| obstacles.iter().any(|shape| strip.meets_box(shape))),
            ),
            out_of_boundary: flag(
                strip
                    .as_ref()
                    .map(|strip| leaves_road(scene, strip, &lane.lanes)),
            ),
            distance: if stay {
                STAY * lane.distance
            } else {
                lane.distance
            },
            curvature: curvature(&path[..path.len().min(CHECKED)]),
            target: flag(start.map(|start| {
                longest - lane.length <= TARGET_LENGTH && is_clear(&start, &vehicles)
            })),
        };
        (path, cost)
    };
    let paths = lanes.iter().flat_map(|lane| {
        bent(scene.ego.rear_axle, lane)
            .into_iter()
            .map(move |path| (lane, path))
    });
    paths.map(|(lane, path)| costed(lane, path)).collect()
}

fn is_clear(strip: &Corridor, vehicles: &[OrientedBox]) -> bool {
    vehicles
        .iter()
        .all(|vehicle| strip.distance_to_box(vehicle) >= TARGET_CLEARANCE)
}

/// Whether a strip crosses a border of its lanes where no lane is beside.
fn leaves_road(scene: &SceneView<'_>, strip: &Corridor, lanes: &[LaneId]) -> bool {
    lanes.iter().map(|&lane| &scene.map[lane]).any(|lane| {
        if !lane.left.is_empty() && !lane.right.is_empty() {
            return false;
        }
        let sides = borders(&lane.centerline, &lane.polygon);
        (lane.left.is_empty() && strip.meets_line(&sides.left))
            || (lane.right.is_empty() && strip.meets_line(&sides.right))
    })
}

/// The rows with speed limits and red lights, up to 120 m; `None` without rows.
fn annotated(scene: &SceneView<'_>, block: RoadblockId, rows: &Course) -> Option<ReferencePath> {
    let first = scene.map[block]
        .lanes
        .first()
        .map(|&lane| &scene.map[lane])?;
    // As in Python, a limit of 0 is none.
    let limit = first
        .speed_limit
        .filter(|&limit| limit != 0.0)
        .unwrap_or(DEFAULT_LIMIT);
    let limit = limit.clamp(LIMITS[0], LIMITS[1]);
    let sharp = rows
        .iter()
        .position(|row| row[3].abs() > SHARP)
        .filter(|&row| row > 0)
        .unwrap_or(rows.len());
    let allowed = scene.route.lanes(scene.map);
    let red: Vec<Vec<Point>> = scene
        .lights
        .red()
        .filter(|connector| allowed.contains(connector))
        .map(|connector| scene.map[connector].centerline.vertices())
        .filter(|line| line.len() >= RED_VERTICES)
        .map(|line| {
            line.iter()
                .map(|&point| scene.ego.rear_axle.to_local(point))
                .collect()
        })
        .collect();
    let is_red = |x: f64, y: f64| {
        let here = Point::new(x, y);
        red.iter()
            .flatten()
            .any(|point| (point - here).norm() < RED_DISTANCE)
    };
    let row = |(i, &[x, y, heading, curvature]): (usize, &[f64; 4])| {
        let limit = if i >= sharp { LIMITS[0] } else { limit };
        let red = if is_red(x, y) { 1.0 } else { 0.0 };
        [x, y, heading, curvature, limit, red].map(|value| value as f32)
    };
    let mut path: ReferencePath = rows.iter().enumerate().map(row).collect();
    path.resize(MAX_ROWS, *path.last()?);
    Some(path)
}
