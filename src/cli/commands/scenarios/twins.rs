//! `planagent scenarios twins`: draws text twins.

use crate::args::TwinArguments;
use crate::{Exit, Printer};
use planagent_lab::twins::{TEST_PAIRS, VALIDATION_PAIRS, draw, list_text};
use planagent_runs::worker::seeds::Split;
use serde_json::json;
use std::collections::BTreeMap;

/// Prints the list, a pair a line, and why the other candidates are no pairs.
pub(super) fn run(arguments: &TwinArguments, printer: Printer) -> anyhow::Result<Exit> {
    let (split, usual) = match arguments.seeds.as_str() {
        "train" => (Split::Train, TEST_PAIRS),
        "test" => (Split::Test, TEST_PAIRS),
        _ => (Split::Validation, VALIDATION_PAIRS),
    };
    let count = arguments.count.unwrap_or(usual);
    let bar = printer.progress(4 * count as u64, "pairs");
    let drawn = draw(split, count, arguments.candidates, &|pairs| {
        bar.set_position(pairs as u64);
    })?;
    bar.finish_and_clear();
    let mut refused = BTreeMap::<_, usize>::new();
    for ((kind, why, scenario_type), count) in &drawn.refused {
        printer.detail(format!(
            "{kind}, {scenario_type}: {count} candidates are no pairs: {why}"
        ));
        *refused.entry((kind, why)).or_default() += count;
    }
    for ((kind, why), count) in refused {
        printer.note(format!("{kind}: {count} candidates are no pairs: {why}"));
    }
    printer.line(list_text(split, count, &drawn.pairs).trim_end());
    if printer.is_json() {
        printer.json(
            &json!({"pairs": drawn.pairs.iter().map(ToString::to_string).collect::<Vec<_>>()}),
        )?;
    }
    Ok(Exit::Success)
}
