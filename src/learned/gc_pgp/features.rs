//! GC-PGP's features (`tuplan_garage` `pgp_ego_agents_feature_builder.py`,
//! `pgp_feature_builder.py`).

use super::lane_graph::{LaneNodes, POSES};
use super::network::GcPgpInputs;
use crate::frame::relative;
use crate::past;
use candle_core::{Device, Result, Tensor};
use planagent_score::metrics::{MetricError, SavitzkyGolay};
use planagent_world::{HistorySample, MICROS_PER_SECOND, ObjectKind, SceneView, TrackedObject};

/// Steps of an actor, and samples of the history between two.
const STEPS: usize = 6;
const STRIDE: usize = 2;
/// Numbers of a step: x, y, speed, acceleration, yaw rate.
const COLUMNS: usize = 5;
/// Numbers of a node's pose.
const POSE: usize = 7;
/// Agents nearer than this to a pose of a node are near the node, meters.
const NEAR: f64 = 10.0;
/// Window and order of the filter of speeds and headings.
const DERIVED: SavitzkyGolay = SavitzkyGolay {
    window: 3,
    order: 2,
    derivative: 1,
};
/// Edges in the tables of the network: none, to a successor, to a proximal node, to the goal.
const SUCCESSOR: f32 = 1.0;
const PROXIMAL: f32 = 2.0;
const GOAL: f32 = 3.0;

/// Steps of an agent, oldest first, zeros where it was not seen.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentSteps {
    /// x, y relative to the rear axle, speed, acceleration, yaw rate.
    pub steps: [[f32; COLUMNS]; STEPS],
    /// Whether it was seen.
    pub seen: [bool; STEPS],
}

/// Features of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct GcPgpFeatures {
    /// The ego's steps, oldest first. As upstream, speed, acceleration and yaw rate are those of
    /// other steps.
    pub ego: [[f32; COLUMNS]; STEPS],
    /// The vehicles in the order of their tokens.
    pub agents: Vec<AgentSteps>,
    /// The lane graph.
    pub graph: LaneNodes,
}

impl GcPgpFeatures {
    /// Of a scene.
    ///
    /// # Errors
    /// When the history cannot be filtered.
    pub fn from_scene(scene: &SceneView<'_>) -> std::result::Result<Self, MetricError> {
        let samples: Vec<HistorySample> = past::samples(scene, (STEPS - 1) * STRIDE + 1)
            .into_iter()
            .step_by(STRIDE)
            .collect();
        Ok(Self {
            ego: ego(scene, &samples),
            agents: agents(scene, &samples)?,
            graph: LaneNodes::from_scene(scene),
        })
    }

    /// A batch of one.
    ///
    /// # Errors
    /// When tensors cannot be made.
    pub fn inputs(&self) -> Result<GcPgpInputs> {
        let (agents, nodes, edges) = (
            self.agents.len(),
            self.graph.nodes.len(),
            self.graph.edges(),
        );
        let tensor =
            |values: Vec<f32>, shape: &[usize]| Tensor::from_vec(values, shape, &Device::Cpu);
        // A number of its own marks each padded number, because the network takes masks of the same
        // shape.
        let (mut poses, mut missing) = (
            vec![0f32; nodes * POSES * POSE],
            vec![1f32; nodes * POSES * POSE],
        );
        for (i, node) in self.graph.nodes.iter().enumerate() {
            for (pose, values) in node.poses.iter().enumerate() {
                let place = (i * POSES + pose) * POSE;
                poses[place..place + POSE].copy_from_slice(&values.map(|value| value as f32));
                missing[place..place + POSE].fill(0.0);
            }
        }
        let red = self
            .graph
            .nodes
            .iter()
            .flat_map(|node| [flag(node.red); POSES])
            .collect();
        let steps = self
            .agents
            .iter()
            .flat_map(|agent| agent.steps.as_flattened())
            .copied()
            .collect();
        let unseen = |agent: &AgentSteps| agent.seen.map(|seen| [flag(!seen); COLUMNS]);
        let unseen: Vec<f32> = self
            .agents
            .iter()
            .flat_map(|agent| unseen(agent).as_flattened().to_vec())
            .collect();
        let (successors, types, on_route) = self.edges(edges);
        let table = [1, nodes, edges + 1];
        Ok(GcPgpInputs {
            ego: tensor(self.ego.as_flattened().to_vec(), &[1, 1, STEPS, COLUMNS])?,
            agents: tensor(steps, &[1, agents, STEPS, COLUMNS])?,
            agents_missing: tensor(unseen, &[1, agents, STEPS, COLUMNS])?,
            far: tensor(self.far(), &[1, nodes, agents])?,
            poses: tensor(poses, &[1, nodes, POSES, POSE])?,
            poses_missing: tensor(missing, &[1, nodes, POSES, POSE])?,
            red: tensor(red, &[1, nodes, POSES, 1])?,
            successors: tensor(successors, &table)?,
            edges: tensor(types, &table)?,
            on_route: tensor(on_route, &table)?,
        })
    }

    /// Targets, types and route flags of all edges; the last of each node is the goal.
    fn edges(&self, width: usize) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
        let (nodes, table) = (&self.graph.nodes, self.graph.nodes.len() * (width + 1));
        let (mut successors, mut types, mut on_route) =
            (vec![0f32; table], vec![0f32; table], vec![0f32; table]);
        for (i, node) in nodes.iter().enumerate() {
            let place = i * (width + 1);
            let targets = node.successors.iter().map(|&to| (to, SUCCESSOR));
            let targets = targets.chain(node.proximal.iter().map(|&to| (to, PROXIMAL)));
            for (edge, (to, kind)) in targets.enumerate() {
                (successors[place + edge], types[place + edge]) = (to as f32, kind);
            }
            for edge in 0..width {
                // An edge that is none leads to node 0.
                let to = successors[place + edge] as usize;
                on_route[place + edge] = flag(nodes.get(to).is_some_and(|node| node.on_route));
            }
            on_route[place + width] = 1.0;
            // The one node of an empty map has no goal.
            if node.lane.is_some() {
                (successors[place + width], types[place + width]) =
                    ((i + nodes.len()) as f32, GOAL);
            }
        }
        (successors, types, on_route)
    }

    /// 1 for each agent that is not near a node.
    fn far(&self) -> Vec<f32> {
        let place = |agent: &AgentSteps| {
            [agent.steps[STEPS - 1][0], agent.steps[STEPS - 1][1]].map(f64::from)
        };
        let near = |poses: &[[f64; POSE]], [x, y]: [f64; 2]| {
            poses
                .iter()
                .any(|pose| (pose[0] - x).hypot(pose[1] - y) <= NEAR)
        };
        let row = |poses: &[[f64; POSE]]| {
            self.agents
                .iter()
                .map(|agent| flag(!near(poses, place(agent))))
                .collect::<Vec<f32>>()
        };
        self.graph
            .nodes
            .iter()
            .flat_map(|node| row(&node.poses))
            .collect()
    }

    /// The speed with which upstream's interpolation begins, m/s.
    pub fn start_speed(&self) -> f32 {
        self.ego[STEPS - 1][2]
    }
}

fn flag(holds: bool) -> f32 {
    if holds { 1.0 } else { 0.0 }
}

fn ego(scene: &SceneView<'_>, samples: &[HistorySample]) -> [[f32; COLUMNS]; STEPS] {
    let mut rows = [[0f32; COLUMNS]; STEPS];
    for (step, sample) in samples.iter().take(STEPS).enumerate() {
        let [x, y, _] = relative(scene.ego.rear_axle, sample.ego.rear_axle);
        (rows[step][0], rows[step][1]) = (x, y);
        // Upstream writes to the row that it counts from the end.
        let row = (STEPS - step) % STEPS;
        let (speed, acceleration) = (sample.ego.velocity.norm(), sample.ego.acceleration.norm());
        let rates = [speed, acceleration, sample.ego.angular_velocity].map(|value| value as f32);
        rows[row][2..].copy_from_slice(&rates);
    }
    rows
}

/// The vehicles of the present. For the derivatives, a missing past state is the next later one.
fn agents(
    scene: &SceneView<'_>,
    samples: &[HistorySample],
) -> std::result::Result<Vec<AgentSteps>, MetricError> {
    let here = scene.ego.rear_axle;
    let times: Vec<f64> = samples
        .iter()
        .map(|sample| sample.ego.time_us as f64 / MICROS_PER_SECOND)
        .collect();
    let interval = (times[STEPS - 1] - times[0]) / (STEPS - 1) as f64;
    let mut present: Vec<&TrackedObject> = scene
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
        .collect();
    present.sort_by_key(|object| object.token);
    let steps = |now: &&TrackedObject| {
        let (mut states, mut seen) = ([**now; STEPS], [true; STEPS]);
        for i in (0..STEPS - 1).rev() {
            let mut vehicles = samples[i]
                .objects
                .iter()
                .filter(|object| object.kind == ObjectKind::Vehicle);
            let found = vehicles.find(|object| object.token == now.token);
            (states[i], seen[i]) = (found.copied().unwrap_or(states[i + 1]), found.is_some());
        }
        // Through f32, as upstream: the rounding shows in the derivatives.
        let speeds = states.map(|state| f64::from(state.velocity.norm() as f32));
        let headings = states.map(|state| f64::from(state.shape.center.heading as f32));
        let (accelerations, yaw_rates) = (
            DERIVED.apply(&speeds, interval)?,
            DERIVED.apply(&headings, interval)?,
        );
        let step = |i: usize| {
            if !seen[i] {
                return [0.0; COLUMNS];
            }
            let [x, y, _] = relative(here, states[i].shape.center);
            [
                x,
                y,
                speeds[i] as f32,
                accelerations[i] as f32,
                yaw_rates[i] as f32,
            ]
        };
        Ok(AgentSteps {
            steps: std::array::from_fn(step),
            seen,
        })
    };
    present.iter().map(steps).collect()
}
