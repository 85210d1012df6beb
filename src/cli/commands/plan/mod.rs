//! `planagent plan`.

mod code;

use crate::args::{DataArguments, PlanArguments};
use crate::picture::check_output;
use crate::progress::listener;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_agent::planner::PlannerName;
use planagent_agent::planner::{Planner, PlannerInitialization, PlannerInput, PlanningCall};
use planagent_agent::reasoning::Interruption;
use planagent_runs::report::render::call_picture;
use planagent_runs::report::{CallRecord, CallTimes, attempt_markdown, decision_words, fixed};
use planagent_runs::runner::{Config, load_model};
use planagent_scenario::{Frame, Scenario};
use planagent_world::{History, HistorySample, MICROS_PER_SECOND, STEP_S, Trajectory};
use serde_json::{Value, json};

/// Runs one planning call at a time of the recorded scenario.
pub(crate) fn run(
    flags: &PlanArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    let scenario = scenario(flags.scenario.as_deref(), &flags.data)?;
    let (iteration, frame) = instant(&scenario, flags.at)?;
    if let Some(file) = &flags.image {
        check_output(file.path())?;
    }
    if let Some(code) = &flags.code {
        return code::run(
            code,
            &scenario,
            iteration,
            frame,
            config,
            flags.image.as_ref(),
            printer,
        );
    }
    if let Some(file) = &flags.image {
        check_output(file.beside("model").path())?;
    }
    let listener = listener(printer);
    let loaded = load_model(config, &listener)?;
    let parts = loaded.agent_parts(config, &listener)?;
    let mut agent = parts.planner(PlannerName::PLAN_AGENT, &scenario)?;
    agent.initialize(&PlannerInitialization {
        map: &scenario.map,
        route: &scenario.route,
    })?;
    let trajectory = compute(&scenario, iteration, frame, agent.as_mut())?;
    // The planner starts at iteration 0; the record has the iteration of the scenario.
    let mut call = agent
        .calls()
        .last()
        .context("the planner made no call")?
        .clone();
    (call.iteration, call.at_s) = (iteration, iteration as f64 * STEP_S);
    if let Some(file) = &flags.image {
        file.save(&call_picture(&scenario, frame, &call, &trajectory))?;
        if let Some(image) = &call.image {
            file.beside("model").save(image)?;
        }
    }
    if printer.is_json() {
        printer.json(&with_trajectory(&scenario, &call, &trajectory)?)?;
    } else {
        show(&scenario, &call, &trajectory, printer);
    }
    let unanswered = matches!(call.interruption(), Some(Interruption::Model(_)));
    let failed = unanswered || call.unreadable().is_some();
    Ok(if failed {
        Exit::SomeFailed
    } else {
        Exit::Success
    })
}

/// The one scenario that a word names.
pub(crate) fn scenario(word: Option<&str>, data: &DataArguments) -> anyhow::Result<Scenario> {
    let words: Vec<String> = word.iter().map(ToString::to_string).collect();
    let mut sources = Vec::new();
    for word in data.modified_or_default(&words)? {
        sources.extend(data.readers().find(&word)?);
    }
    match (sources.pop(), sources.len()) {
        (Some(source), 0) => Ok(source.open()?),
        (_, more) => bail!(
            "{} names {} scenarios; name one",
            word.unwrap_or("nothing"),
            more + 1
        ),
    }
}

/// The iteration nearest to a time in seconds after the start of the window, with its frame.
pub(crate) fn instant(scenario: &Scenario, at: f64) -> anyhow::Result<(usize, &Frame)> {
    let iteration = (at / STEP_S).round();
    let in_window = (0.0..scenario.iterations() as f64).contains(&iteration);
    in_window
        .then_some(iteration as usize)
        .and_then(|i| Some((i, scenario.frame(i)?)))
        .with_context(|| {
            let end = (scenario.iterations() - 1) as f64 * STEP_S;
            format!(
                "--at {at} lies outside the window of {}, which is from 0 to {end:.1} s",
                scenario.id
            )
        })
}

/// The trajectory of the planner for the recorded scene of an iteration.
fn compute(
    scenario: &Scenario,
    iteration: usize,
    frame: &Frame,
    agent: &mut dyn Planner,
) -> anyhow::Result<Trajectory> {
    let history = history(scenario, iteration);
    Ok(agent.compute_trajectory(&PlannerInput {
        iteration: 0,
        scene: scenario.scene(frame, &history),
    })?)
}

/// The recorded past up to an iteration.
pub(crate) fn history(scenario: &Scenario, iteration: usize) -> History {
    let mut history = History::default();
    for frame in scenario.frames.iter().take(scenario.start + iteration + 1) {
        history.push(HistorySample {
            ego: frame.ego,
            objects: frame.objects.clone(),
        });
    }
    history
}

/// The call's record with the trajectory: seconds from now, x, y, heading (map frame), speed.
fn with_trajectory(
    scenario: &Scenario,
    call: &PlanningCall,
    trajectory: &Trajectory,
) -> anyhow::Result<Value> {
    let mut record =
        CallRecord::from_call(&scenario.id, PlannerName::PLAN_AGENT.as_str(), None, call)
            .to_json()?;
    let start = trajectory.start_us();
    let states = trajectory.states().iter().map(|state| {
        let pose = state.rear_axle;
        json!({
            "t": (state.time_us - start) as f64 / MICROS_PER_SECOND,
            "x": pose.x, "y": pose.y, "heading": pose.heading, "speed": state.velocity.x,
        })
    });
    if let Some(fields) = record.as_object_mut() {
        fields.insert("trajectory".to_owned(), states.collect());
    }
    Ok(record)
}

fn show(scenario: &Scenario, call: &PlanningCall, trajectory: &Trajectory, printer: Printer) {
    printer.line(format!(
        "{} at {:.1} s\n",
        scenario.id,
        call.iteration as f64 * STEP_S
    ));
    for i in 0..call.attempts.len() {
        printer.line(format!("Attempt {}\n", i + 1));
        printer.line(attempt_markdown(&call.attempts, i));
    }
    printer.line(format!("Decision: {}", decision_words(call)));
    printer.line("Trajectory: time s, forward m, left m, speed m/s");
    let ego = trajectory.states()[0].rear_axle;
    // A state a second: every tenth of a second is too much to read.
    for state in trajectory.states().iter().step_by(10) {
        let at = ego.to_local(state.rear_axle.position());
        let seconds = (state.time_us - trajectory.start_us()) as f64 / MICROS_PER_SECOND;
        let [forward, left, speed] = [at.x, at.y, state.velocity.x].map(|value| fixed(value, 2));
        printer.line(format!("{seconds:5.1} {forward:>8} {left:>7} {speed:>7}"));
    }
    let time = CallTimes::from_call(call);
    let ms = |value: f64| fixed(value, 1);
    printer.line(format!(
        "\nTime {} ms: environment {}, image encode {}, prefill {},\n  decode {}, server {}, reflection {}",
        ms(time.total),
        ms(time.environment),
        ms(time.image_encode),
        ms(time.prefill),
        ms(time.decode),
        ms(time.remote),
        ms(time.reflection)
    ));
}
