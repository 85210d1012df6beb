//! Samples of GC-PGP. Agents and nodes of all samples are concatenated; `agents` and `polygons`
//! count those of each.

use super::tensors::Columns;
use super::{Moment, futures};
use planagent_learned::gc_pgp::{GcPgpFeatures, LaneNodes, visited};

/// Edges of a node that are kept, the goal not among them: the most that two nodes beside another
/// and their ends have.
const EDGES: usize = 16;
/// Poses of a node and columns of a pose, without the red flag.
const POSES: usize = 20;
const POSE: usize = 7;
/// No edge.
const NONE: f32 = -1.0;

/// Features, the target (16, 3), and the nodes and edges that the driver visited. `None` where a
/// node has too many edges.
pub(super) fn sample(moment: &Moment<'_>) -> Option<Columns> {
    let features = GcPgpFeatures::from_scene(&moment.scene).ok()?;
    let GcPgpFeatures { ego, agents, graph } = &features;
    let target = futures::half_seconds(moment);
    let poses: Vec<[f64; 3]> = target
        .as_chunks()
        .0
        .iter()
        .map(|pose: &[f32; 3]| pose.map(f64::from))
        .collect();
    let visited = visited(graph, &poses);
    let (mut nodes, mut lengths) = (Vec::new(), Vec::new());
    let (mut successors, mut kinds, mut used) = (Vec::new(), Vec::new(), Vec::new());
    for (i, node) in graph.nodes.iter().enumerate() {
        let mut rows = [[0f32; POSE]; POSES];
        for (row, pose) in rows.iter_mut().zip(&node.poses) {
            *row = pose.map(|value| value as f32);
        }
        nodes.extend_from_slice(rows.as_flattened());
        lengths.push(u8::try_from(node.poses.len()).ok()?);
        let edges = node
            .successors
            .iter()
            .map(|&to| (to, 1u8))
            .chain(node.proximal.iter().map(|&to| (to, 2)));
        let edges: Vec<(usize, u8)> = edges.collect();
        // The table has a fixed width, and a cut node would teach a graph that planning never sees.
        if edges.len() > EDGES {
            return None;
        }
        for edge in 0..EDGES {
            let (to, kind) = edges
                .get(edge)
                .map_or((NONE, 0), |&(to, kind)| (to as f32, kind));
            successors.push(to);
            kinds.push(kind);
            used.push(u8::from(
                edges
                    .get(edge)
                    .is_some_and(|&(to, _)| visited.edges.contains(&(i, to))),
            ));
        }
        used.push(u8::from(visited.goal == i));
    }
    let flags = |read: fn(&LaneNodes, usize) -> bool| {
        (0..graph.nodes.len())
            .map(|i| u8::from(read(graph, i)))
            .collect()
    };
    Some(
        Columns::default()
            .with("target", &[target.len() / 3, 3], target)
            .with("speed", &[], vec![moment.scene.ego.velocity.x as f32])
            .with("ego", &[ego.len(), 5], ego.as_flattened().to_vec())
            .with(
                "traversal",
                &[visited.nodes.len()],
                visited.nodes.iter().map(|&node| node as f32).collect(),
            )
            .with_small("agents", &[], vec![u8::try_from(agents.len()).ok()?])
            .with("polygons", &[], vec![graph.nodes.len() as f32])
            .with(
                "agent.step",
                &[ego.len(), 5],
                agents
                    .iter()
                    .flat_map(|one| one.steps.as_flattened())
                    .copied()
                    .collect(),
            )
            .with_small(
                "agent.seen",
                &[ego.len()],
                agents
                    .iter()
                    .flat_map(|one| one.seen)
                    .map(u8::from)
                    .collect(),
            )
            .with("map.pose", &[POSES, POSE], nodes)
            .with_small("map.length", &[], lengths)
            .with_small("map.red", &[], flags(|graph, i| graph.nodes[i].red))
            .with_small(
                "map.initial",
                &[],
                flags(|graph, i| graph.initial.contains(&i)),
            )
            .with("map.successor", &[EDGES], successors)
            .with_small("map.edge", &[EDGES], kinds)
            .with_small("map.visited", &[EDGES + 1], used),
    )
}
