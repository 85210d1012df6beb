//! The lane graph: the ego's lane and those beside it as nodes of equal length. It has the agents
//! on these nodes, and the centerlines that planner code may follow.
//!
//! **Centerlines.** `ego_lane`, and where there is a lane of the same direction beside the ego,
//! `left_lane` and `right_lane`. Each is a [`planagent_world::LanePath`] that prefers the route.
//! Where something that stands permanently blocks the ego's lane and a lane against traffic is
//! beside it, `oncoming_lane` leads past and back. It has no nodes.
//!
//! **Nodes.** All have the same length. They are cut so that a node begins at the ego's rear
//! bumper. The node under the ego reaches from there one node length ahead; `front` is the next
//! one, `back` the one before. The nodes of the lanes beside are cut at the same distances from the
//! point beside the ego. A node exists when its middle lies on the centerline, and does not when
//! the lane beside has merged into the ego's there.
//!
//! **Agents.** An agent or obstacle is on a centerline where its box meets the strip that the ego
//! would sweep (its half width and `SWEEP_MARGIN`). Pedestrians and cyclists also count where
//! they will be within [`CROSSING_SECONDS`] at their present velocity. An agent is also on the line
//! where its center lies within half a lane width of it (pedestrians: `KERB_MARGIN` more). On
//! several, it counts for the ego's lane if it blocks the path there, else for the nearest line.
//! Only agents on one of the nine nodes are part of the graph.
//!
//! **Goal.** Where the score asks for the lane of a goal, the graph counts the lane changes to it.
//!
//! **Distances** are along the lane from bumper to bumper (0: side by side).

mod agent;
mod build;
mod centerline;
mod ego_lane;
mod goal;
mod lane_relation;
mod limit;
mod node;
mod oncoming;
mod return_lane;
mod standing;

pub use agent::{AgentClass, AgentName, GraphAgent, Heading, UnknownAgent};
pub use centerline::{Centerline, CenterlineName, LightAhead, Turn};
pub(crate) use ego_lane::OFF_ROAD_REACH;
pub use goal::GoalLane;
pub use lane_relation::CROSSING_SECONDS;
pub(in crate::environment) use lane_relation::{LaneRelation, Window};
pub use node::{Connection, LaneNode, NodePlace};
pub(crate) use oncoming::ONCOMING_SIGHT;
pub use oncoming::{OncomingAgent, OncomingLane};
pub use return_lane::ReturnLane;
pub use standing::BlockedStretch;
pub(crate) use standing::{MAX_SHIFT, STANDING, swing};

use planagent_world::SceneView;
use planagent_world::geometry::Point;

/// Meters.
pub const DEFAULT_NODE_LENGTH: f64 = 20.0;

/// Why a scene has no lane graph.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LaneGraphError {
    #[error("the ego's pose has a NaN or infinite value: ({x}, {y}), heading {heading}")]
    NotFinite { x: f64, y: f64, heading: f64 },
    #[error("the ego at ({x:.1}, {y:.1}) is off the road: no lane within {OFF_ROAD_REACH} m")]
    OffRoad { x: f64, y: f64 },
    #[error("a node length must lie between {MIN_NODE_LENGTH} and {MAX_NODE_LENGTH} m, got {0}")]
    NodeLength(f64),
}

/// Shortest node, meters: the ego fits in.
pub const MIN_NODE_LENGTH: f64 = 6.0;
/// Longest node, meters.
pub const MAX_NODE_LENGTH: f64 = 100.0;

/// The lane graph of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneGraph {
    /// Length of every node, meters.
    pub node_length: f64,
    /// Speed of the ego, m/s.
    pub ego_speed: f64,
    /// The nodes that exist, in order of [`NodePlace::ALL`]; the first is the ego's.
    pub nodes: Vec<LaneNode>,
    /// The centerlines of the ego's direction, in order of [`CenterlineName::ALL`]; the first is
    /// the ego's.
    pub centerlines: Vec<Centerline>,
    /// The agents on the nodes by centerline; on each those ahead, nearest first, then those
    /// behind, nearest first. Names are numbered in this order.
    pub agents: Vec<GraphAgent>,
    /// What the speed limit may be where the map has none, m/s.
    pub limit_estimate: f64,
    /// Where something that stands permanently blocks the ego's lane; arc lengths on its
    /// centerline.
    pub blocked: Option<BlockedStretch>,
    /// The way past what blocks the ego's lane, where it was asked for and there is one
    /// ([`Self::with_oncoming_lane`]).
    pub oncoming: Option<OncomingLane>,
    /// The way to the goal's lane, where the route has a goal to reach, or else back to a lane that
    /// was left ([`Self::with_return_lane`]).
    pub goal: Option<GoalLane>,
}

/// A scene and the lane graph that was built of it.
#[derive(Debug, Clone, Copy)]
pub struct GraphedScene<'a> {
    pub scene: &'a SceneView<'a>,
    pub graph: &'a LaneGraph,
}

impl<'a> GraphedScene<'a> {
    /// A scene with its graph.
    pub fn new(scene: &'a SceneView<'a>, graph: &'a LaneGraph) -> Self {
        Self { scene, graph }
    }
}

impl LaneGraph {
    /// Builds the graph of a scene with nodes of `node_length` meters ([`DEFAULT_NODE_LENGTH`]
    /// unless there is a reason).
    pub fn build(scene: &SceneView<'_>, node_length: f64) -> Result<Self, LaneGraphError> {
        build::build(scene, node_length)
    }

    /// The same with the way past what blocks the ego's lane, where a lane against traffic is
    /// beside it. There is none past what may be a queue.
    #[must_use]
    pub fn with_oncoming_lane(self, scene: &SceneView<'_>) -> Self {
        let passable = self.blocked.filter(|blocked| !blocked.may_queue);
        let oncoming =
            passable.and_then(|blocked| OncomingLane::find(scene, self.ego_lane(), blocked));
        Self { oncoming, ..self }
    }

    /// The same with the way back to a lane that the ego left, where the route has no lane of a
    /// goal.
    #[must_use]
    pub(crate) fn with_return_lane(self, scene: &SceneView<'_>, to: &ReturnLane) -> Self {
        let goal = self.goal.or_else(|| to.as_goal(scene, &self));
        Self { goal, ..self }
    }

    /// Whether something blocks the ego's lane, or its lead agent stands. A person or a bicycle
    /// that stands is about to move.
    pub(crate) fn is_obstructed(&self) -> bool {
        let stands =
            |agent: &GraphAgent| agent.speed < standing::STANDING && !agent.kind.is_vulnerable();
        self.blocked.is_some() || self.lead_agent(CenterlineName::EgoLane).is_some_and(stands)
    }

    /// Whether a person or a bicycle is ahead in the ego's lane or beside it, who may come into it
    /// and stop there.
    pub(crate) fn has_person_near(&self, scene: &SceneView<'_>) -> bool {
        standing::has_person_near(scene, self.ego_lane())
    }

    /// Where an ego that stays in its lane stops before what blocks it: where it can still leave
    /// the lane. `None` where the lane is free, or nothing leads past.
    pub fn stop_point(&self) -> Option<Point> {
        let leads_past = self.centerlines.len() > 1 || self.oncoming.is_some();
        let blocked = self.blocked.filter(|_| leads_past)?;
        Some(
            self.ego_lane()
                .path
                .centerline
                .point_at(blocked.from_s - standing::PULL_OUT),
        )
    }

    /// The centerlines that a planner code may name.
    pub fn named(&self) -> impl Iterator<Item = &Centerline> {
        self.centerlines
            .iter()
            .chain(self.oncoming.as_ref().map(|oncoming| &oncoming.centerline))
    }

    pub fn node(&self, place: NodePlace) -> Option<&LaneNode> {
        self.nodes.iter().find(|node| node.place == place)
    }

    /// The centerline of this name, if it can be followed.
    pub fn centerline(&self, name: CenterlineName) -> Option<&Centerline> {
        self.named().find(|centerline| centerline.name == name)
    }

    /// The speed limit of the ego's lane, m/s: the map's, or where it has none the estimate that
    /// the texts give.
    /// Why: docs/decisions/137-limits-as-the-texts-give-them.md.
    pub fn limit(&self) -> f64 {
        self.ego_lane().speed_limit.unwrap_or(self.limit_estimate)
    }

    pub fn ego_lane(&self) -> &Centerline {
        &self.centerlines[0]
    }

    pub fn agent(&self, name: AgentName) -> Option<&GraphAgent> {
        self.agents.iter().find(|agent| agent.name == name)
    }

    /// The agents on a node, in order of their names' numbering.
    pub(crate) fn agents_on(&self, place: NodePlace) -> impl Iterator<Item = &GraphAgent> {
        self.agents.iter().filter(move |agent| agent.place == place)
    }

    /// The nearest agent or obstacle ahead that blocks a centerline.
    pub fn lead_agent(&self, centerline: CenterlineName) -> Option<&GraphAgent> {
        let name = self.centerline(centerline)?.lead_agent?;
        self.agent(name)
    }
}

#[cfg(test)]
mod standing_tests;
#[cfg(test)]
mod tests;
