//! The gate: the model is not asked where PDM-Closed is predicted to score enough.

use super::agent_state::ActivePlan;
use super::layer::{AgentLayer, forward};
use super::record::{Decision, PlanningCall};
use super::{PlannerError, PlannerInput};
use planagent_mllm::milliseconds;
use planagent_score::pdm::{PdmMemory, plan_along};
use planagent_world::{SceneView, Trajectory};
use std::time::Instant;

/// An agent behind a gate.
#[derive(Debug)]
pub struct Gated<A> {
    inner: A,
    /// The predicted score from which on PDM-Closed is executed and the agent makes no planning
    /// call.
    gate: f64,
}

impl<A> Gated<A> {
    /// An agent behind a gate, a score in [0, 1].
    pub fn new(inner: A, gate: f64) -> Self {
        Self { inner, gate }
    }
}

impl<A: AgentLayer> AgentLayer for Gated<A> {
    forward!(inner: state, reset, advance, execute);

    fn plan(
        &mut self,
        input: &PlannerInput<'_>,
        started: Instant,
    ) -> Result<Option<ActivePlan>, PlannerError> {
        let state = self.inner.state_mut();
        let score = predicted_score(&input.scene, &mut state.memory)?;
        let Some(score) = score.filter(|&score| score >= self.gate) else {
            return self.inner.plan(input, started);
        };
        let at_s = state.clock.elapsed_s(input.scene.ego.time_us);
        let call = PlanningCall::without_attempts(
            input.iteration,
            at_s,
            Decision::Gated(score),
            milliseconds(started.elapsed()),
        );
        state.calls.push(call);
        Ok(Some(ActivePlan::PdmClosed))
    }
}

/// The predicted score of PDM-Closed's plan along the reference path that it chooses now, which is
/// kept in `memory`; `None` where there is no reference path.
fn predicted_score(
    scene: &SceneView<'_>,
    memory: &mut PdmMemory,
) -> Result<Option<f64>, PlannerError> {
    memory.choose_reference_path(scene);
    let PdmMemory {
        reference_path: Some(path),
        collided,
    } = memory
    else {
        return Ok(None);
    };
    let plan = plan_along(path, scene, collided)?;
    Ok(Some(plan.scores[plan.best].total))
}
