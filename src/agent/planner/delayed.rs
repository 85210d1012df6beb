//! Simulated latency: the plan of a planning call becomes active only after the call's time has
//! passed.

use super::agent_state::ActivePlan;
use super::latency::Latency;
use super::layer::{AgentLayer, forward};
use super::{PlannerError, PlannerInput};
use crate::environment::GraphedScene;
use planagent_world::Trajectory;
use std::time::Instant;

/// Recorded steps are some microseconds longer or shorter than 0.1 s. A plan that is late by less
/// than this is not delayed by a whole step, µs. Latencies are whole milliseconds.
const TOLERANCE_US: i64 = 500;

/// An agent whose planning calls last in simulated time. Meanwhile the active plan is executed;
/// before the first plan the ego keeps its lane and speed.
#[derive(Debug)]
pub struct Delayed<A> {
    inner: A,
    latency: Latency,
    pending: Option<Pending>,
}

/// A planning call that still lasts in simulated time.
#[derive(Debug)]
struct Pending {
    ends_us: i64,
    plan: Option<ActivePlan>,
}

impl<A> Delayed<A> {
    /// An agent whose planning calls have this latency.
    pub fn new(inner: A, latency: Latency) -> Self {
        Self {
            inner,
            latency,
            pending: None,
        }
    }
}

impl<A: AgentLayer> AgentLayer for Delayed<A> {
    forward!(inner: state, execute);

    fn reset(&mut self) {
        self.pending = None;
        self.inner.reset();
    }

    fn advance(&mut self, input: &PlannerInput<'_>) -> Result<(), PlannerError> {
        self.inner.advance(input)?;
        let now_us = input.scene.ego.time_us;
        let ended = self
            .pending
            .take_if(|pending| now_us + TOLERANCE_US >= pending.ends_us);
        let Some(Pending {
            plan: Some(plan), ..
        }) = ended
        else {
            return Ok(());
        };
        let state = self.inner.state_mut();
        state.active = plan;
        state.note(|call| call.active_from = Some(input.iteration));
        state.extend(&input.scene)
    }

    fn plan(
        &mut self,
        input: &PlannerInput<'_>,
        started: Instant,
    ) -> Result<Option<ActivePlan>, PlannerError> {
        if self.pending.is_some() {
            return Ok(None);
        }
        let scene = &input.scene;
        let state = self.inner.state_mut();
        if let (ActivePlan::None, Ok(graph)) = (&state.active, state.lane_graph(scene)) {
            let seen = GraphedScene::new(scene, &graph);
            let plan = state.builder.keep_lane_and_speed(seen)?;
            state.active = plan.map_or(ActivePlan::None, ActivePlan::from);
        }
        let plan = self.inner.plan(input, started)?;
        let call = self.inner.state().calls.last();
        let lasts_us = call
            .filter(|call| call.asks_model())
            .map_or(0, |call| self.latency.micros(call.total_ms));
        if lasts_us == 0 {
            return Ok(plan);
        }
        self.pending = Some(Pending {
            ends_us: scene.ego.time_us + lasts_us,
            plan,
        });
        Ok(None)
    }
}
