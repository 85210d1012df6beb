//! The transcript of a simulation as Markdown: scene, prompts, answers, planner codes, scores.

use super::decision::decision_words;
use super::key::CompactParts;
use super::number::fixed;
use super::repeats::Repeat;
use super::times::CallTimes;
use super::visible::{in_markdown, markdown_block, markdown_cell, markdown_line, visible_line};
use crate::worker::run::{SimulationOutcome, SimulationRecord};
use planagent_agent::planner::{Attempt, PlanningCall};
use planagent_agent::reasoning::{PlannerAnswer, RoundRecord, ToolUse};
use planagent_agent::reflection::BehaviorScores;
use planagent_world::STEP_S;
use std::fmt::Write;

/// The transcript of a simulation; `image` gives the path of a call's BEV map, relative to the
/// transcript.
pub fn transcript(
    record: &SimulationRecord,
    outcome: &SimulationOutcome,
    image: impl Fn(&PlanningCall) -> Option<String>,
) -> String {
    let mut text = format!(
        "# {} · {} · {}\n\n",
        markdown_line(&record.scenario),
        markdown_line(record.planner.as_str()),
        markdown_line(&record.challenge.to_string())
    );
    let score = &outcome.score;
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "Scenario type {}. Score **{:.4}**.\n",
        code(&record.scenario_type),
        score.value
    );
    text.push_str("| metric | score |\n|---|---|\n");
    for part in &score.parts {
        let _ = writeln!(text, "| `{}` | {:.4} |", part.name, part.score);
    }
    let key = CompactParts::from_calls(&outcome.calls).key();
    if !key.is_empty() {
        let _ = write!(
            text,
            "\n## Key to the compact texts\n\n{}\n",
            key.trim_end()
        );
    }
    for call in &outcome.calls {
        text.push('\n');
        text.push_str(&call_markdown(call, outcome, image(call)));
    }
    text
}

fn call_markdown(
    call: &PlanningCall,
    outcome: &SimulationOutcome,
    image: Option<String>,
) -> String {
    let seconds = |iteration: usize| iteration as f64 * STEP_S;
    let mut text = format!(
        "## {:.1} s (iteration {})\n\n",
        seconds(call.iteration),
        call.iteration
    );
    // In the order of time: what the agent saw, what the model answered, what came of it.
    if let Some(sample) = outcome.log.samples.get(call.iteration) {
        let _ = writeln!(text, "Ego at {:.1} m/s.\n", sample.ego.speed());
    }
    if let Some(image) = image {
        let _ = writeln!(text, "![BEV map]({image})\n");
    }
    for i in 0..call.attempts.len() {
        let further = if call.attempts[i].is_asked {
            ""
        } else {
            ": further codes, of the agent itself"
        };
        let _ = writeln!(text, "### Attempt {}{further}\n", i + 1);
        text.push_str(&attempt_markdown(&call.attempts, i));
    }
    let _ = writeln!(
        text,
        "**Decision:** {}.\n",
        markdown_line(&decision_words(call))
    );
    if let Some(iteration) = call.active_from {
        let _ = writeln!(text, "Active from {:.1} s on.\n", seconds(iteration));
    }
    if let Some(iteration) = call.aborted_lane_change {
        let _ = writeln!(
            text,
            "Lane change aborted at {:.1} s.\n",
            seconds(iteration)
        );
    }
    if let Some(iteration) = call.evasion {
        let _ = writeln!(
            text,
            "Swerved into a lane beside for a person or a bicycle at {:.1} s.\n",
            seconds(iteration)
        );
    }
    if call.handovers > 0 {
        let _ = writeln!(
            text,
            "A proposal of PDM-Closed drove in {} iterations, because it scored more than the plan, which scored less than \
             the threshold.\n",
            call.handovers
        );
    }
    if call.emergency_brakes > 0 {
        let _ = writeln!(
            text,
            "The emergency brake acted in {} iterations.\n",
            call.emergency_brakes
        );
    }
    let time = CallTimes::from_call(call);
    let _ = writeln!(
        text,
        "Time: {} ms (environment {}, image {}, prefill {}, decode {}, server {}, reflection {}).",
        fixed(time.total, 1),
        fixed(time.environment, 1),
        fixed(time.image_encode, 1),
        fixed(time.prefill, 1),
        fixed(time.decode, 1),
        fixed(time.remote, 1),
        fixed(time.reflection, 1)
    );
    text
}

/// One of the attempts of a call: its rounds, its planner code, the reflection on it. What it
/// repeats of an earlier attempt is said, not written again.
pub fn attempt_markdown(attempts: &[Attempt], index: usize) -> String {
    let Some(attempt) = attempts.get(index) else {
        return String::new();
    };
    let mut text = String::new();
    let repeat = Repeat::find(attempts, index);
    // A small model often repeats itself. Written once, answers that differ are found sooner.
    if let Some(Repeat::Answers(of)) = repeat {
        for round in new_prompts(attempts, of, attempt) {
            let _ = writeln!(text, "*{}*\n\n{}\n", round.round, fenced(&round.prompt));
        }
        let score = attempt
            .reflection
            .as_ref()
            .map(|reflection| format!(" Reflection: **{:.2}**", reflection.score));
        let same = "the same answers, the same code and the same score";
        let _ = writeln!(
            text,
            "The model repeated attempt {}: {same}.{}\n",
            of + 1,
            score.unwrap_or_default()
        );
        return text;
    }
    for round in &attempt.rounds {
        let _ = writeln!(
            text,
            "*{}*\n\n{}\n\n{}\n",
            round.round,
            fenced(&round.prompt),
            quoted(&round.answer)
        );
        if let Some(tool) = &round.tool {
            text.push_str(&tool_markdown(tool));
        }
    }
    for error in &attempt.errors {
        let _ = writeln!(
            text,
            "- not understood: {}",
            markdown_line(&error.to_string())
        );
    }
    if !attempt.proposals.is_empty() {
        text.push_str("| proposal | score | if crossing traffic yields | if it insists |\n|---|---:|---:|---:|\n");
        for proposal in &attempt.proposals {
            let scores = proposal.reflection.as_ref().map_or_else(
                || "- | - | -".to_owned(),
                |report| {
                    let BehaviorScores {
                        yields, insists, ..
                    } = report.behaviors;
                    [report.score, yields, insists]
                        .map(|score| fixed(score, 2))
                        .join(" | ")
                },
            );
            let _ = writeln!(
                text,
                "| {} | {scores} |",
                markdown_cell(&proposal.answer.to_string())
            );
        }
        text.push('\n');
    }
    if let Some(answer) = &attempt.answer {
        let line = answer.to_string();
        let same = match repeat {
            Some(Repeat::Code(of) | Repeat::Answers(of)) => {
                format!(" (the code of attempt {})", of + 1)
            }
            None => String::new(),
        };
        let _ = writeln!(text, "{}: {}{same}\n", kind_of(answer), code(&line));
    }
    if let Some(reflection) = &attempt.reflection {
        let parts: Vec<String> = reflection
            .parts
            .named()
            .iter()
            .map(|(name, v)| format!("{name} {}", fixed(*v, 2)))
            .collect();
        let BehaviorScores {
            yields, insists, ..
        } = reflection.behaviors;
        let [score, yields, insists] =
            [reflection.score, yields, insists].map(|score| fixed(score, 2));
        let others = if yields == score && insists == score {
            String::new()
        } else {
            format!(". If crossing traffic yields {yields}, if it insists {insists}")
        };
        let _ = writeln!(
            text,
            "Reflection: **{score}** ({}){others}\n",
            parts.join(", ")
        );
    }
    text
}

/// The tool that a round called, and what it gave.
fn tool_markdown(tool: &ToolUse) -> String {
    let state = if tool.failed { "refused" } else { "answered" };
    format!(
        "Tool {} with {} {state}:\n\n{}\n\n",
        code(&tool.function),
        code(&tool.arguments),
        fenced(&tool.result)
    )
}

/// What an answer is, as the head of its line.
fn kind_of(answer: &PlannerAnswer) -> &'static str {
    match answer {
        PlannerAnswer::Code(_) | PlannerAnswer::Assistance(_) => "Code",
        PlannerAnswer::Waypoints(_) => "Waypoints",
        PlannerAnswer::Action(_) => "Action",
    }
}

/// The rounds whose prompts differ from those of an earlier attempt.
fn new_prompts<'a>(
    attempts: &'a [Attempt],
    of: usize,
    attempt: &'a Attempt,
) -> impl Iterator<Item = &'a RoundRecord> {
    let before = attempts.get(of).map_or(&[][..], |earlier| &earlier.rounds);
    let is_new = move |(i, round): &(usize, &RoundRecord)| {
        before
            .get(*i)
            .is_none_or(|other| other.prompt != round.prompt)
    };
    attempt
        .rounds
        .iter()
        .enumerate()
        .filter(is_new)
        .map(|(_, round)| round)
}

fn fenced(text: &str) -> String {
    markdown_block("text", text)
}

fn quoted(text: &str) -> String {
    in_markdown(text)
        .lines()
        .map(|line| format!("> {line}"))
        .collect::<Vec<_>>()
        .join("\n")
}

/// A code span; its marks are longer than any run of backticks inside.
fn code(text: &str) -> String {
    let longest = text
        .split(|c| c != '`')
        .map(str::len)
        .max()
        .expect("a split gives one part at least");
    let (marks, space) = ("`".repeat(longest + 1), if longest > 0 { " " } else { "" });
    format!("{marks}{space}{}{space}{marks}", visible_line(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::environment::CenterlineName;
    use planagent_agent::reasoning::{
        DrivingAction, LISTED_WAYPOINTS, PlannerCode, Round, SeenPlace, WaypointList,
    };
    use planagent_mllm::{ConstraintUse, FinishReason, RoundTime, TokenCounts};

    fn attempt(prompt: &str, answer: &str, target_speed: f64) -> Attempt {
        let round = RoundRecord {
            round: Round::Code.into(),
            prompt: prompt.to_owned(),
            prompt_hash: String::new(),
            answer: answer.to_owned(),
            finish: FinishReason::Complete,
            constraint: ConstraintUse::Unconstrained,
            log_probability: None,
            tokens: TokenCounts::default(),
            tool: None,
            time: RoundTime::default(),
        };
        let (centerline, lead_agent) = (CenterlineName::EgoLane, None);
        let code = PlannerCode {
            centerline,
            lead_agent,
            target_speed,
            accel_max: 1.0,
            decel_max: 2.0,
        };
        let mut attempt = Attempt::of_rounds(vec![round]);
        attempt.answer = Some(code.into());
        attempt
    }

    #[test]
    fn what_an_attempt_repeats_is_said_and_not_written_again() {
        let attempts = [
            attempt("the scene", "go on", 10.0),
            attempt("it was refused", "go on", 10.0),
            attempt("it was refused", "go on, please", 10.0),
            attempt("it was refused", "slow down", 5.0),
        ];
        let text = |index| attempt_markdown(&attempts, index);
        assert!(
            text(0).contains("> go on")
                && text(0).contains("Code: `")
                && !text(0).contains("attempt 1"),
            "{}",
            text(0)
        );
        let whole = text(1);
        assert!(
            whole.contains("it was refused") && whole.contains("The model repeated attempt 1"),
            "{whole}"
        );
        assert!(
            !whole.contains("> go on") && !whole.contains("Code:"),
            "{whole}"
        );
        let code = text(2);
        assert!(
            code.contains("> go on, please") && code.contains("` (the code of attempt 1)"),
            "{code}"
        );
        assert!(
            !text(3).contains("attempt 1") && text(3).contains("> slow down"),
            "{}",
            text(3)
        );
        assert_eq!(text(4), "");
    }

    #[test]
    fn tools_and_other_forms_of_answers_are_told() {
        let mut asked = attempt("which tool?", "objects_around()", 1.0);
        let tool = |failed| ToolUse {
            function: "objects_around".to_owned(),
            arguments: "9".to_owned(),
            result: "error: | one `too` many".to_owned(),
            failed,
        };
        asked.rounds[0].tool = Some(tool(true));
        asked.answer = Some(DrivingAction::Slower.into());
        let text = attempt_markdown(&[asked.clone()], 0);
        assert!(
            text.contains("Tool `objects_around` with `9` refused:")
                && text.contains("one `too` many")
                && text.contains("Action: `slower`"),
            "{text}"
        );
        asked.rounds[0].tool = Some(tool(false));
        let places = [SeenPlace {
            right: 0.0,
            ahead: 4.0,
        }; LISTED_WAYPOINTS];
        asked.answer = Some(WaypointList(places).into());
        let text = attempt_markdown(&[asked], 0);
        assert!(
            text.contains("answered:") && text.contains("Waypoints: `[(0.00,4.00), "),
            "{text}"
        );
    }
}
