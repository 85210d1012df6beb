//! Agents that a command of another program controls: each iteration it gets the ego and the
//! objects, and answers their next states.

use super::agent_name::AgentPolicyName;
use super::agents::{AgentPolicy, AgentPolicyError};
use crate::planner::{
    AnswerError, ExecAgentsStep, ExecReply, ExecRequest, ExecSession, PlannerInitialization,
    StopSwitch, moved,
};
use planagent_scenario::{Frame, Scenario};
use planagent_world::{EgoState, TrackedObject};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A command that controls the other agents.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AgentCommand {
    /// The name of the policy.
    pub name: AgentPolicyName,
    /// The command, for the shell.
    pub command: String,
    /// Time for an answer to a step.
    pub timeout: Duration,
}

impl AgentCommand {
    /// Starts the command for a simulation. It controls the agents from the first step on; at
    /// iteration 0, they are where they were recorded. A command that cannot be started fails the
    /// first step. It is waited for until `stop`.
    pub fn policy(
        &self,
        scenario: &Scenario,
        first: &Frame,
        stop: Option<&StopSwitch>,
    ) -> Box<dyn AgentPolicy> {
        let initialization = PlannerInitialization {
            map: &scenario.map,
            route: &scenario.route,
        };
        let session = ExecSession::start(&self.command, self.timeout, stop, &initialization);
        Box::new(ExecAgents {
            session: Mutex::new(session),
            objects: first.objects.clone(),
            iteration: 0,
        })
    }
}

#[derive(Debug)]
struct ExecAgents {
    /// The running command, or why there is none. A lock makes it shareable; it is never contended.
    session: Mutex<Result<ExecSession, AnswerError>>,
    objects: Arc<[TrackedObject]>,
    iteration: usize,
}

impl AgentPolicy for ExecAgents {
    fn objects(&self, _: &Frame) -> Arc<[TrackedObject]> {
        Arc::clone(&self.objects)
    }

    fn step(&mut self, ego: &EgoState, next: &Frame, dt_s: f64) -> Result<(), AgentPolicyError> {
        let iteration = self.iteration + 1;
        let state = self
            .session
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner);
        let session = match state {
            Ok(session) => session,
            // The step fails the simulation, so the error is needed once.
            Err(error) => {
                return Err(AgentPolicyError::new(std::mem::replace(
                    error,
                    AnswerError::Copied,
                )));
            }
        };
        let message = ExecAgentsStep::new(
            iteration,
            dt_s,
            ego,
            &self.objects,
            &next.lights,
            &next.objects,
        );
        let answer = session
            .ask(&ExecRequest::Agents(Box::new(message)))
            .and_then(|(reply, shown)| match reply {
                ExecReply::Agents { objects } => {
                    moved(&objects, &self.objects, &next.objects).map_err(AnswerError::Agents)
                }
                _ => Err(AnswerError::Other {
                    expected: "agents",
                    answer: shown,
                }),
            });
        self.objects = answer.map_err(AgentPolicyError::new)?.into();
        self.iteration = iteration;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), AgentPolicyError> {
        let state = self
            .session
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner);
        match std::mem::replace(state, Err(AnswerError::Copied)) {
            Ok(session) => session.finish().map_err(AgentPolicyError::new),
            // Without a step, nobody needed the command.
            Err(_) => Ok(()),
        }
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        let session = Mutex::new(Err(AnswerError::Copied));
        Box::new(Self {
            session,
            objects: Arc::clone(&self.objects),
            iteration: self.iteration,
        })
    }
}
