//! Tells at once of planning calls that got no answer, or whose answer gave no plan.

use planagent_agent::planner::{
    NoPlan, Planner, PlannerError, PlannerInitialization, PlannerInput, PlanningCall,
};
use planagent_agent::reasoning::Interruption;
use planagent_score::pdm::DrivableLayers;
use planagent_world::Trajectory;
use std::fmt;
use std::sync::Arc;

/// Longest part of an answer in a message, characters.
const MAX_SHOWN: usize = 80;

/// A planning call without a plan, although the model was asked.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct FailedCall {
    /// The scenario.
    pub scenario: String,
    /// Name of the planner.
    pub planner: String,
    /// Iteration of the call.
    pub iteration: usize,
    /// The cause in `calls.jsonl`: `model` or `unreadable`.
    pub cause: &'static str,
    /// What happened.
    pub why: String,
    /// The beginning of the last answer, where there is one.
    pub answer: Option<String>,
}

impl FailedCall {
    /// The call, if it got no answer or its answer gave no plan. A deadline is no such failure.
    fn from_call(call: &PlanningCall, scenario: &str, planner: &str) -> Option<Self> {
        let why = call.decision.no_plan()?;
        let is_failure = matches!(
            why,
            NoPlan::Unreadable(_) | NoPlan::Interrupted(Interruption::Model(_))
        );
        let last = call.attempts.last().and_then(|last| last.rounds.last());
        let answer = last
            .map(|last| last.answer.trim())
            .filter(|answer| !answer.is_empty() && matches!(why, NoPlan::Unreadable(_)));
        is_failure.then(|| Self {
            scenario: scenario.to_owned(),
            planner: planner.to_owned(),
            iteration: call.iteration,
            cause: why.cause(),
            why: why.to_string(),
            answer: answer.map(beginning),
        })
    }
}

fn beginning(answer: &str) -> String {
    let mut shown: String = answer.chars().take(MAX_SHOWN).collect();
    if answer.chars().nth(MAX_SHOWN).is_some() {
        shown.push('…');
    }
    shown
}

impl fmt::Display for FailedCall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            scenario,
            planner,
            iteration,
            why,
            answer,
            ..
        } = self;
        let what = if self.cause == "unreadable" {
            "a planning call gave no plan"
        } else {
            "a planning call got no answer"
        };
        write!(
            f,
            "{what} ({scenario}, {planner}, iteration {iteration}): {why}"
        )?;
        answer
            .as_ref()
            .map_or(Ok(()), |answer| write!(f, "; it begins: {answer:?}"))
    }
}

/// Receives failed planning calls, from several threads.
pub type FailedCallListener = Arc<dyn Fn(FailedCall) + Send + Sync>;

/// A planner that reports its failed planning calls as they happen.
pub(super) struct Reporting<'a> {
    planner: Box<dyn Planner + 'a>,
    scenario: String,
    listener: FailedCallListener,
    /// How many calls were looked at.
    seen: usize,
}

impl<'a> Reporting<'a> {
    pub(super) fn new(
        planner: Box<dyn Planner + 'a>,
        scenario: &str,
        listener: FailedCallListener,
    ) -> Self {
        Self {
            planner,
            scenario: scenario.to_owned(),
            listener,
            seen: 0,
        }
    }
}

impl Planner for Reporting<'_> {
    fn name(&self) -> &str {
        self.planner.name()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.seen = 0;
        self.planner.initialize(initialization)
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let trajectory = self.planner.compute_trajectory(input);
        let calls = self.planner.calls();
        for call in calls.iter().skip(self.seen) {
            if let Some(failed) = FailedCall::from_call(call, &self.scenario, self.planner.name()) {
                (self.listener)(failed);
            }
        }
        self.seen = calls.len();
        trajectory
    }

    fn finish(&mut self) -> Result<(), PlannerError> {
        self.planner.finish()
    }

    fn calls(&self) -> &[PlanningCall] {
        self.planner.calls()
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.planner.take_calls()
    }

    fn drivable_layers(&self) -> Option<DrivableLayers> {
        self.planner.drivable_layers()
    }
}
