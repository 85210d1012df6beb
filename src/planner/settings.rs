//! Settings of the agent.

use super::latency::Latency;
use crate::environment::DEFAULT_NODE_LENGTH;
use crate::reflection::{LeadPolicy, PlanMonitor, steps_of};
use std::time::Duration;

/// Which planner drives when all attempts were refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AfterMaxExec {
    /// The last one (the paper).
    Last,
    /// The one with the best score; the planner in force goes on where it scores more.
    #[default]
    Best,
}

/// Settings of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanAgentSettings {
    /// Side of the BEV map, metres; `None` leaves the image out.
    pub view_m: Option<f64>,
    /// Whether that map is of an unrelated scene, a new one at each planning call: an ablation.
    pub shuffled_bev: bool,
    /// Whether the model gets the lane-graph text.
    pub lane_graph: bool,
    /// Length of a lane-graph node, metres.
    pub node_length_m: f64,
    /// Iterations between planning calls.
    pub interval: usize,
    /// Time after which a planning call ends with the planner in force; `None` lets it think to the end. What was drawn
    /// and what is being judged is done to the end all the same.
    pub deadline: Option<Duration>,
    /// The predicted score of PDM-Closed's plan from which on the model is not asked and PDM-Closed drives; `None` always asks.
    pub gate: Option<f64>,
    /// How long a planning call lasts in simulated time.
    pub latency: Latency,
    /// Whether planners are judged.
    pub reflect: bool,
    /// λ.
    pub threshold: f64,
    /// λ of a planner with which a change of lanes would begin, where that is higher.
    pub lane_change_threshold: f64,
    /// Most attempts of a planning call.
    pub max_exec: usize,
    /// Length of the roll-outs, seconds.
    pub horizon_s: f64,
    /// Which planner drives when all attempts were refused.
    pub after_max_exec: AfterMaxExec,
    /// Whom generated planners follow.
    pub lead_policy: LeadPolicy,
    /// Whether the active plan is monitored between planning calls, which needs Reflection: at every iteration [`PlanMonitor`]
    /// scores the plan, its slower and lateral versions and a stop, and chooses one. A lane change whose score falls is
    /// aborted where the present lane scores more. Without, the plan is executed as the model wrote it (the paper).
    pub monitoring: bool,
    /// Whether the ego may brake hard against what the planner in force does: by PDM-Closed's rule, and where it is watched by its
    /// version that stops too.
    pub emergency_brake: bool,
    /// Seed of the run; each planning call draws from its own stream.
    pub seed: u64,
}

impl Default for PlanAgentSettings {
    fn default() -> Self {
        Self {
            view_m: Some(64.0),
            shuffled_bev: false,
            lane_graph: true,
            node_length_m: DEFAULT_NODE_LENGTH,
            interval: 20,
            deadline: None,
            gate: None,
            latency: Latency::None,
            reflect: true,
            threshold: 0.75,
            lane_change_threshold: 0.98,
            max_exec: 3,
            horizon_s: 4.0,
            after_max_exec: AfterMaxExec::Best,
            lead_policy: LeadPolicy::Nearest,
            monitoring: true,
            emergency_brake: true,
            seed: 0,
        }
    }
}

impl PlanAgentSettings {
    /// How the planner in force is watched.
    pub(super) fn monitor(&self) -> PlanMonitor {
        let Self { horizon_s, threshold, emergency_brake, .. } = *self;
        PlanMonitor { steps: steps_of(horizon_s), threshold, emergency_brake }
    }

    /// The seed of the planning call at an iteration.
    pub(super) fn call_seed(&self, iteration: usize) -> u64 {
        self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(iteration as u64)
    }
}
