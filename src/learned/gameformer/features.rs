//! The features of GameFormer and DTPP (`MCZhi/GameFormer-Planner` `observation.py`, `MCZhi/DTPP`
//! `obs_adapter.py`).

use super::encoder::SceneInputs;
use crate::frame::{relative, rounded, single};
use crate::past;
use candle_core::{Device, Result, Tensor};
use planagent_world::geometry::{OrientedBox, Point, Pose, unwrap_angles};
use planagent_world::{
    HISTORY_SAMPLES, HistorySample, Lane, LaneKind, MICROS_PER_SECOND, ObjectKind, RoadblockId,
    SceneView, SignalStatus, TrackToken, TrackedObject,
};

/// Steps of an actor: the oldest sample of the history is read but not given.
const STEPS: usize = HISTORY_SAMPLES - 1;
/// Columns of the ego, another actor, a lane, and a crosswalk or route lane.
const EGO: usize = 7;
const NEIGHBOR: usize = 11;
const LANE: usize = 7;
const LINE: usize = 3;
/// Largest numbers of actors, lanes, crosswalks and route lanes, and the points of each.
const MAX_NEIGHBORS: usize = 20;
const LANES: [usize; 2] = [40, 50];
const CROSSWALKS: [usize; 2] = [5, 30];
const ROUTE: [usize; 2] = [10, 50];
/// Agents whose center is further behind the rear axle are left out, meters.
const BEHIND: f64 = -6.0;

/// Features of one scene, zeros where nothing is, in the frame of the rear axle now.
#[derive(Debug, Clone, PartialEq)]
pub struct ActorFeatures {
    /// The ego's steps (21, 7).
    pub ego: Vec<f32>,
    /// The other actors' steps (20, 21, 11).
    pub neighbors: Vec<f32>,
    /// Their tokens.
    pub tokens: Vec<TrackToken>,
    /// Lanes (40, 50, 7).
    pub lanes: Vec<f32>,
    /// Crosswalks (5, 30, 3).
    pub crosswalks: Vec<f32>,
    /// Lanes of the route (10, 50, 3).
    pub route: Vec<f32>,
}

impl ActorFeatures {
    /// Of a scene; the map is read in a square of this half side around the rear axle, meters. As
    /// upstream, states and points of the map pass through f32 in the frame of the map.
    pub fn from_scene(scene: &SceneView<'_>, radius: f64) -> Self {
        let samples = past::samples(scene, HISTORY_SAMPLES);
        let frame = rounded(scene.ego.rear_axle);
        let [lanes, crosswalks, route] = lines(scene, radius);
        let (neighbors, tokens) = neighbors(scene, &samples, frame);
        Self {
            ego: ego(&samples, frame),
            neighbors,
            tokens,
            lanes,
            crosswalks,
            route,
        }
    }

    /// A batch of one.
    ///
    /// # Errors
    /// When tensors cannot be made.
    pub fn inputs(&self) -> Result<SceneInputs> {
        let tensor =
            |values: &[f32], shape: &[usize]| Tensor::from_slice(values, shape, &Device::Cpu);
        Ok(SceneInputs {
            ego: tensor(&self.ego, &[1, STEPS, EGO])?,
            neighbors: tensor(&self.neighbors, &[1, MAX_NEIGHBORS, STEPS, NEIGHBOR])?,
            lanes: tensor(&self.lanes, &[1, LANES[0], LANES[1], LANE])?,
            crosswalks: tensor(&self.crosswalks, &[1, CROSSWALKS[0], CROSSWALKS[1], LINE])?,
        })
    }

    /// The ego now: pose, velocity, acceleration.
    pub fn present_ego(&self) -> [f32; 7] {
        let last = self.ego.len().saturating_sub(EGO);
        std::array::from_fn(|column| {
            self.ego
                .get(last + column)
                .copied()
                .expect("the history ends with the present row")
        })
    }

    /// The present states of the other actors.
    pub(crate) fn present_neighbors(&self) -> Vec<[f32; 11]> {
        let last =
            |steps: &[f32]| std::array::from_fn(|column| steps[(STEPS - 1) * NEIGHBOR + column]);
        self.neighbors
            .chunks_exact(STEPS * NEIGHBOR)
            .map(last)
            .collect()
    }

    /// The lanes of the route of a batch of one (1, 10, 50, 3).
    ///
    /// # Errors
    /// When the tensor cannot be made.
    pub fn route_input(&self) -> Result<Tensor> {
        Tensor::from_slice(
            &self.route,
            &[1, ROUTE[0], ROUTE[1], LINE][..],
            &Device::Cpu,
        )
    }
}

/// Pose relative to now; velocity and acceleration in the frame of each step.
fn ego(samples: &[HistorySample], frame: Pose) -> Vec<f32> {
    let steps = samples
        .iter()
        .skip(samples.len() - STEPS)
        .map(|sample| &sample.ego);
    let row = |ego: &planagent_world::EgoState| {
        let [x, y, heading] = relative(frame, rounded(ego.rear_axle));
        let (v, a) = (ego.velocity, ego.acceleration);
        [
            x, y, heading, v.x as f32, v.y as f32, a.x as f32, a.y as f32,
        ]
    };
    steps.flat_map(row).collect()
}

fn neighbors(
    scene: &SceneView<'_>,
    samples: &[HistorySample],
    frame: Pose,
) -> (Vec<f32>, Vec<TrackToken>) {
    let kinds = [
        ObjectKind::Vehicle,
        ObjectKind::Pedestrian,
        ObjectKind::Bicycle,
    ];
    let of_kind = |kind| {
        scene
            .objects
            .iter()
            .filter(move |object: &&TrackedObject| object.kind == kind)
    };
    let mut present: Vec<(f64, usize, &TrackedObject)> = Vec::new();
    for (i, &kind) in kinds.iter().enumerate() {
        present.extend(of_kind(kind).map(|object| {
            let [x, y, _] = relative(frame, rounded(object.shape.center));
            (f64::from(x.hypot(y)), i, object)
        }));
    }
    present.sort_by(|a, b| a.0.total_cmp(&b.0));
    present.truncate(MAX_NEIGHBORS);
    // After the cut, as upstream: neighbors far behind have taken places of others.
    present.retain(|(_, _, object)| {
        f64::from(relative(frame, rounded(object.shape.center))[0]) >= BEHIND
    });
    let rows = present
        .iter()
        .flat_map(|&(_, kind, object)| history(object, kind, samples, frame));
    let mut rows: Vec<f32> = rows.collect();
    rows.resize(MAX_NEIGHBORS * STEPS * NEIGHBOR, 0.0);
    (
        rows,
        present.iter().map(|(_, _, object)| object.token).collect(),
    )
}

/// The steps of one agent. A missing past state is the next later one.
fn history(now: &TrackedObject, kind: usize, samples: &[HistorySample], frame: Pose) -> Vec<f32> {
    let mut states = vec![*now; samples.len()];
    for i in (0..samples.len() - 1).rev() {
        let seen = samples[i]
            .objects
            .iter()
            .find(|object| object.token == now.token && object.kind == now.kind);
        states[i] = seen.copied().unwrap_or(states[i + 1]);
    }
    let rows: Vec<[f32; 3]> = states
        .iter()
        .map(|state| relative(frame, rounded(state.shape.center)))
        .collect();
    let headings = unwrap_angles(&rows.iter().map(|row| f64::from(row[2])).collect::<Vec<_>>());
    let seconds = |sample: &HistorySample| sample.ego.time_us as f64 / MICROS_PER_SECOND;
    let last = samples.len() - 1;
    let step = (seconds(&samples[last]) - seconds(&samples[0])) / last as f64;
    // Upstream does not divide the differences at both ends by the time between the samples.
    let yaw_rate = |i: usize| match i {
        0 => headings[1] - headings[0],
        i if i == last => headings[i] - headings[i - 1],
        i => (headings[i + 1] - headings[i - 1]) / (2.0 * step),
    };
    let turned = Pose::new(0.0, 0.0, frame.heading);
    let row = |i: usize| {
        let OrientedBox { length, width, .. } = states[i].shape;
        let velocity = turned.to_local(Point::from(states[i].velocity.map(single)));
        let [x, y, heading] = rows[i];
        let flag = |of: usize| if kind == of { 1.0 } else { 0.0 };
        [
            x,
            y,
            heading,
            velocity.x as f32,
            velocity.y as f32,
            yaw_rate(i) as f32,
            length as f32,
            width as f32,
            flag(0),
            flag(1),
            flag(2),
        ]
    };
    (samples.len() - STEPS..samples.len())
        .flat_map(row)
        .collect()
}

/// A point as f32 holds it.
type Single = [f32; 2];

fn lines(scene: &SceneView<'_>, radius: f64) -> [Vec<f32>; 3] {
    let (map, here) = (scene.map, scene.ego.rear_axle.position());
    let square = OrientedBox::new(Pose::at(here, 0.0), 2.0 * radius, 2.0 * radius);
    let points = |points: &[Point]| {
        points
            .iter()
            .map(|point| [point.x as f32, point.y as f32])
            .collect::<Vec<Single>>()
    };
    let mut lanes: Vec<&Lane> = map
        .lanes_near(here, radius)
        .into_iter()
        .map(|lane| &map[lane])
        .collect();
    lanes.sort_by_key(|lane| lane.kind == LaneKind::Connector);
    // The order of equally near lines: nuPlan's, by the distance of their areas.
    lanes.sort_by(|a, b| {
        a.polygon
            .distance_to(here)
            .total_cmp(&b.polygon.distance_to(here))
    });
    let lit = |lane: &&Lane| {
        (
            points(lane.centerline.vertices()),
            Some(light(scene.lights.status(lane.id))),
        )
    };
    let mut areas: Vec<_> = map
        .crosswalks_near(here, radius)
        .filter(|area| area.meets_box(&square))
        .collect();
    areas.sort_by(|a, b| a.distance_to(here).total_cmp(&b.distance_to(here)));
    let closed = areas.into_iter().map(|area| {
        let ring: Vec<Point> = area
            .ring()
            .iter()
            .chain(area.ring().first())
            .copied()
            .collect();
        (points(&ring), None)
    });
    let blocks = connected(&scene.route.roadblocks, &map.roadblocks_near(here, radius));
    let mut route: Vec<&Lane> = blocks
        .iter()
        .flat_map(|&block| map[block].lanes.iter().map(|&id| &map[id]))
        .collect();
    route.sort_by(|a, b| {
        a.polygon
            .distance_to(here)
            .total_cmp(&b.polygon.distance_to(here))
    });
    let route = route
        .into_iter()
        .map(|lane| (points(lane.centerline.vertices()), None));
    [
        nearest(scene, lanes.iter().map(lit).collect(), LANES),
        nearest(scene, closed.collect(), CROSSWALKS),
        nearest(scene, route.collect(), ROUTE),
    ]
}

/// The part of the route in the square, up to its first gap.
fn connected(route: &[RoadblockId], near: &[RoadblockId]) -> Vec<RoadblockId> {
    let ahead = route.iter().skip_while(|block| !near.contains(block));
    ahead
        .take_while(|block| near.contains(block))
        .copied()
        .collect()
}

/// Rows of the lines whose nearest vertex is nearest, resampled; with the light where lines have
/// one.
fn nearest(
    scene: &SceneView<'_>,
    lines: Vec<(Vec<Single>, Option<[f32; 4]>)>,
    [count, points]: [usize; 2],
) -> Vec<f32> {
    let frame = rounded(scene.ego.rear_axle);
    let here = [frame.x as f32, frame.y as f32];
    let distance = |line: &[Single]| {
        line.iter()
            .map(|[x, y]| (x - here[0]).hypot(y - here[1]))
            .fold(f32::INFINITY, f32::min)
    };
    let mut lines: Vec<(f32, Vec<Single>, Option<[f32; 4]>)> = lines
        .into_iter()
        .map(|(line, light)| (distance(&line), line, light))
        .collect();
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    let columns = if count == LANES[0] { LANE } else { LINE };
    let mut rows = Vec::with_capacity(count * points * columns);
    for (_, line, light) in lines.iter().take(count) {
        let local =
            resampled(line, points).map(|[x, y]| frame.to_local(Point::new(x.into(), y.into())));
        let local: Vec<[f32; 2]> = local
            .map(|place| [place.x as f32, place.y as f32])
            .collect();
        for i in 0..points {
            // The last point has none after it, so it repeats the direction before.
            let from = i.min(points - 2);
            let along = [
                local[from + 1][0] - local[from][0],
                local[from + 1][1] - local[from][1],
            ];
            rows.extend([local[i][0], local[i][1], along[1].atan2(along[0])]);
            rows.extend(light.iter().flatten());
        }
    }
    rows.resize(count * points * columns, 0.0);
    rows
}

/// Points of a line by the numbers of its vertices, with the rounding of PyTorch's interpolation on
/// a CPU.
fn resampled(line: &[Single], points: usize) -> impl Iterator<Item = Single> {
    let scale = (line.len() - 1) as f32 / (points - 1) as f32;
    (0..points).map(move |i| {
        let at = scale * i as f32;
        let before = (at as usize).min(line.len() - 1);
        let after = (before + 1).min(line.len() - 1);
        let share = at - before as f32;
        std::array::from_fn(|axis| {
            (1.0 - share).mul_add(line[before][axis], share * line[after][axis])
        })
    })
}

/// Green, yellow, red, unknown.
fn light(status: Option<SignalStatus>) -> [f32; 4] {
    let place = match status {
        Some(SignalStatus::Green) => 0,
        Some(SignalStatus::Yellow) => 1,
        Some(SignalStatus::Red) => 2,
        Some(SignalStatus::Unknown) | None => 3,
    };
    std::array::from_fn(|i| if i == place { 1.0 } else { 0.0 })
}
