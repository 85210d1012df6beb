//! Building the graph: the lane under the ego, the lanes beside it, the nodes, the agents, their
//! names.

use super::ego_lane::ego_lane;
use super::lane_relation::{LaneRelation, Window};
use super::{
    AgentClass, AgentName, Centerline, CenterlineName, Connection, GoalLane, GraphAgent, LaneGraph,
    LaneGraphError, LaneNode, MAX_NODE_LENGTH, MIN_NODE_LENGTH, NodePlace,
};
use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneId, LaneMap, PACIFICA, SceneView, TrackedObject};
use std::collections::BTreeMap;

/// Lines no further apart than this, meters, and no more turned than [`PARALLEL_TURN`] run side by
/// side.
const BESIDE: f64 = 5.5;
/// See [`BESIDE`], radians (20 degrees).
const PARALLEL_TURN: f64 = 0.35;
/// Lines nearer than this have become one, meters.
const MERGED: f64 = 1.0;

pub(super) fn build(scene: &SceneView<'_>, node_length: f64) -> Result<LaneGraph, LaneGraphError> {
    if !(MIN_NODE_LENGTH..=MAX_NODE_LENGTH).contains(&node_length) {
        return Err(LaneGraphError::NodeLength(node_length));
    }
    let center = scene.ego.center();
    if !center.is_finite() {
        return Err(LaneGraphError::NotFinite {
            x: center.x,
            y: center.y,
            heading: center.heading,
        });
    }
    let lane = ego_lane(scene).ok_or(LaneGraphError::OffRoad {
        x: center.x,
        y: center.y,
    })?;
    let mut centerlines = centerlines(scene, lane, 2.0 * node_length);
    let nodes = nodes(scene.map, &centerlines, node_length);
    // Names need all objects of all nodes, and lead agents need the names.
    let on_nodes = objects_on_nodes(scene.objects, &centerlines, &nodes, node_length);
    let agents = name(&on_nodes);
    for (place, centerline) in centerlines.iter_mut().enumerate() {
        centerline.lead_agent = lead_agent(&on_nodes, &agents, place);
    }
    let ego_speed = scene.ego.speed();
    let limit_estimate = super::limit::estimate(scene.map, &centerlines[0], ego_speed, &agents);
    let blocked = super::standing::blocked_stretch(scene, &centerlines[0]);
    let goal = GoalLane::from_lane(scene, lane).filter(GoalLane::is_ahead);
    Ok(LaneGraph {
        node_length,
        ego_speed,
        nodes,
        centerlines,
        agents,
        limit_estimate,
        blocked,
        oncoming: None,
        goal,
    })
}

fn centerlines(scene: &SceneView<'_>, lane: LaneId, behind: f64) -> Vec<Centerline> {
    let s = scene.map[lane]
        .centerline
        .project(scene.ego.center().position())
        .s;
    let beside = [
        (CenterlineName::EgoLane, Some(lane)),
        (CenterlineName::LeftLane, scene.map[lane].left_at(s)),
        (CenterlineName::RightLane, scene.map[lane].right_at(s)),
    ];
    beside
        .into_iter()
        .filter_map(|(name, lane)| Some(Centerline::through(scene, name, lane?, behind)))
        .collect()
}

/// Where the three nodes of a centerline begin, from the ego's center, meters: beside, ahead,
/// behind.
fn node_starts(node_length: f64) -> [f64; 3] {
    let rear = -PACIFICA.length() / 2.0;
    [rear, rear + node_length, rear - node_length]
}

fn nodes(map: &LaneMap, centerlines: &[Centerline], node_length: f64) -> Vec<LaneNode> {
    let mut nodes: Vec<LaneNode> = vec![];
    for centerline in centerlines {
        let length = centerline.path.centerline.length();
        let places = NodePlace::on(centerline.name).into_iter().flatten();
        for (place, start) in places.zip(node_starts(node_length)) {
            let from_s = centerline.ego_s + start;
            let middle = from_s + node_length / 2.0;
            // The node under the ego exists because the ego does.
            let exists = place == NodePlace::Ego || (0.0..=length).contains(&middle);
            let middle = middle.clamp(0.0, length);
            let Some(connection) = connection(map, place, centerline, &centerlines[0], middle)
            else {
                continue;
            };
            if exists {
                let (from_s, to_s) = (from_s.max(0.0), (from_s + node_length).min(length));
                nodes.push(LaneNode {
                    place,
                    lane: centerline.path.lane_at(middle),
                    connection,
                    from_s,
                    to_s,
                });
            }
        }
    }
    nodes
}

/// The connection of a node with its middle at `middle` with the ego's lane; `None` where its lane
/// has merged into it.
fn connection(
    map: &LaneMap,
    place: NodePlace,
    own: &Centerline,
    ego: &Centerline,
    middle: f64,
) -> Option<Connection> {
    match place {
        NodePlace::Ego => return Some(Connection::Itself),
        NodePlace::Front => return Some(Connection::Successor),
        NodePlace::Back => return Some(Connection::Predecessor),
        _ => {}
    }
    let ego_middle = ego.ego_s + middle - own.ego_s;
    let (lane, ego_lane) = (own.path.lane_at(middle), ego.path.lane_at(ego_middle));
    let (here, there) = (
        own.path.centerline.pose_at(middle),
        ego.path.centerline.pose_at(ego_middle),
    );
    let apart = ego.path.centerline.distance_to(here.position());
    if lane == ego_lane || apart < MERGED {
        return None;
    }
    // Maps list neighbors along whole lanes; lanes of a junction run side by side unlisted.
    let listed = map[ego_lane]
        .left
        .iter()
        .chain(&map[ego_lane].right)
        .any(|neighbor| neighbor.lane == lane);
    let parallel =
        apart <= BESIDE && wrap_angle(here.heading - there.heading).abs() <= PARALLEL_TURN;
    Some(if listed || parallel {
        Connection::Neighbor
    } else {
        Connection::Apart
    })
}

/// An object on a node, with its relation to every centerline.
struct NodeObject<'a> {
    object: &'a TrackedObject,
    /// In the order of the centerlines.
    relations: Vec<Option<LaneRelation>>,
    /// The centerline on whose node it is.
    home: usize,
    place: NodePlace,
}

impl NodeObject<'_> {
    fn at_home(&self) -> Option<&LaneRelation> {
        self.relations[self.home].as_ref()
    }
}

/// The objects on the nodes, in the order in which they are numbered.
fn objects_on_nodes<'a>(
    objects: &'a [TrackedObject],
    centerlines: &[Centerline],
    nodes: &[LaneNode],
    node_length: f64,
) -> Vec<NodeObject<'a>> {
    let [_, front, back] = node_starts(node_length);
    // A window a centerline and not an object: cutting out the stretch is the slow part.
    let windows: Vec<Option<Window>> = centerlines
        .iter()
        .map(|centerline| Window::new(centerline, -back, front + node_length))
        .collect();
    let mut on_nodes: Vec<NodeObject<'a>> = objects
        .iter()
        .filter_map(|object| {
            let relations: Vec<Option<LaneRelation>> = windows
                .iter()
                .map(|window| window.as_ref().and_then(|window| window.project(object)))
                .collect();
            let home = home(&relations)?;
            let place = place(
                centerlines[home].name,
                relations[home].as_ref()?.offset,
                node_length,
            )?;
            nodes
                .iter()
                .any(|node| node.place == place)
                .then_some(NodeObject {
                    object,
                    relations,
                    home,
                    place,
                })
        })
        .collect();
    on_nodes.sort_by(|a, b| {
        order(a)
            .partial_cmp(&order(b))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    on_nodes
}

/// The centerline that an object counts for: the ego's if it blocks that, else the nearest that it
/// is on.
fn home(relations: &[Option<LaneRelation>]) -> Option<usize> {
    let on = |relation: &LaneRelation| relation.on_lane || relation.blocks_path;
    if relations
        .first()
        .is_some_and(|ego| ego.is_some_and(|ego| ego.blocks_path))
    {
        return Some(0);
    }
    let near = relations
        .iter()
        .enumerate()
        .filter_map(|(i, s)| s.as_ref().filter(|s| on(s)).map(|s| (i, s.lateral)));
    near.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
        .map(|(i, _)| i)
}

fn place(centerline: CenterlineName, offset: f64, node_length: f64) -> Option<NodePlace> {
    let [beside, ahead, behind] = NodePlace::on(centerline)?;
    let [start, end, _] = node_starts(node_length);
    Some(if offset < start {
        behind
    } else if offset < end {
        beside
    } else {
        ahead
    })
}

/// By centerline; those ahead before those behind; the nearest first; by track where all is equal.
fn order(placed: &NodeObject<'_>) -> (usize, bool, f64, u32) {
    let offset = placed.at_home().expect("an object is on its home").offset;
    (
        placed.home,
        offset < 0.0,
        offset.abs(),
        placed.object.token.0,
    )
}

fn name(on_nodes: &[NodeObject<'_>]) -> Vec<GraphAgent> {
    let mut numbers: BTreeMap<AgentClass, u16> = BTreeMap::new();
    on_nodes
        .iter()
        .filter_map(|found| {
            let at = found.at_home()?;
            let class = AgentClass::from(found.object.kind);
            let number = numbers
                .entry(class)
                .and_modify(|n| *n = n.saturating_add(1))
                .or_insert(1);
            Some(GraphAgent {
                name: AgentName {
                    class,
                    number: *number,
                },
                token: found.object.token,
                kind: found.object.kind,
                place: found.place,
                offset: at.offset,
                gap: at.gap,
                lateral: at.lateral,
                speed: found.object.speed(),
                along_speed: at.along_speed,
                heading: at.heading,
            })
        })
        .collect()
}

/// The nearest agent ahead of the ego that blocks a centerline.
fn lead_agent(
    on_nodes: &[NodeObject<'_>],
    agents: &[GraphAgent],
    centerline: usize,
) -> Option<AgentName> {
    on_nodes
        .iter()
        .filter_map(|found| {
            let relation =
                found.relations[centerline].filter(|s| s.blocks_path && s.offset > 0.0)?;
            Some((found.object.token, relation.gap, relation.offset))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1).then(a.2.total_cmp(&b.2)))
        .and_then(|(token, _, _)| {
            agents
                .iter()
                .find(|agent| agent.token == token)
                .map(|agent| agent.name)
        })
}
