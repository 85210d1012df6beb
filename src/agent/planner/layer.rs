//! The layers of an agent. [`PlanAgent`](super::PlanAgent) is the innermost;
//! [`Gated`](super::Gated), [`Delayed`](super::Delayed) and [`Monitored`](super::Monitored) change
//! its planning calls or the execution of its plans. Each is a [`Planner`].

use super::agent_state::{ActivePlan, AgentState};
use super::record::PlanningCall;
use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_world::Trajectory;
use std::time::Instant;

/// A planner that makes planning calls and executes their plan in between.
pub trait AgentLayer: Send {
    /// The state that all layers share.
    fn state(&self) -> &AgentState;

    /// The state that all layers share.
    fn state_mut(&mut self) -> &mut AgentState;

    /// Prepares for a simulation.
    fn reset(&mut self);

    /// Called at every step before a planning call may be made.
    ///
    /// # Errors
    /// When a plan cannot be built.
    fn advance(&mut self, input: &PlannerInput<'_>) -> Result<(), PlannerError>;

    /// Makes a planning call and records it. The plan that it gives becomes active now; without one
    /// the active plan is extended. `started` is the wall time at which the call began.
    ///
    /// # Errors
    /// When the call cannot be made. A wrong answer is no such error.
    fn plan(
        &mut self,
        input: &PlannerInput<'_>,
        started: Instant,
    ) -> Result<Option<ActivePlan>, PlannerError>;

    /// The trajectory of the active plan.
    ///
    /// # Errors
    /// When it has none.
    fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError>;
}

impl<A: AgentLayer> Planner for A {
    fn name(&self) -> &str {
        self.state().name.as_str()
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        self.reset();
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.advance(input)?;
        let state = self.state_mut();
        state.clock.step(input.scene.ego.time_us);
        if state.is_call_due(&input.scene) {
            state.clock.set_called();
            match self.plan(input, Instant::now())? {
                Some(plan) => self.state_mut().active = plan,
                None => self.state_mut().extend(&input.scene)?,
            }
        }
        self.execute(input)
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.state().calls
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        std::mem::take(&mut self.state_mut().calls)
    }
}

/// Forwards what a layer does not change to the layer inside it.
macro_rules! forward {
    ($inner:ident: $($name:ident),*) => { $(forward!(@ $inner $name);)* };
    (@ $inner:ident state) => {
        fn state(&self) -> &$crate::planner::agent_state::AgentState {
            self.$inner.state()
        }

        fn state_mut(&mut self) -> &mut $crate::planner::agent_state::AgentState {
            self.$inner.state_mut()
        }
    };
    (@ $inner:ident reset) => {
        fn reset(&mut self) {
            self.$inner.reset();
        }
    };
    (@ $inner:ident advance) => {
        fn advance(&mut self, input: &PlannerInput<'_>) -> Result<(), PlannerError> {
            self.$inner.advance(input)
        }
    };
    (@ $inner:ident plan) => {
        fn plan(&mut self, input: &PlannerInput<'_>, started: Instant) -> Result<Option<ActivePlan>, PlannerError> {
            self.$inner.plan(input, started)
        }
    };
    (@ $inner:ident execute) => {
        fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
            self.$inner.execute(input)
        }
    };
}
pub(super) use forward;

impl AgentLayer for Box<dyn AgentLayer> {
    fn state(&self) -> &AgentState {
        self.as_ref().state()
    }

    fn state_mut(&mut self) -> &mut AgentState {
        self.as_mut().state_mut()
    }

    fn reset(&mut self) {
        self.as_mut().reset();
    }

    fn advance(&mut self, input: &PlannerInput<'_>) -> Result<(), PlannerError> {
        self.as_mut().advance(input)
    }

    fn plan(
        &mut self,
        input: &PlannerInput<'_>,
        started: Instant,
    ) -> Result<Option<ActivePlan>, PlannerError> {
        self.as_mut().plan(input, started)
    }

    fn execute(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.as_mut().execute(input)
    }
}
