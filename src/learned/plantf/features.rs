//! PlanTF's features (`jchengai/planTF` `nuplan_feature_builder.py`, `nuplan_feature.py`).

use super::map_features::MapFeatures;
use super::network::{HISTORY, PlanTfInputs};
use crate::past;
use candle_core::{Device, Result, Tensor};
use planagent_world::geometry::{Point, Pose, Vector, wrap_angle};
use planagent_world::{
    EgoState, HistorySample, PACIFICA, RoadblockId, STEP_S, SceneView, TrackToken, TrackedObject,
};
use std::collections::BTreeMap;

/// Maximum number of agents beside the ego.
const MAX_AGENTS: usize = 32;
/// Below this speed, the steering angle and the yaw rate count as 0, m/s.
const STANDING: f64 = 0.2;
/// Bounds of the yaw rate, rad/s, and of the steering angle, radians.
const MAX_YAW_RATE: f64 = 0.95;
const MAX_STEERING: f64 = 2.0 / 3.0 * std::f64::consts::PI;

/// The steps of one agent, oldest first, in the frame of the rear axle now.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentHistory {
    /// x and y, meters.
    pub position: [[f32; 2]; HISTORY],
    /// Heading without wrapping, radians.
    pub heading: [f32; HISTORY],
    /// m/s.
    pub velocity: [[f32; 2]; HISTORY],
    /// Width and length, meters.
    pub shape: [[f32; 2]; HISTORY],
    /// Whether it was seen.
    pub valid: [bool; HISTORY],
}

/// Features of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanTfFeatures {
    /// x, y, heading, speed, acceleration, steering angle, yaw rate.
    pub current_state: [f32; 7],
    /// The ego, then the agents by distance.
    pub agents: Vec<AgentHistory>,
    /// Tracks of the agents behind the ego.
    pub tokens: Vec<TrackToken>,
    /// Lanes, connectors and crosswalks around the ego.
    pub map: MapFeatures,
}

impl PlanTfFeatures {
    /// Of a scene, on the route that was repaired at the first iteration.
    pub fn from_scene(scene: &SceneView<'_>, route: &[RoadblockId]) -> Self {
        let samples = past::samples(scene, HISTORY);
        let frame = scene.ego.rear_axle;
        let mut agents = vec![ego_history(&samples, frame)];
        let tokens = nearest(scene);
        agents.extend(agent_histories(&tokens, &samples, frame));
        Self {
            current_state: current_state(&samples),
            agents,
            tokens,
            map: MapFeatures::from_scene(scene, route),
        }
    }

    /// A batch of one, as in simulation: there, upstream gives every agent the category of the ego.
    ///
    /// # Errors
    /// When tensors cannot be made.
    pub fn inputs(&self) -> Result<PlanTfInputs> {
        let count = self.agents.len();
        let pairs = |read: fn(&AgentHistory) -> &[[f32; 2]; HISTORY]| {
            let values: Vec<f32> = self
                .agents
                .iter()
                .flat_map(|agent| read(agent).as_flattened())
                .copied()
                .collect();
            Tensor::from_vec(values, (1, count, HISTORY, 2), &Device::Cpu)
        };
        let heading: Vec<f32> = self.agents.iter().flat_map(|agent| agent.heading).collect();
        let valid: Vec<u8> = self
            .agents
            .iter()
            .flat_map(|agent| agent.valid)
            .map(u8::from)
            .collect();
        Ok(PlanTfInputs {
            current_state: Tensor::from_slice(
                &self.current_state,
                (1, self.current_state.len()),
                &Device::Cpu,
            )?,
            position: pairs(|agent| &agent.position)?,
            heading: Tensor::from_vec(heading, (1, count, HISTORY), &Device::Cpu)?,
            velocity: pairs(|agent| &agent.velocity)?,
            shape: pairs(|agent| &agent.shape)?,
            // Zero is the ego's category.
            category: Tensor::from_vec(vec![0u32; count], (1, count), &Device::Cpu)?,
            valid: Tensor::from_vec(valid, (1, count, HISTORY), &Device::Cpu)?,
            map: self.map.inputs()?,
        })
    }
}

/// The ego now, with steering angle and yaw rate from its last two headings.
fn current_state(samples: &[HistorySample]) -> [f32; 7] {
    let [.., before, HistorySample { ego, .. }] = samples else {
        return [0.0; 7];
    };
    let speed = ego.velocity.x;
    let (steering, yaw_rate) = if speed.abs() < STANDING {
        (0.0, 0.0)
    } else {
        let rate = wrap_angle(ego.rear_axle.heading - before.ego.rear_axle.heading) / STEP_S;
        let steering = (rate * PACIFICA.wheel_base / speed.abs()).atan();
        (
            steering.clamp(-MAX_STEERING, MAX_STEERING),
            rate.clamp(-MAX_YAW_RATE, MAX_YAW_RATE),
        )
    };
    [
        0.0,
        0.0,
        0.0,
        speed as f32,
        ego.acceleration.x as f32,
        steering as f32,
        yaw_rate as f32,
    ]
}

fn ego_history(samples: &[HistorySample], frame: Pose) -> AgentHistory {
    let shape = [PACIFICA.width, PACIFICA.length()];
    let step = |EgoState {
                    rear_axle,
                    velocity,
                    ..
                }: &EgoState| (*rear_axle, rear_axle.rotate(*velocity), shape);
    let steps = samples.iter().map(|sample| Some(step(&sample.ego)));
    history(steps, frame)
}

/// The agents that are present now, nearest to the ego's center first.
fn nearest(scene: &SceneView<'_>) -> Vec<TrackToken> {
    let center = scene.ego.center();
    let mut present: Vec<&TrackedObject> = scene
        .objects
        .iter()
        .filter(|object| object.kind.is_agent())
        .collect();
    present.sort_by(|a, b| {
        a.shape
            .center
            .distance(&center)
            .total_cmp(&b.shape.center.distance(&center))
    });
    present
        .iter()
        .take(MAX_AGENTS)
        .map(|object| object.token)
        .collect()
}

fn agent_histories(
    tokens: &[TrackToken],
    samples: &[HistorySample],
    frame: Pose,
) -> Vec<AgentHistory> {
    let by_token = |sample: &HistorySample| -> BTreeMap<TrackToken, TrackedObject> {
        sample
            .objects
            .iter()
            .map(|object| (object.token, *object))
            .collect()
    };
    let seen: Vec<BTreeMap<TrackToken, TrackedObject>> = samples.iter().map(by_token).collect();
    let steps = |token: TrackToken| {
        seen.iter().map(move |objects| {
            let TrackedObject {
                shape, velocity, ..
            } = objects.get(&token)?;
            Some((shape.center, *velocity, [shape.width, shape.length]))
        })
    };
    tokens
        .iter()
        .map(|&token| history(steps(token), frame))
        .collect()
}

/// Steps of the map frame in the local one. A missing step holds zeros of the map frame, as
/// upstream; the network masks it.
fn history(
    steps: impl Iterator<Item = Option<(Pose, Vector, [f64; 2])>>,
    frame: Pose,
) -> AgentHistory {
    let mut agent = AgentHistory {
        position: [[0.0; 2]; HISTORY],
        heading: [0.0; HISTORY],
        velocity: [[0.0; 2]; HISTORY],
        shape: [[0.0; 2]; HISTORY],
        valid: [false; HISTORY],
    };
    for (i, step) in steps.enumerate().take(HISTORY) {
        let (pose, velocity, [width, length]) = step.unwrap_or_default();
        let place = frame.to_local(pose.position());
        let turned = Pose::new(0.0, 0.0, frame.heading).to_local(Point::from(velocity));
        agent.position[i] = [place.x as f32, place.y as f32];
        agent.heading[i] = (pose.heading - frame.heading) as f32;
        agent.velocity[i] = [turned.x as f32, turned.y as f32];
        agent.shape[i] = [width as f32, length as f32];
        agent.valid[i] = step.is_some();
    }
    agent
}
