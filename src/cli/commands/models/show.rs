//! `planagent models show`.

use super::row::{Row, rounded};
use crate::{Exit, Printer};
use planagent_lab::bench::ESTIMATED_ON;
use planagent_mllm::{ModelRegistry, WeightFormat, in_bytes};

/// Shows what is known of a model.
pub(super) fn run(model: &str, registry: &ModelRegistry, printer: Printer) -> anyhow::Result<Exit> {
    // A name that is no model is an error of the command, not a fact about a model.
    registry.find(model)?;
    let row = Row::of(model.to_owned(), registry);
    if printer.is_json() {
        printer.json(&row)?;
        return Ok(Exit::Success);
    }
    printer.line(&row.model);
    let fact = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            printer.line(format!("  {name:<12} {value}"));
        }
    };
    fact("family", row.family.map(str::to_owned));
    fact("source", row.source.clone());
    fact("description", row.description.clone());
    fact("files", row.place.as_ref().map(|place| place.display().to_string()));
    fact("bytes", row.bytes.map(in_bytes));
    fact("problem", row.problem.clone());
    fact("license", row.license.clone());
    fact("weights", row.size());
    let image = row.image_size.zip(row.image_tokens);
    fact("image", image.map(|(side, tokens)| format!("{side} pixels, {tokens} tokens of the drawn BEV map")));
    fact("context", row.context.map(|tokens| format!("{tokens} tokens")));
    let prompts = row.prompt_set.as_ref().zip(row.prompts.as_ref());
    fact("prompts", prompts.map(|(set, place)| format!("{set} ({place})")));
    if !row.memory.is_empty() {
        printer.line("  memory       weights    keys, values       work   estimated call");
    }
    let formats = WeightFormat::ALL.iter().rev().filter_map(|format| Some((format, row.memory.get(format.name())?)));
    for (format, need) in formats {
        let seconds = row.estimated_seconds.get(format.name());
        let seconds = seconds.map_or_else(|| "-".to_owned(), |seconds| format!("{} s", rounded(*seconds)));
        printer.line(format!(
            "    {:<5} {:>12} {:>15} {:>10} {seconds:>16}",
            format.name(),
            in_bytes(need.weights),
            in_bytes(need.cache),
            in_bytes(need.work)
        ));
    }
    if !row.estimated_seconds.is_empty() {
        printer.note(format!(
            "A planning call is estimated for {ESTIMATED_ON}\n\
             from the speeds of other models (docs/latency.md).\n\
             `planagent bench {}` measures it.",
            row.model
        ));
    }
    Ok(Exit::Success)
}
