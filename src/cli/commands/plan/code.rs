//! `planagent plan --code`: Reflection's verdict on a planner code that a person wrote.

use super::{compute, history};
use crate::picture::PictureFile;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_agent::environment::{AgentName, LaneGraph};
use planagent_agent::planner::{
    CallSettings, CodeSource, PlanAgentSettings, PlannerInitialization, PlannerName,
};
use planagent_agent::reasoning::{ParseError, PlannerCode};
use planagent_agent::reflection::{LeadPolicy, ReflectionReport};
use planagent_planners::all_planners;
use planagent_runs::report::render::code_picture;
use planagent_runs::report::{Judgement, decision_words, fixed};
use planagent_runs::runner::Config;
use planagent_runs::worker::run::AgentParts;
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, STEP_S};
use serde::Serialize;
use serde_json::{Value, json};

/// Judges a code at an iteration of a scenario.
pub(super) fn run(
    line: &str,
    scenario: &Scenario,
    iteration: usize,
    frame: &Frame,
    config: &Config,
    image: Option<&PictureFile>,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if !config.reflection.enabled {
        bail!("--code is judged by Reflection, which is off; set reflection.enabled=true");
    }
    let settings = settings(config);
    let names = names(scenario, iteration, frame, &settings)?;
    let parts = AgentParts {
        registry: all_planners(),
        model: Some(CodeSource::Written(line.to_owned())),
        settings,
        ..AgentParts::default()
    };
    let mut agent = parts.planner(PlannerName::PLAN_AGENT, scenario)?;
    agent.initialize(&PlannerInitialization {
        map: &scenario.map,
        route: &scenario.route,
    })?;
    compute(scenario, iteration, frame, agent.as_mut())?;
    let call = agent.calls().last().context("the planner made no call")?;
    let Some(attempt) = call.attempts.first() else {
        bail!("the code cannot be judged: {}", decision_words(call))
    };
    // A person wrote the code: what is wrong with it is an error, and no reason to rethink.
    if !attempt.errors.is_empty() {
        bail!("{}", in_words(line, &attempt.errors));
    }
    let (Some(report), Some(code)) = (
        &attempt.reflection,
        attempt.answer.and_then(|answer| answer.code()),
    ) else {
        bail!(
            "the code stands for no plan in this scene: {}",
            decision_words(call)
        );
    };
    let judgement = Judgement::from_report(report, report.threshold > config.reflection.threshold);
    let follows = names.followed(code, config.reflection.lead_policy);
    if let Some(file) = image {
        let words = vec![verdict(&judgement), code.to_string()];
        file.save(&code_picture(scenario, frame, iteration, report, words))?;
    }
    if printer.is_json() {
        let record = Record {
            scenario: &scenario.id,
            iteration,
            at_s: iteration as f64 * STEP_S,
            code: code.to_string(),
            follows: follows.map(|name| name.to_string()),
            judgement: &judgement,
            rollout: rollout(report),
        };
        printer.json(&record)?;
    } else {
        printer.line(format!(
            "{} at {:.1} s\n{code}",
            scenario.id,
            iteration as f64 * STEP_S
        ));
        if let Some(agent) =
            follows.filter(|_| config.reflection.lead_policy == LeadPolicy::Nearest)
        {
            printer.line(format!(
                "The plan follows what is nearest on its path, first {agent}, whatever la names."
            ));
        }
        show(&judgement, printer);
    }
    Ok(Exit::Success)
}

/// The output as JSON.
#[derive(Debug, Serialize)]
struct Record<'a> {
    scenario: &'a str,
    iteration: usize,
    at_s: f64,
    code: String,
    /// The agent that the plan follows first.
    follows: Option<String>,
    #[serde(flatten)]
    judgement: &'a Judgement,
    /// Every 0.1 s: seconds from now, x, y, heading (map frame), speed.
    rollout: Vec<Value>,
}

/// The agent's settings for one attempt without a gate, a latency or a deadline: a judge needs none
/// of them.
fn settings(config: &Config) -> PlanAgentSettings {
    let mut settings = config.agent_settings();
    settings.agent = CallSettings::default();
    settings.reflection.max_exec = 1;
    // A person may name whatever there is.
    settings.environment.oncoming_lane.get_or_insert(true);
    settings
}

/// What a code may name in a scene.
struct SceneNames(LaneGraph);

/// The names of the recorded scene of an iteration.
fn names(
    scenario: &Scenario,
    iteration: usize,
    frame: &Frame,
    settings: &PlanAgentSettings,
) -> anyhow::Result<SceneNames> {
    let history = history(scenario, iteration);
    let scene = scenario.scene(frame, &history);
    let graph = LaneGraph::build(&scene, settings.environment.node_length_m);
    let graph = graph.context("the code cannot be judged: the scene has no lane graph")?;
    Ok(SceneNames(graph.with_oncoming_lane(&scene)))
}

impl SceneNames {
    fn followed(&self, code: PlannerCode, policy: LeadPolicy) -> Option<AgentName> {
        if policy == LeadPolicy::Named {
            return code.lead_agent;
        }
        self.0.lead_agent(code.centerline).map(|agent| agent.name)
    }
}

/// The errors in a code, each with its column, the place marked below the code.
fn in_words(line: &str, errors: &[ParseError]) -> String {
    let column = |byte: usize| {
        line.get(..byte)
            .expect("the span of an error lies within the code")
            .chars()
            .count()
    };
    let one = |error: &ParseError| {
        let (start, end) = (column(error.span.start), column(error.span.end));
        let mark = "^".repeat(end.saturating_sub(start).max(1));
        let space = " ".repeat(start);
        format!(
            "--code, column {}: {}; {}\n  {line}\n  {space}{mark}",
            start + 1,
            error.message,
            error.hint
        )
    };
    errors.iter().map(one).collect::<Vec<_>>().join("\n")
}

fn rollout(report: &ReflectionReport) -> Vec<Value> {
    let state = |(i, state): (usize, &EgoState)| {
        let Pose { x, y, heading } = state.rear_axle;
        json!({"t": i as f64 * STEP_S, "x": x, "y": y, "heading": heading, "speed": state.speed()})
    };
    report.states.iter().enumerate().map(state).collect()
}

fn verdict(judgement: &Judgement) -> String {
    format!(
        "{}: {}",
        if judgement.executed {
            "Executed"
        } else {
            "Refused"
        },
        judgement.reason
    )
}

fn show(judgement: &Judgement, printer: Printer) {
    printer.line("");
    for metric in &judgement.metrics {
        let role = metric
            .weight
            .map_or_else(|| "factor".to_owned(), |weight| format!("weight {weight}"));
        let value = fixed(metric.value, 2);
        printer.line(format!(
            "{:<22} {value:>5}  {role:<9} {}",
            metric.name, metric.finding
        ));
    }
    let [score, threshold] = [judgement.score, judgement.threshold].map(|value| fixed(value, 2));
    printer.line(format!(
        "{:<22} {score:>5}  {:<9} {threshold}",
        "score", "threshold"
    ));
    printer.line(format!("\n{}", verdict(judgement)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_marks_its_characters() {
        let error = ParseError {
            span: 3..5,
            message: "wrong".to_owned(),
            hint: "write a number".to_owned(),
        };
        assert_eq!(
            in_words("ü(ab)", &[error]),
            "--code, column 3: wrong; write a number\n  ü(ab)\n    ^^"
        );
    }
}
