//! `planagent models show`.

use super::row::Row;
use crate::{Exit, Printer};
use planagent_mllm::{ModelRegistry, WeightFormat, in_bytes};

/// Shows what is known of a model.
pub(super) fn run(model: &str, registry: &ModelRegistry, printer: Printer) -> anyhow::Result<Exit> {
    // A name that is no model is an error of the command, not a fact about a model.
    registry.find(model)?;
    let row = Row::for_model(model.to_owned(), registry);
    // A model that has to be fetched first is no fault; one that is here and cannot be opened is.
    let exit = if row.problem.is_some() && row.place.is_some() {
        Exit::SomeFailed
    } else {
        Exit::Success
    };
    if printer.is_json() {
        printer.json(&row)?;
        return Ok(exit);
    }
    printer.line(&row.model);
    let fact = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            printer.line(format!("  {name:<12} {value}"));
        }
    };
    let family = row.family.map(str::to_owned);
    fact("family", family.or_else(|| row.kind.clone()));
    fact("source", row.source.clone());
    fact("description", row.description.clone());
    fact(
        "files",
        row.place.as_ref().map(|place| place.display().to_string()),
    );
    fact("bytes", row.bytes.map(in_bytes));
    fact("adapter", row.adapter.clone());
    fact("problem", row.problem.clone());
    fact("license", row.license.clone());
    fact("weights", row.size());
    let image = row.image_size.zip(row.image_tokens);
    // A model whose shape is known and that draws nothing reads text alone.
    let text_alone = row.context.map(|_| "none: it reads text alone".to_owned());
    fact(
        "image",
        image
            .map(|(side, tokens)| format!("{side} pixels, {tokens} tokens of the drawn BEV map"))
            .or(text_alone),
    );
    fact(
        "possible",
        row.image_range
            .map(|range| format!("{} to {} tokens of an image", range.least, range.most)),
    );
    fact("warning", row.image_warning());
    fact(
        "context",
        row.context.map(|tokens| format!("{tokens} tokens")),
    );
    let prompts = row.prompt_set.as_ref().zip(row.prompts.as_ref());
    fact(
        "prompts",
        prompts.map(|(set, place)| format!("{set} ({place})")),
    );
    if !row.memory.is_empty() {
        printer.line("  memory       weights    keys, values       work    picture");
    }
    let formats = WeightFormat::ALL
        .iter()
        .rev()
        .filter_map(|format| Some((format, row.memory.get(format.name())?)));
    for (format, need) in formats {
        printer.line(format!(
            "    {:<5} {:>12} {:>15} {:>10} {:>10}",
            format.name(),
            in_bytes(need.weights),
            in_bytes(need.cache),
            in_bytes(need.work),
            in_bytes(need.picture)
        ));
    }
    printer.note(format!(
        "`planagent bench {}` measures the time of a planning call.",
        row.model
    ));
    Ok(exit)
}
