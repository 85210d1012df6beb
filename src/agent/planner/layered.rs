//! Which layers an agent gets.

use super::settings::PlanAgentSettings;
use super::{AgentLayer, Delayed, Gated, Latency, Monitored};

/// An agent with the layers that its settings ask for: `Delayed(Gated(Monitored(agent)))`.
pub(super) fn with_layers(
    mut agent: Box<dyn AgentLayer>,
    settings: &PlanAgentSettings,
) -> Box<dyn AgentLayer> {
    if let Some(monitor) = settings.monitor() {
        agent = Box::new(Monitored::new(agent, monitor));
    }
    if let Some(gate) = settings.agent.gate {
        agent = Box::new(Gated::new(agent, gate));
    }
    if settings.agent.latency != Latency::None {
        agent = Box::new(Delayed::new(agent, settings.agent.latency));
    }
    agent
}
