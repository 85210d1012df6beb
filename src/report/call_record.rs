//! A line of `calls.jsonl`: one planning call, attempts and rounds inside it. Measured times stand under the key `time`.

use super::error::ReportError;
use super::layout::CALLS;
use super::number::remove_negative_zeros;
use super::times::CallTimes;
use crate::planner::{Attempt, Decision, PlanningCall};
use crate::reasoning::PlannerCode;
use crate::simulation::Challenge;
use crate::world::STEP_S;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// The record of a call that `planner` made in a scenario; without challenge for a call that belongs to no drive.
pub fn call_record(scenario: &str, planner: &str, challenge: Option<Challenge>, call: &PlanningCall) -> Value {
    let mut record = json!({"scenario": scenario, "planner": planner});
    if let (Some(fields), Some(challenge)) = (record.as_object_mut(), challenge) {
        fields.insert("challenge".to_owned(), json!(challenge));
    }
    if let (Some(fields), Value::Object(rest)) = (record.as_object_mut(), contents(call)) {
        fields.extend(rest);
    }
    remove_negative_zeros(&mut record);
    record
}

/// The planning calls in a drive's folder, as they were recorded; none for a planner that makes none.
///
/// # Errors
/// When they cannot be read.
pub(super) fn calls_in(folder: &Path) -> Result<Vec<Value>, ReportError> {
    let path = folder.join(CALLS);
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(&path).map_err(ReportError::read(&path))?;
    text.lines().map(|line| serde_json::from_str(line).map_err(ReportError::at(&path))).collect()
}

fn contents(call: &PlanningCall) -> Value {
    let mut contents = json!({
        "iteration": call.iteration,
        "at_s": call.iteration as f64 * STEP_S,
        "image_blake3": call.image_hash,
        "scene_text": call.scene_text,
        "attempts": call.attempts.iter().map(attempt).collect::<Vec<_>>(),
        "decision": decision(&call.decision),
        "emergency_brakes": call.emergency_brakes,
        "time": time(call),
    });
    for (name, iteration) in [("active_from", call.active_from), ("aborted_lane_change", call.aborted_lane_change)] {
        if let (Some(iteration), Some(fields)) = (iteration, contents.as_object_mut()) {
            fields.insert(name.to_owned(), json!(iteration));
        }
    }
    contents
}

fn decision(decision: &Decision) -> Value {
    match decision {
        Decision::Execute(index) => json!({"kind": "execute", "attempt": index}),
        Decision::Exhausted(index) => json!({"kind": "exhausted", "attempt": index}),
        Decision::KeepActivePlan(why) => {
            json!({"kind": "keep_active_plan", "cause": why.cause(), "why": why.to_string()})
        }
        Decision::Brake(why) => json!({"kind": "brake", "cause": why.cause(), "why": why.to_string()}),
        Decision::Gated(score) => json!({"kind": "gated", "score": score}),
        Decision::RuleBased(why) => json!({"kind": "rule_based", "cause": why.cause(), "why": why.to_string()}),
    }
}

fn attempt(attempt: &Attempt) -> Value {
    json!({
        "rounds": attempt.rounds,
        "instruction": attempt.instruction,
        "code": written(attempt),
        "errors": attempt.errors,
        "reflection": attempt.reflection.as_ref().map(|reflection| json!({
            "score": reflection.score,
            "parts": reflection.parts,
            "progress_reference": reflection.progress_reference,
            "drivable_layers": reflection.drivable_layers,
            "verdict": reflection.verdict,
        })),
    })
}

/// The line that the model wrote, with its parts.
fn written(attempt: &Attempt) -> Option<Value> {
    let assistance = attempt.assistance.as_ref();
    attempt.code.as_ref().map(code).or_else(|| assistance.map(|a| json!({"text": a.to_string(), "assistance": a})))
}

fn code(code: &PlannerCode) -> Value {
    json!({
        "text": code.to_string(),
        "c": code.centerline,
        "la": code.lead_agent,
        "v0": code.target_speed,
        "acc": code.accel_max,
        "dec": code.decel_max,
    })
}

/// Milliseconds: of the call by part, of each attempt, of each round.
fn time(call: &PlanningCall) -> Value {
    let rounds = |attempt: &Attempt| attempt.rounds.iter().map(|round| json!(round.time)).collect::<Vec<_>>();
    let attempts: Vec<Value> = call
        .attempts
        .iter()
        .map(|attempt| {
            let thinking: f64 = attempt.rounds.iter().map(|round| round.time.total).sum();
            json!({
                "rounds": rounds(attempt),
                "reflection": attempt.reflection_ms,
                "total": thinking + attempt.reflection_ms,
            })
        })
        .collect();
    json!({"call": CallTimes::of(call), "attempts": attempts})
}
