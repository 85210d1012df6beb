//! GC-PGP's lane graph (`tuplan_garage` `pgp_graph_map_feature_builder.py`).

use planagent_score::pdm::corrected_route;
use planagent_world::geometry::{OrientedBox, Point, Polygon, Pose, unwrap_angles, wrap_angle};
use planagent_world::{Lane, LaneId, LaneKind, SceneView, SignalStatus};
use std::collections::BTreeMap;

/// Largest number of poses of a node, and the distance between two, meters.
pub(super) const POSES: usize = 20;
const RESOLUTION: f64 = 1.0;
/// Half side of the square in which lanes and areas are read, meters.
const RADIUS: f64 = 80.0;
/// A node has a pose in this rectangle around the rear axle, meters.
const FORWARD: [f64; 2] = [-20.0, 80.0];
const SIDE: f64 = 50.0;
/// Proximal nodes: largest difference of the mean headings, radians, and distances of centers and
/// of poses, meters.
const MAX_TURN: f64 = 0.785;
const MAX_CENTERS: f64 = 20.0;
const MAX_POSES: f64 = 4.0;
/// The ego stands on nodes at most this far away, meters, and turned by at most this much, radians.
const START_DISTANCE: f64 = 3.0;
const START_TURN: f64 = std::f64::consts::FRAC_PI_4;

/// A piece of a lane.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Its lane; `None` for the one node of an empty map.
    pub lane: Option<LaneId>,
    /// x, y, heading relative to the rear axle. Then 1 on a stop line, on a crosswalk, in a car
    /// park, and at the end of the graph.
    pub poses: Vec<[f64; 7]>,
    /// Nodes that follow.
    pub successors: Vec<usize>,
    /// Nodes beside.
    pub proximal: Vec<usize>,
    /// Whether it is on the corrected route.
    pub on_route: bool,
    /// Whether its light is red.
    pub red: bool,
}

/// The lane graph around the ego.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneNodes {
    /// Its nodes; at least one.
    pub nodes: Vec<Node>,
    /// Nodes on which the ego may stand, equally likely.
    pub initial: Vec<usize>,
}

impl LaneNodes {
    /// Of a scene.
    pub fn from_scene(scene: &SceneView<'_>) -> Self {
        let (map, here) = (scene.map, scene.ego.rear_axle);
        let route = corrected_route(map, &scene.route.roadblocks, scene.ego.center());
        let mut lanes: Vec<&Lane> = map
            .lanes_near(here.position(), RADIUS)
            .into_iter()
            .map(|lane| &map[lane])
            .collect();
        lanes.sort_by_key(|lane| lane.kind == LaneKind::Connector);
        let areas = areas(scene);
        let mut nodes: Vec<Node> = Vec::new();
        for lane in lanes {
            let red =
                lane.has_traffic_lights && scene.lights.status(lane.id) == Some(SignalStatus::Red);
            let on_route = route.contains(&lane.roadblock);
            let poses: Vec<[f64; 7]> = sampled(lane)
                .iter()
                .map(|&pose| described(here, pose, &areas))
                .collect();
            let pieces = poses.len().div_ceil(POSES).max(1);
            for piece in poses
                .chunks(poses.len().div_ceil(pieces).max(1))
                .filter(|piece| is_near(piece))
            {
                let (successors, proximal) = Default::default();
                nodes.push(Node {
                    lane: Some(lane.id),
                    poses: piece.to_vec(),
                    successors,
                    proximal,
                    on_route,
                    red,
                });
            }
        }
        join(scene, &mut nodes);
        // The network cannot run without a node; far from all lanes it gets one of zeros.
        if nodes.is_empty() {
            let (successors, proximal) = Default::default();
            let poses = vec![[0.0; 7]];
            nodes.push(Node {
                lane: None,
                poses,
                successors,
                proximal,
                on_route: false,
                red: false,
            });
        }
        let initial = initial(&nodes);
        Self { nodes, initial }
    }

    /// The most edges of a node, at least one.
    pub(super) fn edges(&self) -> usize {
        self.nodes
            .iter()
            .map(|node| node.successors.len() + node.proximal.len())
            .max()
            .unwrap_or_default()
            .max(1)
    }
}

/// Stop lines, crosswalks and car parks nearby.
fn areas<'a>(scene: &SceneView<'a>) -> [Vec<&'a Polygon>; 3] {
    let (map, here) = (scene.map, scene.ego.rear_axle.position());
    let square = OrientedBox::new(Pose::at(here, 0.0), 2.0 * RADIUS, 2.0 * RADIUS);
    let near = |area: &&Polygon| area.meets_box(&square);
    [
        map.stop_lines()
            .iter()
            .map(|line| &line.polygon)
            .filter(near)
            .collect(),
        map.crosswalks_near(here, RADIUS).filter(near).collect(),
        map.carparks().iter().filter(near).collect(),
    ]
}

/// Poses of a centerline every meter, and its last one where that is far from the one before.
/// Headings go on without a jump.
fn sampled(lane: &Lane) -> Vec<Pose> {
    let (lengths, poses) = (
        lane.centerline.arc_lengths(),
        lane.centerline.vertex_poses(),
    );
    let headings = unwrap_angles(&poses.iter().map(|pose| pose.heading).collect::<Vec<_>>());
    let vertex = |i: usize| Pose {
        heading: headings[i],
        ..poses[i]
    };
    let last = poses.len() - 1;
    let count = (lane.centerline.length() / RESOLUTION) as usize + 1;
    let at = |i: usize| {
        let s = i as f64 * RESOLUTION;
        let after = lengths.partition_point(|&length| length < s).clamp(1, last);
        let (a, b) = (vertex(after - 1), vertex(after));
        let share =
            (s.min(lengths[after]) - lengths[after - 1]) / (lengths[after] - lengths[after - 1]);
        let between = |a: f64, b: f64| a + (b - a) * share;
        Pose::new(
            between(a.x, b.x),
            between(a.y, b.y),
            between(a.heading, b.heading),
        )
    };
    let mut sampled: Vec<Pose> = (0..count).map(at).collect();
    let end = vertex(last);
    // The heading counts like a coordinate, as in upstream's norm.
    let far = sampled.last().is_none_or(|pose| {
        let apart = [pose.x - end.x, pose.y - end.y, pose.heading - end.heading];
        apart.iter().map(|part| part * part).sum::<f64>().sqrt() > RESOLUTION / 2.0
    });
    sampled.extend(far.then_some(end));
    sampled
}

fn described(here: Pose, pose: Pose, areas: &[Vec<&Polygon>; 3]) -> [f64; 7] {
    let place = here.to_local(pose.position());
    let [stop, cross, park] = [0, 1, 2].map(|i| {
        if areas[i].iter().any(|area| area.contains(pose.position())) {
            1.0
        } else {
            0.0
        }
    });
    [
        place.x,
        place.y,
        wrap_angle(pose.heading - here.heading),
        stop,
        cross,
        park,
        0.0,
    ]
}

fn is_near(poses: &[[f64; 7]]) -> bool {
    poses
        .iter()
        .any(|&[x, y, ..]| (FORWARD[0]..=FORWARD[1]).contains(&x) && y.abs() <= SIDE)
}

/// Puts the edges in, and the flags at the ends.
fn join(scene: &SceneView<'_>, nodes: &mut [Node]) {
    let mut first: BTreeMap<LaneId, usize> = BTreeMap::new();
    for (i, node) in nodes.iter().enumerate() {
        if let Some(lane) = node.lane {
            first.entry(lane).or_insert(i);
        }
    }
    for i in 0..nodes.len() {
        let Some(lane) = nodes[i].lane else { continue };
        nodes[i].successors = if nodes.get(i + 1).is_some_and(|next| next.lane == Some(lane)) {
            vec![i + 1]
        } else {
            scene.map[lane]
                .outgoing
                .iter()
                .filter_map(|next| first.get(next).copied())
                .collect()
        };
    }
    // Edges between neighbors come last: a pair that already follows one another gets none.
    let middles: Vec<(Point, f64)> = nodes.iter().map(middle).collect();
    for a in 0..nodes.len() {
        for b in a + 1..nodes.len() {
            let ((center, heading), (other, other_heading)) = (middles[a], middles[b]);
            if wrap_angle(heading - other_heading).abs() <= MAX_TURN
                && (center - other).norm() <= MAX_CENTERS
                && !nodes[a].successors.contains(&b)
                && !nodes[b].successors.contains(&a)
                && nearest(&nodes[a], &nodes[b]) <= MAX_POSES
            {
                nodes[a].proximal.push(b);
                nodes[b].proximal.push(a);
            }
        }
    }
    for node in nodes {
        let end = if node.successors.is_empty() { 1.0 } else { 0.0 };
        node.poses.iter_mut().for_each(|pose| pose[6] = end);
    }
}

/// The mean place and the mean heading.
fn middle(node: &Node) -> (Point, f64) {
    let mean = |read: &dyn Fn(&[f64; 7]) -> f64| {
        node.poses.iter().map(read).sum::<f64>() / node.poses.len() as f64
    };
    let heading = mean(&|pose| pose[2].sin()).atan2(mean(&|pose| pose[2].cos()));
    (
        Point::new(mean(&|pose| pose[0]), mean(&|pose| pose[1])),
        heading,
    )
}

fn nearest(a: &Node, b: &Node) -> f64 {
    let pairs = a
        .poses
        .iter()
        .flat_map(|one| b.poses.iter().map(move |other| (one, other)));
    pairs
        .map(|(one, other)| (one[0] - other[0]).hypot(one[1] - other[1]))
        .fold(f64::INFINITY, f64::min)
}

/// The nodes under the ego; else the nearest on the route in its direction; else the nearest.
fn initial(nodes: &[Node]) -> Vec<usize> {
    let nearest = |node: &Node| {
        let poses = node
            .poses
            .iter()
            .map(|&[x, y, heading, ..]| (x.hypot(y), wrap_angle(heading).abs()));
        poses
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, 0.0))
    };
    let places: Vec<(f64, f64)> = nodes.iter().map(nearest).collect();
    let along: Vec<usize> = (0..nodes.len())
        .filter(|&i| places[i].1 <= START_TURN && nodes[i].on_route)
        .collect();
    let under: Vec<usize> = along
        .iter()
        .copied()
        .filter(|&i| places[i].0 <= START_DISTANCE)
        .collect();
    if !under.is_empty() {
        return under;
    }
    let least = |of: &[usize]| {
        of.iter()
            .copied()
            .min_by(|&a, &b| places[a].0.total_cmp(&places[b].0))
    };
    let all: Vec<usize> = (0..nodes.len()).collect();
    least(&along).or_else(|| least(&all)).into_iter().collect()
}
