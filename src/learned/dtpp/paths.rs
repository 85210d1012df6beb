//! DTPP's candidate paths (`MCZhi/DTPP` `trajectory_tree_planner.py`).

use crate::lattice::{
    Course, MAX_ROWS, bent, candidates, course, curvature, every_tenth, long_enough,
    starting_block, starting_lanes,
};
use planagent_world::geometry::{Corridor, Point, Polyline};
use planagent_world::{ObjectKind, PACIFICA, SceneView};

/// Candidates of this length are long enough, meters.
const ACCEPTABLE_LENGTH: f64 = 60.0;
/// Slower vehicles are obstacles, m/s.
const STANDING: f64 = 0.1;
/// Vertices of a path that are checked, every tenth for obstacles.
const CHECKED: usize = 100;
const STRIDE: usize = 10;
/// Costs of an obstacle and of curvature.
const OBSTACLE: f64 = 10.0;
const CURVATURE: f64 = 0.1;
/// Paths that trajectories may take.
const PATHS: usize = 3;
/// Speed limit of a lane without one, m/s.
const DEFAULT_LIMIT: f64 = 13.0;

/// Paths with their costs, 1 where an obstacle is on them, largest curvature (1 per meter) and
/// distance of the lane (meters).
#[derive(Debug, Clone, PartialEq)]
pub struct CostedPath {
    /// Its vertices in the frame of the map.
    pub points: Vec<Point>,
    /// 1 with an obstacle.
    pub obstacle: f64,
    /// Meters.
    pub distance: f64,
    /// 1 per meter.
    pub curvature: f64,
}

impl CostedPath {
    /// The cost.
    pub fn cost(&self) -> f64 {
        OBSTACLE * self.obstacle + self.distance + CURVATURE * self.curvature
    }
}

/// All candidate paths of a scene.
pub fn costed_paths(scene: &SceneView<'_>) -> Vec<CostedPath> {
    let Some((block, _)) = starting_block(scene) else {
        return Vec::new();
    };
    // What moves is left to the scores of the tree, which know where it is at each time.
    let obstacles: Vec<_> = scene
        .objects
        .iter()
        .filter(|object| match object.kind {
            ObjectKind::Vehicle => object.velocity.norm() < STANDING,
            ObjectKind::Pedestrian | ObjectKind::Bicycle => false,
            _ => true,
        })
        .map(|object| object.shape)
        .collect();
    let lanes = long_enough(
        candidates(scene, &starting_lanes(scene, block)),
        ACCEPTABLE_LENGTH,
    );
    let costed = |(distance, points): (f64, Vec<Point>)| {
        let line = Polyline::new(points.iter().take(CHECKED).step_by(STRIDE).copied()).ok()?;
        let strip = Corridor::with_square_caps(&line, PACIFICA.width / 2.0);
        let obstacle = if obstacles.iter().any(|shape| strip.meets_box(shape)) {
            1.0
        } else {
            0.0
        };
        let curvature = curvature(&points[..points.len().min(CHECKED)])?;
        Some(CostedPath {
            points,
            obstacle,
            distance,
            curvature,
        })
    };
    let paths = lanes.iter().flat_map(|lane| {
        bent(scene.ego.rear_axle, lane)
            .into_iter()
            .map(|points| (lane.distance, points))
    });
    paths.filter_map(costed).collect()
}

/// The courses of the cheapest paths in the frame of the rear axle, and the speed limit, m/s.
pub fn paths(scene: &SceneView<'_>) -> (Vec<Course>, f64) {
    let mut costed: Vec<CostedPath> = Vec::new();
    for path in costed_paths(scene) {
        // Of equally expensive paths upstream keeps the last.
        costed.retain(|known| known.cost().to_bits() != path.cost().to_bits());
        costed.push(path);
    }
    costed.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    let local = |path: &CostedPath| {
        let points: Vec<Point> = path
            .points
            .iter()
            .map(|&point| scene.ego.rear_axle.to_local(point))
            .collect();
        let mut rows = course(&every_tenth(&points))?;
        rows.truncate(MAX_ROWS);
        Some(rows)
    };
    let limit = starting_block(scene).and_then(|(block, _)| {
        let first = starting_lanes(scene, block)
            .first()
            .and_then(|&lane| scene.map[lane].speed_limit);
        // As in Python, a limit of 0 is none.
        first.filter(|&limit| limit != 0.0)
    });
    (
        costed.iter().take(PATHS).filter_map(local).collect(),
        limit.unwrap_or(DEFAULT_LIMIT),
    )
}
