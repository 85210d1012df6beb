//! The nodes that a driver visited (`pgp_feature_builder.py` `get_visited_edges`), for training.

use super::lane_graph::LaneNodes;
use super::network::TRAVERSAL;
use planagent_world::geometry::wrap_angle;

/// A pose belongs to nodes at most this far away, meters, and turned by at most this much, radians.
const DISTANCE: f64 = 2.0;
const TURN: f64 = std::f64::consts::FRAC_PI_8;
/// A driver leaves a node at this distance, meters.
const LEFT: f64 = 1.5;
/// Beyond this rectangle nothing is assigned, meters: ten more than that of the graph.
const FORWARD: [f64; 2] = [-30.0, 90.0];
const SIDE: f64 = 60.0;

/// What a driver visited.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Visited {
    /// The nodes in order, then the number of nodes and more for the goal.
    pub nodes: [usize; TRAVERSAL],
    /// Edges of the graph that were taken.
    pub edges: Vec<(usize, usize)>,
    /// The node where the driver ended.
    pub goal: usize,
}

/// The nodes along poses relative to the rear axle, half a second apart.
pub fn visited(graph: &LaneNodes, poses: &[[f64; 3]]) -> Visited {
    let mut node = assigned(
        graph,
        *poses.first().expect("a driver has one pose at least"),
    );
    let mut nodes = vec![node];
    let mut edges = Vec::new();
    for &pose in poses.iter().skip(1) {
        let [x, y, _] = pose;
        let inside = (FORWARD[0]..=FORWARD[1]).contains(&x) && y.abs() <= SIDE;
        // Nodes overlap. A driver who is still close to one has not left it for another.
        if !inside || nearest(graph, node, pose).0 < LEFT {
            continue;
        }
        let next = assigned(graph, pose);
        if next != node {
            let known = &graph.nodes[node];
            if known.successors.contains(&next) || known.proximal.contains(&next) {
                edges.push((node, next));
            }
            node = next;
            if nodes.len() < TRAVERSAL {
                nodes.push(node);
            }
        }
    }
    let goal = graph.nodes.len() + node;
    Visited {
        nodes: std::array::from_fn(|i| nodes.get(i).copied().unwrap_or(goal)),
        edges,
        goal: node,
    }
}

/// Distance of a node's nearest pose, meters, and its turn, radians.
fn nearest(graph: &LaneNodes, node: usize, [x, y, heading]: [f64; 3]) -> (f64, f64) {
    let poses = graph.nodes[node].poses.iter();
    let poses = poses.map(|pose| {
        (
            (pose[0] - x).hypot(pose[1] - y),
            wrap_angle(pose[2] - heading).abs(),
        )
    });
    poses
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((f64::INFINITY, 0.0))
}

/// The nearest node of those that are near, in the pose's direction and on the route; else without
/// the first condition; else of all.
fn assigned(graph: &LaneNodes, pose: [f64; 3]) -> usize {
    let places: Vec<(f64, f64)> = (0..graph.nodes.len())
        .map(|node| nearest(graph, node, pose))
        .collect();
    let along = |node: &usize| places[*node].1 <= TURN && graph.nodes[*node].on_route;
    let least = |of: &mut dyn Iterator<Item = usize>| {
        of.min_by(|&a, &b| places[a].0.total_cmp(&places[b].0))
    };
    let all = 0..graph.nodes.len();
    least(
        &mut all
            .clone()
            .filter(along)
            .filter(|&node| places[node].0 <= DISTANCE),
    )
    .or_else(|| least(&mut all.clone().filter(along)))
    .or_else(|| least(&mut all.clone()))
    .expect("a graph has one node at least")
}

#[cfg(test)]
mod tests {
    use super::super::lane_graph::Node;
    use super::*;

    fn straight(from: f64, successors: Vec<usize>, y: f64) -> Node {
        let poses = (0..20)
            .map(|i| [from + f64::from(i), y, 0.0, 0.0, 0.0, 0.0, 0.0])
            .collect();
        Node {
            lane: None,
            poses,
            successors,
            proximal: Vec::new(),
            on_route: true,
            red: false,
        }
    }

    #[test]
    fn nodes_follow_the_driver_and_end_at_the_goal() {
        let nodes = vec![
            straight(0.0, vec![1], 0.0),
            straight(20.0, vec![2], 0.0),
            straight(40.0, vec![], 0.0),
        ];
        let graph = LaneNodes {
            nodes,
            initial: vec![0],
        };
        let poses: Vec<[f64; 3]> = (1..=16).map(|i| [3.0 * f64::from(i), 0.2, 0.0]).collect();
        let found = visited(&graph, &poses);
        assert_eq!(found.nodes[..4], [0, 1, 2, 5]);
        assert_eq!((found.edges, found.goal), (vec![(0, 1), (1, 2)], 2));
    }

    #[test]
    fn a_jump_between_unjoined_nodes_takes_no_edge() {
        let graph = LaneNodes {
            nodes: vec![straight(0.0, vec![], 0.0), straight(0.0, vec![], 4.0)],
            initial: vec![0],
        };
        let found = visited(&graph, &[[1.0, 0.0, 0.0], [3.0, 3.9, 0.0]]);
        assert_eq!((found.nodes[1], found.edges, found.goal), (1, vec![], 1));
    }
}
