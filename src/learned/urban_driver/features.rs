//! UrbanDriver's features (nuplan-devkit `vector_set_map_feature_builder.py`,
//! `generic_agents_feature_builder.py`).

use super::elements::{FRAMES, MapPoint, POINTS, UrbanDriverFeatures};
use crate::frame::{relative, rounded, single};
use crate::past;
use planagent_world::geometry::{
    Borders, OrientedBox, Point, Polygon, Pose, borders, unwrap_angles,
};
use planagent_world::{
    HistorySample, Lane, LaneKind, MICROS_PER_SECOND, ObjectKind, RoadblockId, SceneView,
    SignalStatus, TrackToken, TrackedObject,
};

/// Steps between two frames of the history.
const STRIDE: usize = 4;
/// Half side of the square of the map, meters.
const RADIUS: f64 = 35.0;
/// Places of the light's colors in its encoding.
const GREEN: [f32; 4] = [1.0, 0.0, 0.0, 0.0];
const YELLOW: [f32; 4] = [0.0, 1.0, 0.0, 0.0];
const RED: [f32; 4] = [0.0, 0.0, 1.0, 0.0];
const UNKNOWN: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

impl UrbanDriverFeatures {
    /// Of a scene. As upstream, states pass through f32 in the frame of the map before their
    /// differences are taken.
    pub fn from_scene(scene: &SceneView<'_>) -> Self {
        let samples: Vec<HistorySample> = past::samples(scene, (FRAMES - 1) * STRIDE + 1)
            .into_iter()
            .step_by(STRIDE)
            .collect();
        let frame = rounded(scene.ego.rear_axle);
        let ego = |i: usize| relative(frame, rounded(samples[i].ego.rear_axle));
        Self {
            ego: std::array::from_fn(ego),
            vehicles: vehicles(scene, &samples, frame),
            layers: layers(scene),
        }
    }
}

/// The vehicles of the present, in its order. A missing past state is the next later one.
fn vehicles(
    scene: &SceneView<'_>,
    samples: &[HistorySample],
    frame: Pose,
) -> Vec<[[f32; 8]; FRAMES]> {
    let present = scene
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle);
    let seen = |sample: &HistorySample, token: TrackToken| -> Option<TrackedObject> {
        let mut vehicles = sample
            .objects
            .iter()
            .filter(|object| object.kind == ObjectKind::Vehicle);
        vehicles.find(|object| object.token == token).copied()
    };
    let times: Vec<f64> = samples
        .iter()
        .map(|sample| sample.ego.time_us as f64 / MICROS_PER_SECOND)
        .collect();
    let step = (times[FRAMES - 1] - times[0]) / (FRAMES - 1) as f64;
    let states = |now: &TrackedObject| {
        let mut states = [*now; FRAMES];
        for i in (0..FRAMES - 1).rev() {
            states[i] = seen(&samples[i], now.token).unwrap_or(states[i + 1]);
        }
        let rows = states.map(|state| vehicle(&state, scene, frame));
        let headings = unwrap_angles(&rows.map(|[_, _, heading, ..]| f64::from(heading)));
        // Upstream does not divide the differences at both ends by the time between the frames.
        let yaw_rate = |i: usize| match i {
            0 => headings[1] - headings[0],
            i if i == FRAMES - 1 => headings[i] - headings[i - 1],
            i => (headings[i + 1] - headings[i - 1]) / (2.0 * step),
        };
        std::array::from_fn(|i| {
            let [x, y, heading, vx, vy, _, length, width] = rows[i];
            [x, y, heading, vx, vy, yaw_rate(i) as f32, length, width]
        })
    };
    present.map(states).collect()
}

/// x, y, heading, velocity, 0, length, width. As upstream, the ego's velocity in its own frame is
/// subtracted from the vehicle's in the map's.
fn vehicle(state: &TrackedObject, scene: &SceneView<'_>, frame: Pose) -> [f32; 8] {
    let OrientedBox {
        center,
        length,
        width,
    } = state.shape;
    let [x, y, heading] = relative(frame, rounded(center));
    let own = scene.ego.velocity.map(single);
    let moving = Pose::new(own.x, own.y, frame.heading);
    let velocity = moving.to_local(Point::from(state.velocity.map(single)));
    [
        x,
        y,
        heading,
        velocity.x as f32,
        velocity.y as f32,
        0.0,
        length as f32,
        width as f32,
    ]
}

fn layers(scene: &SceneView<'_>) -> [Vec<Vec<MapPoint>>; 6] {
    let (map, frame) = (scene.map, scene.ego.rear_axle);
    let here = frame.position();
    let mut lanes: Vec<&Lane> = map
        .lanes_near(here, RADIUS)
        .into_iter()
        .map(|lane| &map[lane])
        .collect();
    // Upstream asks for lanes first and for connectors after them, which decides ties in distance.
    lanes.sort_by_key(|lane| lane.kind == LaneKind::Connector);
    let lanes = nearest(lanes, here);
    let sides: Vec<Borders> = lanes
        .iter()
        .map(|lane| borders(&lane.centerline, &lane.polygon))
        .collect();
    let dark = [0.0; 4];
    let line = |points: &[Point], light| {
        resampled(points)
            .map(|point| local(frame, point, light))
            .to_vec()
    };
    let colored = |lane: &&Lane| {
        line(
            lane.centerline.vertices(),
            light(scene.lights.status(lane.id)),
        )
    };
    let side =
        |read: fn(&Borders) -> &[Point]| sides.iter().map(|side| line(read(side), dark)).collect();
    let square = OrientedBox::new(Pose::at(here, 0.0), 2.0 * RADIUS, 2.0 * RADIUS);
    let outlines = |areas: &mut dyn Iterator<Item = &Polygon>| {
        let areas = by_distance(
            areas.filter(|area| area.meets_box(&square)).collect(),
            |area| area.distance_to(here),
        );
        let closed = |area: &Polygon| {
            let ring = area.ring().iter().chain(area.ring().first()).take(POINTS);
            ring.map(|&point| local(frame, point, dark)).collect()
        };
        areas.into_iter().map(closed).collect()
    };
    let blocks = connected(&scene.route.roadblocks, &map.roadblocks_near(here, RADIUS));
    let route = blocks
        .iter()
        .flat_map(|&block| map[block].lanes.iter().map(|&lane| &map[lane]))
        .collect();
    [
        lanes.iter().map(colored).collect(),
        side(|side| side.left.vertices()),
        side(|side| side.right.vertices()),
        outlines(&mut map.stop_lines().iter().map(|line| &line.polygon)),
        outlines(&mut map.crosswalks_near(here, RADIUS)),
        nearest(route, here)
            .into_iter()
            .map(|lane| line(lane.centerline.vertices(), dark))
            .collect(),
    ]
}

fn nearest(lanes: Vec<&Lane>, here: Point) -> Vec<&Lane> {
    by_distance(lanes, |lane| lane.polygon.distance_to(here))
}

/// Stably sorted by distance.
fn by_distance<T>(mut items: Vec<&T>, distance: impl Fn(&T) -> f64) -> Vec<&T> {
    items.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    items
}

/// The part of the route in the square, up to its first gap.
fn connected(route: &[RoadblockId], near: &[RoadblockId]) -> Vec<RoadblockId> {
    let ahead = route.iter().skip_while(|block| !near.contains(block));
    ahead
        .take_while(|block| near.contains(block))
        .copied()
        .collect()
}

fn light(status: Option<SignalStatus>) -> [f32; 4] {
    match status {
        Some(SignalStatus::Green) => GREEN,
        Some(SignalStatus::Yellow) => YELLOW,
        Some(SignalStatus::Red) => RED,
        Some(SignalStatus::Unknown) | None => UNKNOWN,
    }
}

fn local(frame: Pose, point: Point, light: [f32; 4]) -> MapPoint {
    let place = frame.to_local(point);
    MapPoint {
        place: [place.x as f32, place.y as f32],
        light,
    }
}

/// Twenty points of a line by the numbers of its vertices, not by its length.
fn resampled(points: &[Point]) -> [Point; POINTS] {
    std::array::from_fn(|i| {
        let at = i as f64 * (points.len() - 1) as f64 / (POINTS - 1) as f64;
        let before = (at as usize).min(points.len() - 1);
        let after = (before + 1).min(points.len() - 1);
        points[before] + (points[after] - points[before]) * (at - before as f64)
    })
}
