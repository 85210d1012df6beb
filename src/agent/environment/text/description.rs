//! What the texts say, as data.

use crate::environment::lane_graph::{
    AgentName, CenterlineName, Connection, GraphAgent, Heading, LaneGraph, NodePlace, Turn,
};
use planagent_world::{PACIFICA, SignalStatus};

/// Larger numbers are written as this one: meters and meters per second beyond it make no
/// difference to the next seconds.
pub const MAX_NUMBER: u8 = 60;

/// A traffic light ahead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LightDescription {
    pub status: SignalStatus,
    /// Whole meters from the ego's front bumper to the stop line.
    pub distance: u8,
}

/// An agent or obstacle on a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AgentDescription {
    /// Its name; planner code uses the same.
    pub name: AgentName,
    /// Whole meters from bumper to bumper along the lane.
    pub distance: u8,
    /// Speed in whole m/s.
    pub speed: u8,
    pub heading: Heading,
}

/// A node that exists.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NodeDescription {
    /// Whether its lane goes another way there than the ego's.
    pub apart: bool,
    /// Who is on it, in the order of the graph: ahead nearest first, then behind nearest first.
    pub agents: Vec<AgentDescription>,
}

/// The path past what blocks the ego's lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OncomingDescription {
    /// From the ego's front bumper to where the blocked part of its lane begins, and to where it
    /// ends, whole meters.
    pub blocked: (u8, u8),
    /// Distance and speed of the next vehicle or bicycle on the oncoming lane, whole meters and
    /// m/s.
    pub next: Option<(u8, u8)>,
}

/// The path to the goal's lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GoalDescription {
    /// Lane changes to it, positive to the left; 0 on it.
    pub changes: i8,
    /// Whole meters to the goal along the lane.
    pub distance: u16,
}

/// The facts that scene text states.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// Speed of the ego, whole m/s.
    pub speed: u8,
    /// Speed limit, whole m/s.
    pub limit: Option<u8>,
    /// What the limit may be where it is unknown, whole m/s.
    pub limit_estimate: Option<u8>,
    /// The next light on the way of each lane, in order of [`CenterlineName::ALL`]; none on a lane
    /// without nodes.
    pub lights: [Option<LightDescription>; 3],
    /// Which way the route goes at the next intersection.
    pub turn: Turn,
    /// The nodes in order of [`NodePlace::ALL`]; `None` where there is none. The ego's own always
    /// exists.
    pub nodes: [Option<NodeDescription>; 9],
    /// How many agents on the nodes are not named; 0 unless reduced.
    pub rest: u8,
    /// The path over the oncoming lane, where there is one.
    pub oncoming: Option<OncomingDescription>,
    /// The path to the goal's lane, where there is a goal.
    pub goal: Option<GoalDescription>,
}

impl Description {
    pub fn from_graph(graph: &LaneGraph) -> Self {
        let ego_lane = graph.ego_lane();
        let lights = std::array::from_fn(|i| {
            let name = CenterlineName::ALL[i];
            let light = graph.centerline(name)?.light?;
            // The text names centerlines by their nodes, so a light without one would belong to
            // nothing.
            let has_nodes = graph
                .nodes
                .iter()
                .any(|node| node.place.centerline() == name);
            has_nodes.then(|| LightDescription {
                status: light.status,
                distance: whole(light.distance),
            })
        });
        let nodes = std::array::from_fn(|i| {
            let node = graph.node(NodePlace::ALL[i])?;
            let agents = graph.agents_on(node.place).map(describe).collect();
            Some(NodeDescription {
                apart: node.connection == Connection::Apart,
                agents,
            })
        });
        Self {
            speed: whole(graph.ego_speed),
            limit: ego_lane.speed_limit.map(whole),
            limit_estimate: ego_lane
                .speed_limit
                .is_none()
                .then(|| whole(graph.limit_estimate)),
            lights,
            turn: ego_lane.turn,
            nodes,
            rest: 0,
            oncoming: graph.oncoming.as_ref().map(|lane| {
                let front = ego_lane.ego_s + PACIFICA.length() / 2.0;
                let blocked = (
                    whole(lane.blocked.from_s - front),
                    whole(lane.blocked.to_s - front),
                );
                OncomingDescription {
                    blocked,
                    next: lane.next.map(|(gap, speed)| (whole(gap), whole(speed))),
                }
            }),
            goal: graph.goal.map(|goal| GoalDescription {
                changes: goal.changes as i8,
                distance: goal.distance.round() as u16,
            }),
        }
    }

    pub fn node(&self, place: NodePlace) -> Option<&NodeDescription> {
        self.nodes[place as usize].as_ref()
    }

    /// The next light on the way of a lane.
    pub fn light(&self, centerline: CenterlineName) -> Option<LightDescription> {
        self.lights.get(centerline as usize).copied().flatten()
    }

    /// What the brief text says: of each node the nearest agent, and the number of the others.
    pub fn nearest(&self) -> Self {
        let mut rest = usize::from(self.rest);
        let nodes = std::array::from_fn(|i| {
            let NodeDescription { apart, agents } = self.nodes[i].as_ref()?;
            let nearest = agents.iter().copied().min_by_key(|agent| agent.distance);
            rest += agents.len() - usize::from(nearest.is_some());
            Some(NodeDescription {
                apart: *apart,
                agents: nearest.into_iter().collect(),
            })
        });
        Self {
            nodes,
            rest: u8::try_from(rest).unwrap_or(MAX_NUMBER).min(MAX_NUMBER),
            ..*self
        }
    }

    /// What the compact text says: the nearest agents, without the speed of one that does not move
    /// along the lane. It has neither what lies apart nor the lights of the lanes beside.
    pub fn reduced(&self) -> Self {
        Self {
            limit_estimate: None,
            oncoming: None,
            goal: None,
            ..self.reduced_with_estimate()
        }
    }

    /// What the second compact text says: the same, what an unknown limit may be, and the way to
    /// the goal's lane.
    pub fn reduced_with_estimate(&self) -> Self {
        let nearest = self.nearest();
        let nodes = nearest.nodes.map(|node| {
            let agents = node?.agents.into_iter().map(|agent| match agent.heading {
                Heading::Along => agent,
                Heading::Crossing | Heading::Oncoming => AgentDescription { speed: 0, ..agent },
            });
            Some(NodeDescription {
                apart: false,
                agents: agents.collect(),
            })
        });
        let near = |goal: GoalDescription| GoalDescription {
            distance: goal.distance.min(MAX_NUMBER.into()),
            ..goal
        };
        let goal = self.goal.map(near);
        Self {
            lights: [self.lights[0], None, None],
            nodes,
            rest: nearest.rest,
            goal,
            ..*self
        }
    }
}

fn describe(agent: &GraphAgent) -> AgentDescription {
    AgentDescription {
        name: agent.name,
        distance: whole(agent.gap),
        speed: whole(agent.speed),
        heading: agent.heading,
    }
}

/// Rounded to a whole number between 0 and [`MAX_NUMBER`].
fn whole(value: f64) -> u8 {
    value.round().clamp(0.0, f64::from(MAX_NUMBER)) as u8
}
