//! The record that every planning call leaves.

use crate::geometry::Pose;
use crate::reasoning::{Assistance, Feedback, Interruption, MotionInstruction, ParseError, PlannerCode, RoundRecord};
use crate::reflection::ReflectionReport;
use image::RgbImage;
use std::fmt;

/// What a planning call ended with.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// The planner of this attempt (from 0) scored λ or more and drives.
    Execute(usize),
    /// All attempts were refused; the planner of this attempt drives all the same, as the paper prescribes.
    Exhausted(usize),
    /// The call gave no planner; the one in force goes on.
    KeepActivePlan(NoPlan),
    /// The call gave no planner and none was in force: the ego brakes straight ahead.
    Brake(NoPlan),
    /// The call gave nothing to drive by; PDM-Closed drives.
    RuleBased(NoPlan),
    /// The model was not asked: PDM-Closed's plan is predicted to score this, which passes the gate; PDM-Closed drives.
    Gated(f64),
}

/// Why a planning call gave no new planner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NoPlan {
    /// There was nothing to show to the model. The text says why.
    NoLaneGraph(String),
    /// No attempt gave a planner that can be read.
    Unreadable,
    /// PDM-Closed's own proposal scores no less than any answer.
    Outscored,
    /// All attempts were refused, and the planner in force scores more than each of them.
    Worse,
    /// The call was ended by its deadline or by a failure of the model.
    Interrupted(Interruption),
}

impl NoPlan {
    /// Its name in records.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::NoLaneGraph(_) => "no_lane_graph",
            Self::Unreadable => "unreadable",
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
            Self::Unreadable => f.write_str("no attempt gave a planner that can be read"),
            Self::Outscored => f.write_str("PDM-Closed's own proposal scores no less than any answer"),
            Self::Worse => f.write_str("the active plan scores more than all attempts"),
            Self::Interrupted(Interruption::Deadline) => f.write_str("the deadline passed"),
            Self::NoLaneGraph(why) | Self::Interrupted(Interruption::Model(why)) => f.write_str(why),
        }
    }
}

/// One attempt: three rounds (of LLM-ASSIST one), a planner, its reflection; fewer rounds and no planner where it was interrupted.
#[derive(Debug, Clone, PartialEq)]
pub struct Attempt {
    /// The rounds as they were asked and answered.
    pub rounds: Vec<RoundRecord>,
    /// The motion instruction, if it was given.
    pub instruction: Option<MotionInstruction>,
    /// The planner code, if the answer held one.
    pub code: Option<PlannerCode>,
    /// What the answer says, of LLM-ASSIST's.
    pub assistance: Option<Assistance>,
    /// What could not be read.
    pub errors: Vec<ParseError>,
    /// What Reflection said; `None` without code or with Reflection switched off.
    pub reflection: Option<ReflectionReport>,
    /// Path of the planner, map frame.
    pub path: Vec<Pose>,
    /// Wall time of the roll-out and its scoring, milliseconds.
    pub reflection_ms: f64,
}

impl Attempt {
    /// The line that the model wrote, as it was read.
    pub fn line(&self) -> Option<String> {
        let code = self.code.as_ref().map(ToString::to_string);
        code.or_else(|| self.assistance.as_ref().map(ToString::to_string))
    }

    /// What the next attempt is told of it.
    pub fn feedback(&self, threshold: f64) -> Feedback {
        feedback(self.line(), self.reflection.as_ref(), &self.errors, threshold)
    }
}

/// What there is to say about an answer that was refused, or that could not be read.
pub fn feedback(
    line: Option<String>,
    reflection: Option<&ReflectionReport>,
    errors: &[ParseError],
    threshold: f64,
) -> Feedback {
    let named = |report: &ReflectionReport| report.parts.named().map(|(name, value)| (name.to_owned(), value)).to_vec();
    Feedback {
        code: line,
        score: reflection.map(|report| report.score),
        threshold,
        parts: reflection.map(named).unwrap_or_default(),
        errors: errors.to_vec(),
    }
}

/// All attempts at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanningCall {
    /// Iteration at which it was made.
    pub iteration: usize,
    /// The BEV map as the model saw it.
    pub image: Option<RgbImage>,
    /// BLAKE3 of the image.
    pub image_hash: Option<String>,
    /// The lane-graph text.
    pub scene_text: Option<String>,
    /// The attempts, in order.
    pub attempts: Vec<Attempt>,
    /// How it ended.
    pub decision: Decision,
    /// Iterations after this call in which the ego braked hard against what the planner in force does: by PDM-Closed's emergency
    /// brake, or by the stop of a watched planner.
    pub emergency_brakes: usize,
    /// The iteration after this call at which the ego went back to the lane it was in instead of changing lanes.
    pub aborted_lane_change: Option<usize>,
    /// With a latency: the iteration at which the call's planner came into force; `None` where it did not in this drive.
    pub active_from: Option<usize>,
    /// Wall time of the environment transformation, milliseconds.
    pub environment_ms: f64,
    /// Wall time of the whole call, milliseconds.
    pub total_ms: f64,
}

impl PlanningCall {
    /// A call that could not even begin.
    pub(super) fn without_attempts(iteration: usize, decision: Decision, total_ms: f64) -> Self {
        Self {
            iteration,
            image: None,
            image_hash: None,
            scene_text: None,
            attempts: Vec::new(),
            decision,
            emergency_brakes: 0,
            aborted_lane_change: None,
            active_from: None,
            environment_ms: total_ms,
            total_ms,
        }
    }

    /// Attempts after the first.
    pub fn rethinks(&self) -> usize {
        self.attempts.len().saturating_sub(1)
    }

    /// Errors in all answers.
    pub fn parse_errors(&self) -> usize {
        self.attempts.iter().map(|attempt| attempt.errors.len()).sum()
    }

    /// Whether the gate saved the call.
    pub fn is_gated(&self) -> bool {
        matches!(self.decision, Decision::Gated(_))
    }

    /// What ended the call before its time, if anything did.
    pub fn interruption(&self) -> Option<&Interruption> {
        match &self.decision {
            Decision::KeepActivePlan(NoPlan::Interrupted(why))
            | Decision::Brake(NoPlan::Interrupted(why))
            | Decision::RuleBased(NoPlan::Interrupted(why)) => Some(why),
            _ => None,
        }
    }

    /// The attempt whose planner drives from here on, if one of this call does.
    pub fn driving(&self) -> Option<&Attempt> {
        match self.decision {
            Decision::Execute(index) | Decision::Exhausted(index) => self.attempts.get(index),
            _ => None,
        }
    }
}
