//! Monitoring: Reflection scores the active plan at every step and chooses the version of it that
//! is executed.

use super::agent_state::ActivePlan;
use super::layer::{AgentLayer, forward};
use super::{PlannerError, PlannerInput};
use crate::environment::GraphedScene;
use crate::reflection::{IdmPlan, MonitoredStep, PlanMonitor};
use planagent_world::{SceneView, Trajectory};
use std::time::Instant;

/// An agent whose active plan is monitored. A lane change or an overtake that needs hard braking or
/// scores less than λ is aborted where the plan is better in the ego's present lane; the ego stays
/// there until the next planning call.
#[derive(Debug)]
pub struct Monitored<A> {
    inner: A,
    monitor: PlanMonitor,
}

impl<A> Monitored<A> {
    /// An agent whose active plan is monitored.
    pub fn new(inner: A, monitor: PlanMonitor) -> Self {
        Self { inner, monitor }
    }
}

impl<A: AgentLayer> Monitored<A> {
    /// The active plan in the ego's present lane, and its step; `None` when it is bound for that
    /// lane already.
    fn aborted_lane_change(
        &mut self,
        scene: &SceneView<'_>,
    ) -> Result<Option<(IdmPlan, MonitoredStep)>, PlannerError> {
        let state = self.inner.state_mut();
        let (Some(plan), Ok(graph)) = (state.active_plan(), state.lane_graph(scene)) else {
            return Ok(None);
        };
        let seen = GraphedScene::new(scene, &graph);
        let Some(back) = state.builder.back_to_ego_lane(plan, seen)? else {
            return Ok(None);
        };
        let step = self.monitor.step(scene, &back, &mut state.memory)?;
        Ok(Some((back, step)))
    }
}

impl<A: AgentLayer> AgentLayer for Monitored<A> {
    forward!(inner: state, reset, advance, plan);

    fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let state = self.inner.state_mut();
        let ActivePlan::Generated(plan) = &state.active else {
            return self.inner.execute(input);
        };
        let mut step = self.monitor.step(scene, plan, &mut state.memory)?;
        let mut aborted = None;
        if (step.brakes || step.score < self.monitor.threshold)
            && let Some((back, instead)) = self.aborted_lane_change(scene)?
            && instead.is_better_than(&step)
        {
            (step, aborted) = (instead, Some(back));
        }
        let state = self.inner.state_mut();
        if let Some(back) = aborted {
            state.active = back.into();
            state.note(|call| call.aborted_lane_change = Some(input.iteration));
        }
        if step.is_handover {
            state.note(|call| call.handovers += 1);
        }
        if step.brakes {
            state.note(|call| call.emergency_brakes += 1);
        }
        Ok(step.trajectory)
    }
}
