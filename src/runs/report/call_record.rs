//! A line of `calls.jsonl`: one planning call, attempts and rounds inside it. Measured times stand
//! under the key `time`. `docs/schema/calls.schema.json` is derived from these types.

use super::bounded::at_most;
use super::error::{ReportError, ReportFault};
use super::layout::CALLS;
use super::limits::{MAX_ATTEMPTS, MAX_CALL_BYTES, MAX_CALLS_BYTES};
use super::number::json_value;
use super::run_files::read_present;
use super::times::CallTimes;
use planagent_agent::environment::CenterlineName;
use planagent_agent::planner::{
    Attempt, Decision, DecisionKind, NoPlan, PlanningCall, Proposal, Unreadable,
};
use planagent_agent::reasoning::{
    Assistance, DrivingAction, MotionInstruction, ParseError, PlannerAnswer, RoundRecord,
    WaypointList,
};
use planagent_agent::reflection::{
    BehaviorScores, ProgressReference, ReflectionReport, SubScores, Verdict,
};
use planagent_agent::simulation::Challenge;
use planagent_files::OpenFolder;
use planagent_mllm::RoundTime;
use planagent_score::pdm::DrivableLayers;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io;

/// The record of a planning call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CallRecord {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the planner.
    pub planner: String,
    /// The challenge; absent for a call outside of a simulation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub challenge: Option<Challenge>,
    /// Iteration of the call.
    pub iteration: usize,
    /// Time of the call after the first step, seconds.
    pub at_s: f64,
    /// BLAKE3 of the BEV image's width, height and RGB bytes.
    pub image_blake3: Option<String>,
    /// The lane-graph text.
    pub scene_text: Option<String>,
    /// The attempts, in order.
    #[serde(deserialize_with = "at_most::<_, _, MAX_ATTEMPTS>")]
    pub attempts: Vec<AttemptRecord>,
    /// The outcome.
    pub decision: DecisionRecord,
    /// Iterations until the next call in which the ego braked hard against the active plan.
    pub emergency_brakes: usize,
    /// Measured times, milliseconds.
    pub time: TimeRecord,
    /// Under a latency: the iteration at which the call's plan became active.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub active_from: Option<usize>,
    /// Iterations until the next call in which a proposal of PDM-Closed drove; absent for none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handovers: Option<usize>,
    /// The iteration at which a lane change was aborted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aborted_lane_change: Option<usize>,
    /// The iteration at which the ego last swerved into a lane beside for people or bicycles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub evasion: Option<usize>,
}

/// An attempt of a planning call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttemptRecord {
    /// The rounds as they were asked and answered.
    pub rounds: Vec<RoundRecord>,
    /// The motion instruction, if one was read.
    pub instruction: Option<MotionInstruction>,
    /// The line that the attempt ends with, if one was read.
    pub code: Option<LineRecord>,
    /// The errors in the answer.
    pub errors: Vec<ParseError>,
    /// Reflection on the plan, if there is a plan and Reflection is on.
    pub reflection: Option<ReflectionRecord>,
    /// Where several lines were proposed: each, the likeliest first. The best one is the attempt's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub proposals: Vec<ProposalRecord>,
    /// Whether its codes are those that the agent tries by itself after refusals; absent if not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_further: bool,
}

/// A line that an attempt proposed beside others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProposalRecord {
    /// The line.
    pub code: LineRecord,
    /// Reflection on its plan, if there is a plan and Reflection is on.
    pub reflection: Option<ReflectionRecord>,
}

/// A line that was read, with its parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum LineRecord {
    /// The planner code of PlanAgent.
    Code(CodeRecord),
    /// Waypoints every second, or parameters of PDM-Closed.
    Assistance(AssistanceRecord),
    /// Waypoints every half second.
    Waypoints(WaypointsRecord),
    /// An action.
    Action(ActionRecord),
}

/// A planner code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CodeRecord {
    /// The whole line.
    pub text: String,
    /// The centerline.
    pub c: CenterlineName,
    /// The lead agent.
    pub la: Option<String>,
    /// Target speed, m/s.
    pub v0: f64,
    /// Maximum acceleration, m/s².
    pub acc: f64,
    /// Maximum deceleration, m/s².
    pub dec: f64,
}

/// Waypoints every second, or parameters of PDM-Closed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AssistanceRecord {
    /// The whole line.
    pub text: String,
    /// Waypoints or parameters of PDM-Closed.
    pub assistance: Assistance,
}

/// Waypoints every half second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WaypointsRecord {
    /// The whole list.
    pub text: String,
    /// Its places.
    pub waypoints: WaypointList,
}

/// An action that moves set-points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActionRecord {
    /// Its name.
    pub text: String,
    /// The action.
    pub action: DrivingAction,
}

/// Reflection on a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReflectionRecord {
    /// s, in [0, 1].
    pub score: f64,
    /// The parts of the score.
    pub parts: SubScores,
    /// The score where crossing traffic yields or insists; none in runs of before version 24.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub behaviors: Option<BehaviorScores>,
    /// What progress was divided by.
    pub progress_reference: ProgressReference,
    /// The areas that counted as drivable.
    pub drivable_layers: DrivableLayers,
    /// Whether the plan is executed.
    pub verdict: Verdict,
}

/// The outcome of a planning call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
#[allow(
    missing_docs,
    reason = "what stands at a variant stands in the published schema; its fields would repeat it"
)]
pub enum DecisionRecord {
    /// The plan of this attempt (from 0) scored λ or more.
    Execute { attempt: usize },
    /// All attempts were refused; the plan of this attempt becomes active all the same.
    Exhausted { attempt: usize },
    /// There is no new plan; the active one is kept.
    KeepActivePlan {
        cause: String,
        /// Of the cause `unreadable`: what is wrong with the last answer.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sub_cause: Option<Unreadable>,
        why: String,
    },
    /// There is no plan; the ego brakes.
    Brake {
        cause: String,
        /// Of the cause `unreadable`: what is wrong with the last answer.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sub_cause: Option<Unreadable>,
        why: String,
    },
    /// The predicted score of PDM-Closed passes the gate; the model was not asked.
    Gated { score: f64 },
    /// There is no answer that is better than PDM-Closed.
    RuleBased {
        cause: String,
        /// Of the cause `unreadable`: what is wrong with the last answer.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sub_cause: Option<Unreadable>,
        why: String,
    },
}

/// Measured times of a planning call, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TimeRecord {
    /// The call by part.
    pub call: CallTimes,
    /// Each attempt.
    pub attempts: Vec<AttemptTimes>,
}

/// Measured times of an attempt, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttemptTimes {
    /// Each round.
    pub rounds: Vec<RoundTime>,
    /// Roll-out and score.
    pub reflection: f64,
    /// The whole attempt.
    pub total: f64,
}

impl CallRecord {
    /// The record of a call that `planner` made in a scenario; without challenge for a call outside
    /// of a simulation.
    pub fn from_call(
        scenario: &str,
        planner: &str,
        challenge: Option<Challenge>,
        call: &PlanningCall,
    ) -> Self {
        Self {
            scenario: scenario.to_owned(),
            planner: planner.to_owned(),
            challenge,
            iteration: call.iteration,
            at_s: call.at_s,
            image_blake3: call.image_hash.clone(),
            scene_text: call.scene_text.clone(),
            attempts: call
                .attempts
                .iter()
                .map(AttemptRecord::from_attempt)
                .collect(),
            decision: DecisionRecord::from_decision(&call.decision),
            emergency_brakes: call.emergency_brakes,
            time: TimeRecord {
                call: CallTimes::from_call(call),
                attempts: call
                    .attempts
                    .iter()
                    .map(AttemptTimes::from_attempt)
                    .collect(),
            },
            active_from: call.active_from,
            // Absent for zero, because most agents have no handovers.
            handovers: Some(call.handovers).filter(|&count| count > 0),
            aborted_lane_change: call.aborted_lane_change,
            evasion: call.evasion,
        }
    }

    /// The record as JSON in which no zero has a minus.
    ///
    /// # Errors
    /// When it cannot be serialized.
    pub fn to_json(&self) -> serde_json::Result<Value> {
        json_value(self)
    }

    /// The attempt whose plan becomes active.
    pub fn accepted(&self) -> Option<(usize, &AttemptRecord)> {
        let (DecisionRecord::Execute { attempt } | DecisionRecord::Exhausted { attempt }) =
            self.decision
        else {
            return None;
        };
        Some((attempt, self.attempts.get(attempt)?))
    }
}

impl AttemptRecord {
    fn from_attempt(attempt: &Attempt) -> Self {
        Self {
            rounds: attempt.rounds.clone(),
            instruction: attempt.instruction,
            code: attempt.answer.map(LineRecord::from_answer),
            errors: attempt.errors.clone(),
            reflection: attempt
                .reflection
                .as_ref()
                .map(ReflectionRecord::from_report),
            proposals: attempt
                .proposals
                .iter()
                .map(ProposalRecord::from_proposal)
                .collect(),
            is_further: !attempt.is_asked,
        }
    }
}

impl ProposalRecord {
    fn from_proposal(proposal: &Proposal) -> Self {
        let reflection = proposal
            .reflection
            .as_ref()
            .map(ReflectionRecord::from_report);
        Self {
            code: LineRecord::from_answer(proposal.answer),
            reflection,
        }
    }
}

impl LineRecord {
    fn from_answer(answer: PlannerAnswer) -> Self {
        let text = answer.to_string();
        match answer {
            PlannerAnswer::Assistance(assistance) => {
                Self::Assistance(AssistanceRecord { text, assistance })
            }
            PlannerAnswer::Waypoints(waypoints) => {
                Self::Waypoints(WaypointsRecord { text, waypoints })
            }
            PlannerAnswer::Action(action) => Self::Action(ActionRecord { text, action }),
            PlannerAnswer::Code(code) => Self::Code(CodeRecord {
                text,
                c: code.centerline,
                la: code.lead_agent.map(|name| name.to_string()),
                v0: code.target_speed,
                acc: code.accel_max,
                dec: code.decel_max,
            }),
        }
    }

    /// The whole line.
    pub fn text(&self) -> &str {
        match self {
            Self::Code(code) => &code.text,
            Self::Assistance(assistance) => &assistance.text,
            Self::Waypoints(waypoints) => &waypoints.text,
            Self::Action(action) => &action.text,
        }
    }
}

impl ReflectionRecord {
    fn from_report(report: &ReflectionReport) -> Self {
        let ReflectionReport {
            score,
            parts,
            behaviors,
            progress_reference,
            drivable_layers,
            verdict,
            ..
        } = *report;
        Self {
            score,
            parts,
            behaviors: Some(behaviors),
            progress_reference,
            drivable_layers,
            verdict,
        }
    }
}

impl DecisionRecord {
    pub(super) fn from_decision(decision: &Decision) -> Self {
        // The cause is for counting and the words are for reading, so both are written.
        let words = |why: &NoPlan| (why.cause().to_owned(), why.unreadable(), why.to_string());
        match decision.kind() {
            DecisionKind::Execute(attempt) => Self::Execute { attempt },
            DecisionKind::Exhausted(attempt) => Self::Exhausted { attempt },
            DecisionKind::Gated(score) => Self::Gated { score },
            DecisionKind::KeepActivePlan(why) => {
                let (cause, sub_cause, why) = words(why);
                Self::KeepActivePlan {
                    cause,
                    sub_cause,
                    why,
                }
            }
            DecisionKind::Brake(why) => {
                let (cause, sub_cause, why) = words(why);
                Self::Brake {
                    cause,
                    sub_cause,
                    why,
                }
            }
            DecisionKind::RuleBased(why) => {
                let (cause, sub_cause, why) = words(why);
                Self::RuleBased {
                    cause,
                    sub_cause,
                    why,
                }
            }
        }
    }

    /// Why there is no new plan.
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::KeepActivePlan { why, .. }
            | Self::Brake { why, .. }
            | Self::RuleBased { why, .. } => Some(why),
            Self::Execute { .. } | Self::Exhausted { .. } | Self::Gated { .. } => None,
        }
    }
}

impl AttemptTimes {
    fn from_attempt(attempt: &Attempt) -> Self {
        let reasoning: f64 = attempt.rounds.iter().map(|round| round.time.total).sum();
        Self {
            rounds: attempt.rounds.iter().map(|round| round.time).collect(),
            reflection: attempt.reflection_ms,
            total: reasoning + attempt.reflection_ms,
        }
    }
}

/// The planning calls in a simulation's folder; none for a planner that makes none.
///
/// # Errors
/// When they cannot be read.
pub(super) fn calls_in(folder: &OpenFolder) -> Result<Vec<CallRecord>, ReportError> {
    let path = folder.path_of(CALLS);
    let Some(bytes) = read_present(folder, CALLS, MAX_CALLS_BYTES)? else {
        return Ok(Vec::new());
    };
    let text = String::from_utf8(bytes).map_err(|error| {
        let error = io::Error::new(io::ErrorKind::InvalidData, error.utf8_error());
        ReportError::read(&path)(error)
    })?;
    let record = |(i, line): (usize, &str)| {
        if line.len() > MAX_CALL_BYTES {
            return Err(ReportError::at(&path)(ReportFault::LongLine {
                line: i + 1,
                bytes: line.len(),
            }));
        }
        serde_json::from_str(line).map_err(ReportError::at(&path))
    };
    text.lines().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worker::run::AgentParts;
    use planagent_agent::reasoning::{LISTED_WAYPOINTS, RoundName, SeenPlace, ToolUse};
    use planagent_agent::simulation::simulate;
    use planagent_mllm::TokenCounts;
    use planagent_scenario::generator::{self, DEFAULT};

    #[test]
    fn the_calls_of_a_simulation_are_read_as_they_were_written() {
        let scenario = generator::generate(&DEFAULT).unwrap();
        let parts = AgentParts::default();
        let name = parts.registry.find("grid-code").unwrap().name;
        let mut planner = parts.planner(name, &scenario).unwrap();
        simulate(&scenario, planner.as_mut(), Challenge::NonReactive).unwrap();
        let calls = planner.take_calls();
        assert!(calls.len() >= 7);
        for call in &calls {
            let record = CallRecord::from_call(
                &scenario.id,
                name.as_str(),
                Some(Challenge::NonReactive),
                call,
            );
            let line = record.to_json().unwrap().to_string();
            let read: CallRecord = serde_json::from_str(&line).unwrap();
            // serde_json reads some numbers a last digit off, so both sides are read.
            assert_eq!(
                read.to_json().unwrap(),
                serde_json::from_str::<serde_json::Value>(&line).unwrap()
            );
            assert!(read.accepted().is_some(), "{:?}", read.decision);
        }
    }

    #[test]
    fn rounds_tools_and_answers_of_every_form_are_read_as_they_were_written() {
        let places = [SeenPlace {
            right: -0.5,
            ahead: 4.0,
        }; LISTED_WAYPOINTS];
        let answers: [PlannerAnswer; 2] = [WaypointList(places).into(), DrivingAction::Left.into()];
        for answer in answers {
            let rounds = RoundName::ALL.iter().map(|&round| {
                let tool = (round == RoundName::Tool).then(|| ToolUse {
                    function: "f".to_owned(),
                    arguments: "1".to_owned(),
                    result: "two".to_owned(),
                    failed: false,
                });
                serde_json::from_value(serde_json::json!({
                    "round": round, "prompt": "p", "prompt_hash": "", "answer": "a", "finish": "complete",
                    "constraint": "enforced", "tokens": TokenCounts::default(), "tool": tool,
                }))
                .unwrap()
            });
            let mut attempt = Attempt::of_rounds(rounds.collect());
            attempt.answer = Some(answer);
            let mut call = PlanningCall::without_attempts(3, 0.3, Decision::Execute(0), 1.0);
            call.attempts.push(attempt);
            let record = CallRecord::from_call("a", "b", None, &call);
            let line = record.to_json().unwrap().to_string();
            let read: CallRecord = serde_json::from_str(&line).unwrap();
            assert_eq!(read, record);
            let text = answer.to_string();
            assert_eq!(read.attempts[0].code.as_ref().unwrap().text(), text);
            let tools = read.attempts[0]
                .rounds
                .iter()
                .filter(|round| round.tool.is_some());
            assert_eq!(tools.count(), 1);
        }
    }
}
