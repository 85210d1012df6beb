//! `planagent ask`.

use crate::args::AskArguments;
use crate::commands::plan::{history, instant, scenario};
use crate::picture::check_output;
use crate::progress::listener;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use image::RgbImage;
use indicatif::HumanDuration;
use planagent_agent::environment::bev::{Palette, render};
use planagent_agent::environment::text::write;
use planagent_agent::environment::{BevView, Description, LaneGraph};
use planagent_agent::reasoning::{FreeQuestion, PromptSet, question_prompt};
use planagent_mllm::{
    Answer, AnswerTime, Constraint, Deadline, FinishReason, Mllm, PromptPrefix, Request,
    TokenCounts,
};
use planagent_runs::report::fixed;
use planagent_runs::runner::{Config, load_model};
use planagent_world::{STEP_S, SceneView};
use serde::Serialize;
use std::io::IsTerminal;
use std::sync::Arc;
use std::time::Duration;

/// An answer that takes longer is announced with its time.
const LONG: Duration = Duration::from_mins(1);

/// An answer as JSON.
#[derive(Debug, Serialize)]
struct Record<'a> {
    model: &'a str,
    scenario: &'a str,
    iteration: usize,
    at_s: f64,
    question: &'a str,
    answer: &'a str,
    finish: FinishReason,
    /// The system prompt and the prompt as the model read them.
    system: &'a str,
    prompt: &'a str,
    tokens: TokenCounts,
    /// Wall time of the answer, and to its first token.
    seconds: f64,
    first_token_s: f64,
}

/// Puts a question about a recorded scene to the model, and prints the answer as it is generated.
pub(crate) fn run(flags: &AskArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    // What is wrong with the question is said before a model loads, which may take minutes.
    if flags.question.trim().is_empty() {
        bail!("the question is empty; write it as one word of the command line, in quotes");
    }
    if !config.environment.bev {
        bail!("environment.bev is false, and ask shows a picture; leave the setting out");
    }
    let scenario = scenario(flags.scenario.as_deref(), &flags.data)?;
    let (iteration, frame) = instant(&scenario, flags.at)?;
    if let Some(file) = &flags.image {
        check_output(file.path())?;
    }
    let loaded = load_model(config, &listener(printer))?;
    let (model, prompts, reasoning) = loaded.parts().context("there is no model to ask")?;
    let history = history(&scenario, iteration);
    let scene = scenario.scene(frame, &history);
    let image = picture(model, &scene, config)?;
    // What sees nothing else is asked about the text.
    let scene_text = (flags.lane_graph || image.is_none())
        .then(|| lane_graph(&scene, prompts, config))
        .transpose()?;
    match (&image, &flags.image) {
        (None, Some(_)) => bail!(
            "--image: the model {} reads text alone, so there is no picture to save",
            model.name()
        ),
        (None, None) => printer.note(format!(
            "{} reads text alone: the question is about the lane-graph text, not about a picture",
            model.name()
        )),
        (Some(image), Some(file)) => file.save(image)?,
        (Some(_), None) => {}
    }
    if prompts.forms().scene_text.is_for_small_models() {
        let name = model.name();
        printer.note(format!(
            "{name} was trained on the prompts of its own set alone: expect no sensible answer to a free question"
        ));
    }
    let legend = image
        .as_ref()
        .map_or_else(String::new, |_| Palette::legend());
    let question = FreeQuestion {
        question: &flags.question,
        scene_text: scene_text.as_deref(),
        legend: &legend,
    };
    let (system, prompt) = question_prompt(prompts, &question)?;
    let request = Request {
        constraint: Constraint::Free,
        max_new_tokens: flags.max_tokens as usize,
        sampling: reasoning.generation.sampling,
        deadline: Deadline::NONE,
        draft: None,
    };
    let prefix = PromptPrefix {
        system: system.clone(),
        image,
    };
    tell_time(model, &[&system, &prompt], request.max_new_tokens, printer);
    let answer = match asked(model, &prefix, &prompt, &request, config.seed, printer) {
        Ok(answer) => answer,
        Err(error) if error.is_transient() => {
            printer.failure(format!("the model gave no answer: {error}"));
            return Ok(Exit::SomeFailed);
        }
        Err(error) => return Err(error).context("the model cannot be asked"),
    };
    if printer.is_json() {
        printer.json(&Record {
            model: model.name(),
            scenario: &scenario.id,
            iteration,
            at_s: iteration as f64 * STEP_S,
            question: &flags.question,
            answer: &answer.text,
            finish: answer.finish,
            system: &system,
            prompt: &prompt,
            tokens: answer.tokens,
            seconds: answer.time.total / 1000.0,
            first_token_s: answer.time.first_token / 1000.0,
        })?;
    }
    tell(&answer, prefix.image.is_some(), flags, printer);
    Ok(if answer.text.trim().is_empty() {
        Exit::SomeFailed
    } else {
        Exit::Success
    })
}

/// The picture of a scene for a model; none for one that reads text alone.
fn picture(
    model: &dyn Mllm,
    scene: &SceneView<'_>,
    config: &Config,
) -> anyhow::Result<Option<Arc<RgbImage>>> {
    let Some(pixels) = model.describe().image_size else {
        return Ok(None);
    };
    let view = BevView::new(pixels, config.environment.view_m)?;
    Ok(Some(Arc::new(render(scene, &view))))
}

/// The answer. A terminal shows its pieces as they come; a file gets what is the answer in the end.
fn asked(
    model: &dyn Mllm,
    prefix: &PromptPrefix,
    prompt: &str,
    request: &Request,
    seed: u64,
    printer: Printer,
) -> Result<Answer, planagent_mllm::MllmError> {
    let mut conversation = model.converse(prefix, seed)?;
    let (mut streamed, is_terminal) = (String::new(), std::io::stdout().is_terminal());
    let asked = conversation.ask_aloud(prompt, request, &mut |piece| {
        streamed.push_str(piece);
        if is_terminal {
            printer.piece(piece);
        }
    });
    let whole = asked.as_ref().map_or(&streamed, |answer| &answer.text);
    if !is_terminal {
        printer.piece(whole);
    } else if *whole != streamed {
        printer.piece("\n");
        printer.note("what came so far was the model's reasoning; this is the answer:");
        printer.piece(whole);
    }
    if asked.is_ok() {
        printer.piece("\n");
    }
    asked
}

/// Says how long an answer takes, where that is long.
fn tell_time(model: &dyn Mllm, texts: &[&str], new: usize, printer: Printer) {
    let text = texts
        .iter()
        .filter_map(|text| model.count_tokens(text))
        .sum();
    if let Some(time) = model.answer_time(text, new)
        && let Some(note) = time_note(time, new)
    {
        printer.note(note);
    }
}

fn time_note(AnswerTime { first_token, whole }: AnswerTime, new: usize) -> Option<String> {
    (whole > LONG).then(|| {
        format!(
            "an answer of {new} tokens takes about {} on this machine, and its first word comes after about {}; --max-tokens \
             makes it shorter",
            HumanDuration(whole),
            HumanDuration(first_token)
        )
    })
}

/// The lane-graph text in the form of the model's prompts.
fn lane_graph(
    scene: &SceneView<'_>,
    prompts: &PromptSet,
    config: &Config,
) -> anyhow::Result<String> {
    let graph =
        LaneGraph::build(scene, config.environment.node_length_m).context("--lane-graph")?;
    Ok(write(
        &Description::from_graph(&graph),
        prompts.forms().scene_text,
    ))
}

/// What the answer cost, and whether it is cut off.
fn tell(answer: &Answer, sees: bool, flags: &AskArguments, printer: Printer) {
    let Answer { tokens, time, .. } = answer;
    let read = tokens.text + tokens.image + tokens.cached;
    let seconds = fixed(time.total / 1000.0, 2);
    printer.note(format!(
        "{} tokens in {seconds} s, after {read} tokens of prompt{}",
        tokens.sampled,
        if sees { " and picture" } else { "" }
    ));
    match answer.finish {
        _ if answer.text.trim().is_empty() => {
            printer.failure("the model gave an empty answer");
        }
        FinishReason::Length => {
            printer.note(format!(
                "the answer is cut off at --max-tokens {}",
                flags.max_tokens
            ));
        }
        FinishReason::ContextFull => {
            printer.note("the answer is cut off at the end of the model's context");
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_long_answer_is_announced() {
        let time = |seconds| AnswerTime {
            first_token: Duration::from_secs(seconds / 2),
            whole: Duration::from_secs(seconds),
        };
        assert_eq!(time_note(time(60), 200), None);
        let note = time_note(time(600), 200).unwrap();
        assert!(
            note.starts_with("an answer of 200 tokens takes about 10 minutes")
                && note.contains("after about 5 minutes"),
            "{note}"
        );
    }
}
