//! The record that every planning call leaves.

use super::unreadable::Unreadable;
use crate::reasoning::{
    Feedback, Interruption, MotionInstruction, ParseError, PlannerAnswer, PromptForms, RoundRecord,
};
use crate::reflection::ReflectionReport;
use image::RgbImage;
use planagent_world::geometry::Pose;
use std::fmt;
use std::sync::Arc;

/// The outcome of a planning call.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Decision {
    /// The plan of this attempt (from 0) scored λ or more and becomes active.
    Execute(usize),
    /// All attempts were refused; the plan of this attempt becomes active all the same, as in the
    /// paper.
    Exhausted(usize),
    /// The call gave no plan; the active one is kept.
    KeepActivePlan(NoPlan),
    /// The call gave no plan and none was active: the ego brakes straight ahead.
    Brake(NoPlan),
    /// The call gave no answer that is better than PDM-Closed, which is executed.
    RuleBased(NoPlan),
    /// The model was not asked: the predicted score of PDM-Closed's plan, given here, passes the
    /// gate. PDM-Closed is executed.
    Gated(f64),
}

/// All outcomes of a planning call, for records, which must know each.
#[doc(hidden)]
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs, reason = "those of `Decision`")]
pub enum DecisionKind<'a> {
    Execute(usize),
    Exhausted(usize),
    KeepActivePlan(&'a NoPlan),
    Brake(&'a NoPlan),
    RuleBased(&'a NoPlan),
    Gated(f64),
}

impl Decision {
    /// The outcome as one of all that there are.
    #[doc(hidden)]
    pub fn kind(&self) -> DecisionKind<'_> {
        match self {
            Self::Execute(attempt) => DecisionKind::Execute(*attempt),
            Self::Exhausted(attempt) => DecisionKind::Exhausted(*attempt),
            Self::KeepActivePlan(why) => DecisionKind::KeepActivePlan(why),
            Self::Brake(why) => DecisionKind::Brake(why),
            Self::RuleBased(why) => DecisionKind::RuleBased(why),
            Self::Gated(score) => DecisionKind::Gated(*score),
        }
    }

    /// The attempt whose plan becomes active.
    pub fn attempt(&self) -> Option<usize> {
        match *self {
            Self::Execute(index) | Self::Exhausted(index) => Some(index),
            _ => None,
        }
    }

    /// Why there is no new plan, where there is none although the model was asked.
    pub fn no_plan(&self) -> Option<&NoPlan> {
        match self {
            Self::KeepActivePlan(why) | Self::Brake(why) | Self::RuleBased(why) => Some(why),
            Self::Execute(_) | Self::Exhausted(_) | Self::Gated(_) => None,
        }
    }
}

/// Why a planning call gave no new plan.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum NoPlan {
    /// The scene has no lane graph. The text says why.
    NoLaneGraph(String),
    /// No attempt gave a plan that can be read.
    Unreadable(Unreadable),
    /// PDM-Closed's own proposal scores no less than any answer.
    Outscored,
    /// All attempts were refused, and the active plan is better than each of them.
    Worse,
    /// The call was ended by its deadline or by a failure of the model.
    Interrupted(Interruption),
}

impl NoPlan {
    /// What is wrong with the answer that could not be read.
    pub fn unreadable(&self) -> Option<Unreadable> {
        match self {
            Self::Unreadable(why) => Some(*why),
            _ => None,
        }
    }

    /// Its name in records.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::NoLaneGraph(_) => "no_lane_graph",
            Self::Unreadable(_) => "unreadable",
            Self::Outscored => "outscored",
            Self::Worse => "worse",
            Self::Interrupted(Interruption::Deadline) => "deadline",
            Self::Interrupted(Interruption::Model(_)) => "model",
        }
    }
}

impl fmt::Display for NoPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) => {
                write!(f, "no attempt gave a plan that can be read: {why}")
            }
            Self::Outscored => {
                f.write_str("PDM-Closed's own proposal scores no less than any answer")
            }
            Self::Worse => f.write_str("the active plan is better than all attempts"),
            Self::Interrupted(Interruption::Deadline) => f.write_str("the deadline passed"),
            Self::NoLaneGraph(why) | Self::Interrupted(Interruption::Model(why)) => {
                f.write_str(why)
            }
        }
    }
}

/// One attempt: three rounds (one of LLM-ASSIST), an answer, its reflection. An interrupted attempt
/// has fewer rounds and no answer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Attempt {
    /// The rounds as they were asked and answered.
    pub rounds: Vec<RoundRecord>,
    /// The motion instruction, if it was given.
    pub instruction: Option<MotionInstruction>,
    /// The line that was read.
    pub answer: Option<PlannerAnswer>,
    /// The errors in the answer.
    pub errors: Vec<ParseError>,
    /// Reflection's report; `None` without a plan or with Reflection off.
    pub reflection: Option<ReflectionReport>,
    /// Where several answers were proposed: each, the likeliest first. The best one is the
    /// attempt's answer.
    pub proposals: Vec<Proposal>,
    /// Path of the plan, map frame.
    pub path: Vec<Pose>,
    /// Wall time of the roll-out and its scoring, milliseconds.
    pub reflection_ms: f64,
    /// Whether the source of codes was asked. After refusals the agent tries further codes out by
    /// itself (docs/decisions/129-judged-handover.md).
    pub is_asked: bool,
}

/// An answer that an attempt proposed beside others.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Proposal {
    /// The line.
    pub answer: PlannerAnswer,
    /// Reflection's report; `None` where the line stands for no plan here.
    pub reflection: Option<ReflectionReport>,
}

impl Attempt {
    /// An attempt that ended after its rounds, for tests of records.
    #[doc(hidden)]
    pub fn of_rounds(rounds: Vec<RoundRecord>) -> Self {
        Self {
            rounds,
            instruction: None,
            answer: None,
            errors: Vec::new(),
            reflection: None,
            proposals: Vec::new(),
            path: Vec::new(),
            reflection_ms: 0.0,
            is_asked: true,
        }
    }

    /// The line as it was read, in text.
    pub fn line(&self) -> Option<String> {
        self.answer.as_ref().map(ToString::to_string)
    }

    /// The feedback that the next attempt gets.
    pub fn feedback(&self, threshold: f64) -> Feedback {
        feedback(
            self.line(),
            self.reflection.as_ref(),
            &self.errors,
            threshold,
        )
    }
}

/// The feedback on an answer that was refused or could not be read.
pub fn feedback(
    line: Option<String>,
    reflection: Option<&ReflectionReport>,
    errors: &[ParseError],
    threshold: f64,
) -> Feedback {
    let named = |report: &ReflectionReport| {
        report
            .parts
            .named()
            .map(|(name, value)| (name.to_owned(), value))
            .to_vec()
    };
    Feedback {
        code: line,
        score: reflection.map(|report| report.score),
        threshold,
        parts: reflection.map(named).unwrap_or_default(),
        is_slow: reflection.is_some_and(|report| report.parts.lacks_only_progress()),
        errors: errors.to_vec(),
    }
}

/// All attempts at one instant.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlanningCall {
    /// Iteration of the call.
    pub iteration: usize,
    /// Time of the call after the first step, seconds.
    pub at_s: f64,
    /// The BEV image that the model saw.
    pub image: Option<Arc<RgbImage>>,
    /// BLAKE3 of the image.
    pub image_hash: Option<String>,
    /// The lane-graph text.
    pub scene_text: Option<String>,
    /// The forms of scene text and answers; `None` where no model was asked.
    #[doc(hidden)]
    pub forms: Option<PromptForms>,
    /// The attempts, in order.
    pub attempts: Vec<Attempt>,
    /// The outcome.
    pub decision: Decision,
    /// Iterations after this call in which the ego braked hard against the active plan: by
    /// PDM-Closed's emergency brake, or by the stop of a monitored plan.
    pub emergency_brakes: usize,
    /// Iterations after this call in which one of PDM-Closed's proposals drove in place of the
    /// active plan.
    pub handovers: usize,
    /// The iteration at which a lane change was aborted.
    pub aborted_lane_change: Option<usize>,
    /// The iteration at which the ego last swerved into a lane beside for people or bicycles.
    pub evasion: Option<usize>,
    /// With a latency: the iteration at which the call's plan became active; `None` where it did
    /// not.
    pub active_from: Option<usize>,
    /// Wall time of the environment transformation, milliseconds.
    pub environment_ms: f64,
    /// Wall time of the whole call, milliseconds.
    pub total_ms: f64,
}

impl PlanningCall {
    /// A call at an iteration and a time that ended before the first attempt.
    #[doc(hidden)]
    pub fn without_attempts(
        iteration: usize,
        at_s: f64,
        decision: Decision,
        total_ms: f64,
    ) -> Self {
        Self {
            iteration,
            at_s,
            image: None,
            image_hash: None,
            scene_text: None,
            forms: None,
            attempts: Vec::new(),
            decision,
            emergency_brakes: 0,
            handovers: 0,
            aborted_lane_change: None,
            evasion: None,
            active_from: None,
            environment_ms: total_ms,
            total_ms,
        }
    }

    /// Attempts after the first.
    pub fn rethinks(&self) -> usize {
        let asked = self.attempts.iter().filter(|attempt| attempt.is_asked);
        asked.count().saturating_sub(1)
    }

    /// Errors in all answers.
    pub fn parse_errors(&self) -> usize {
        self.attempts
            .iter()
            .map(|attempt| attempt.errors.len())
            .sum()
    }

    /// Whether the gate skipped the model.
    pub fn is_gated(&self) -> bool {
        matches!(self.decision, Decision::Gated(_))
    }

    /// Whether the call came to ask the model.
    pub(super) fn asks_model(&self) -> bool {
        !self.is_gated() && !matches!(self.decision.no_plan(), Some(NoPlan::NoLaneGraph(_)))
    }

    /// The interruption that ended the call, if there was one.
    pub fn interruption(&self) -> Option<&Interruption> {
        match self.decision.no_plan() {
            Some(NoPlan::Interrupted(why)) => Some(why),
            _ => None,
        }
    }

    /// What is wrong with the answers of a call that gave no plan for them.
    pub fn unreadable(&self) -> Option<Unreadable> {
        self.decision.no_plan().and_then(NoPlan::unreadable)
    }

    /// The attempt whose plan becomes active, if one does.
    pub fn accepted(&self) -> Option<&Attempt> {
        self.attempts.get(self.decision.attempt()?)
    }
}
