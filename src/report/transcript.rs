//! The transcript of a simulation as Markdown: scene, prompts, answers, planner codes, scores.

use super::decision::decision_words;
use super::number::fixed;
use super::times::CallTimes;
use crate::experiment::run::{SimulationOutcome, SimulationRecord};
use crate::planner::{Attempt, PlanningCall};
use crate::world::STEP_S;
use std::fmt::Write;

/// The transcript of a simulation; `image` gives the path of a call's BEV map, relative to the transcript.
pub fn transcript(
    record: &SimulationRecord,
    outcome: &SimulationOutcome,
    image: impl Fn(&PlanningCall) -> Option<String>,
) -> String {
    let mut text = format!("# {} · {} · {}\n\n", record.scenario, record.planner, record.challenge);
    let score = &outcome.score;
    // Writing to a string cannot fail.
    let _ = writeln!(text, "Scenario type `{}`. Score **{:.4}**.\n", record.scenario_type, score.value);
    text.push_str("| metric | score |\n|---|---|\n");
    for part in &score.parts {
        let _ = writeln!(text, "| `{}` | {:.4} |", part.name, part.score);
    }
    for call in &outcome.calls {
        text.push('\n');
        text.push_str(&call_markdown(call, outcome, image(call)));
    }
    text
}

fn call_markdown(call: &PlanningCall, outcome: &SimulationOutcome, image: Option<String>) -> String {
    let seconds = |iteration: usize| iteration as f64 * STEP_S;
    let mut text = format!("## {:.1} s (iteration {})\n\n", seconds(call.iteration), call.iteration);
    if let Some(sample) = outcome.log.samples.get(call.iteration) {
        let _ = writeln!(text, "Ego at {:.1} m/s.\n", sample.ego.speed());
    }
    if let Some(image) = image {
        let _ = writeln!(text, "![BEV map]({image})\n");
    }
    for (i, attempt) in call.attempts.iter().enumerate() {
        let _ = writeln!(text, "### Attempt {}\n", i + 1);
        text.push_str(&attempt_markdown(attempt));
    }
    let _ = writeln!(text, "**Decision:** {}.\n", decision_words(call));
    if let Some(iteration) = call.active_from {
        let _ = writeln!(text, "Active from {:.1} s on.\n", seconds(iteration));
    }
    if let Some(iteration) = call.aborted_lane_change {
        let _ = writeln!(text, "Lane change aborted at {:.1} s.\n", seconds(iteration));
    }
    if call.emergency_brakes > 0 {
        let _ = writeln!(text, "The emergency brake acted in {} iterations.\n", call.emergency_brakes);
    }
    let time = CallTimes::of(call);
    let _ = writeln!(
        text,
        "Time: {:.1} ms (environment {:.1}, image {:.1}, prefill {:.1}, decode {:.1}, server {:.1}, reflection {:.1}).",
        time.total, time.environment, time.image_encode, time.prefill, time.decode, time.remote, time.reflection
    );
    text
}

/// One attempt: its rounds, its planner code, the reflection on it.
pub fn attempt_markdown(attempt: &Attempt) -> String {
    let mut text = String::new();
    for round in &attempt.rounds {
        let _ = writeln!(text, "*{}*\n\n{}\n\n{}\n", round.round, fenced(&round.prompt), quoted(&round.answer));
    }
    for error in &attempt.errors {
        let _ = writeln!(text, "- not understood: {error}");
    }
    if let Some(line) = attempt.line() {
        let _ = writeln!(text, "Code: `{line}`\n");
    }
    if let Some(reflection) = &attempt.reflection {
        let parts: Vec<String> =
            reflection.parts.named().iter().map(|(name, v)| format!("{name} {}", fixed(*v, 2))).collect();
        let _ = writeln!(text, "Reflection: **{:.2}** ({})\n", reflection.score, parts.join(", "));
    }
    text
}

/// A fenced block; its fence is longer than any run of backticks inside.
fn fenced(text: &str) -> String {
    let longest = text.split(|c| c != '`').map(str::len).max().unwrap_or(0);
    let fence = "`".repeat(longest.max(2) + 1);
    format!("{fence}text\n{text}\n{fence}")
}

fn quoted(text: &str) -> String {
    text.lines().map(|line| format!("> {line}")).collect::<Vec<_>>().join("\n")
}
