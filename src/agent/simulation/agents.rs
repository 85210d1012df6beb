//! The policies that control the agents around the ego.

use planagent_scenario::{Frame, Scenario};
use planagent_world::dynamics::{CrossingActors, IdmTraffic, InteractiveTraffic};
use planagent_world::{EgoState, TrackedObject};
use std::error::Error;
use std::fmt::Debug;
use std::sync::Arc;

/// Why a policy cannot move the agents.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct AgentPolicyError(Box<dyn Error + Send + Sync>);

impl AgentPolicyError {
    /// The error of a policy.
    pub fn new(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self(error.into())
    }
}

/// Controls all objects around the ego of one simulation. nuPlan calls it an observation.
pub trait AgentPolicy: Debug + Send + Sync {
    /// The objects now; `logged` is the recorded frame of this iteration.
    fn objects(&self, logged: &Frame) -> Arc<[TrackedObject]>;

    /// Moves to the next iteration, `dt_s` seconds later; `next` is its recorded frame. As in
    /// nuPlan, `ego` is still the state before the step.
    ///
    /// # Errors
    /// When the policy fails; the simulation fails with it.
    fn step(&mut self, ego: &EgoState, next: &Frame, dt_s: f64) -> Result<(), AgentPolicyError>;

    /// Called once after the last iteration of a simulation.
    ///
    /// # Errors
    /// When the policy finds only now that its steps were wrong; the simulation fails with it.
    fn finish(&mut self) -> Result<(), AgentPolicyError> {
        Ok(())
    }

    /// A copy in the same state. A simulation can be cloned at any iteration.
    fn boxed_clone(&self) -> Box<dyn AgentPolicy>;
}

impl Clone for Box<dyn AgentPolicy> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// A named policy.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct AgentPolicySpec {
    /// nuPlan's name.
    pub name: &'static str,
    /// Makes the policy for a scenario at iteration 0, whose recorded frame is given.
    pub new: fn(&Scenario, &Frame) -> Box<dyn AgentPolicy>,
}

/// All objects replay the log.
pub(super) const LOG_REPLAY: AgentPolicySpec = AgentPolicySpec {
    name: "box_observation",
    new: |scenario, first| match scenario
        .interaction
        .as_deref()
        .filter(|added| !added.crossing.is_empty())
    {
        Some(added) => Box::new(LoggedAndCrossing(CrossingActors::new(
            &added.crossing,
            &first.ego,
        ))),
        None => Box::new(LoggedAgents),
    },
};
/// Vehicles follow their lanes by the intelligent driver model and react to the ego; the rest
/// replays the log.
pub(super) const IDM: AgentPolicySpec = AgentPolicySpec {
    name: "idm_agents_observation",
    new: |scenario, first| match &scenario.interaction {
        Some(added) => Box::new(InteractiveTraffic::new(
            &scenario.map,
            &first.objects,
            &first.ego,
            added,
        )),
        None => Box::new(IdmTraffic::new(&scenario.map, &first.objects, &first.ego)),
    },
};

/// In place of a policy that the user has to bring: fails at the first step.
pub(super) const NOT_GIVEN: AgentPolicySpec = AgentPolicySpec {
    name: "own_agents",
    new: |_, first| Box::new(NotGiven(first.objects.clone())),
};

#[derive(Debug, Clone)]
struct NotGiven(Arc<[TrackedObject]>);

impl AgentPolicy for NotGiven {
    fn objects(&self, _: &Frame) -> Arc<[TrackedObject]> {
        Arc::clone(&self.0)
    }

    fn step(&mut self, _: &EgoState, _: &Frame, _: f64) -> Result<(), AgentPolicyError> {
        Err(AgentPolicyError::new(
            "the policy of the other agents is not given; name it by --agents, or use simulate_with_agents",
        ))
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(self.clone())
    }
}

/// The policies of nuPlan's challenges.
pub const AGENT_POLICIES: [AgentPolicySpec; 2] = [LOG_REPLAY, IDM];

#[derive(Debug, Clone, Copy)]
struct LoggedAgents;

impl AgentPolicy for LoggedAgents {
    fn objects(&self, logged: &Frame) -> Arc<[TrackedObject]> {
        Arc::clone(&logged.objects)
    }

    fn step(&mut self, _: &EgoState, _: &Frame, _: f64) -> Result<(), AgentPolicyError> {
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(*self)
    }
}

/// The log, and actors whose crossing the ego triggers, in place of their logged tracks.
#[derive(Debug, Clone)]
struct LoggedAndCrossing(CrossingActors);

impl AgentPolicy for LoggedAndCrossing {
    fn objects(&self, logged: &Frame) -> Arc<[TrackedObject]> {
        let others = logged
            .objects
            .iter()
            .filter(|object| !self.0.has(object.token))
            .copied();
        others.chain(self.0.objects()).collect()
    }

    fn step(&mut self, ego: &EgoState, _: &Frame, dt_s: f64) -> Result<(), AgentPolicyError> {
        self.0.step(ego, dt_s);
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(self.clone())
    }
}

impl AgentPolicy for InteractiveTraffic {
    fn objects(&self, _: &Frame) -> Arc<[TrackedObject]> {
        Self::objects(self)
    }

    fn step(&mut self, ego: &EgoState, next: &Frame, dt_s: f64) -> Result<(), AgentPolicyError> {
        Self::step(self, ego, &next.objects, &next.lights, dt_s);
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(self.clone())
    }
}

impl AgentPolicy for IdmTraffic {
    fn objects(&self, _: &Frame) -> Arc<[TrackedObject]> {
        Self::objects(self)
    }

    fn step(&mut self, ego: &EgoState, next: &Frame, dt_s: f64) -> Result<(), AgentPolicyError> {
        Self::step(self, ego, &next.objects, &next.lights, dt_s);
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(self.clone())
    }
}
