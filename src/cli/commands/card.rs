//! `planagent card`.

use crate::args::CardArguments;
use crate::progress::listener;
use crate::{Exit, Printer, interrupt};
use planagent_lab::card::{CARD_PAGE, CardRequest, card_text, make};
use planagent_runs::report::failures;
use planagent_runs::runner::Config;
use std::path::{Path, PathBuf};

/// Folder of cards.
const CARDS: &str = "runs/cards";

/// Makes the card of a model; its tables go to stdout.
pub(crate) fn run(
    flags: &CardArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    interrupt::advise("the same command goes on", printer)?;
    let folder = || Path::new(CARDS).join(folder_name(&config.mllm.model));
    let request = CardRequest {
        out: flags.out.clone().unwrap_or_else(folder),
        limit: flags.limit,
        latency_of: flags.latency_of.clone(),
        retry_failed: flags.retry_failed,
    };
    let made = make(&request, config, &listener(printer))?;
    if printer.is_json() {
        printer.json(&made.json)?;
    } else {
        printer.table(card_text(&made.sections, printer.line_width()));
    }
    let page: PathBuf = request.out.join(CARD_PAGE);
    printer.note(format!("card: {}", page.display()));
    // What failed comes last, where a person at a terminal looks first.
    for line in failures(&made.failed) {
        printer.failure(format!("failed: {line}"));
    }
    if made.unanswered > 0 {
        printer.failure(format!(
            "{} questions got no answer; calls.jsonl of the runs says why",
            made.unanswered
        ));
    }
    let succeeded = made.failed.is_empty() && made.unanswered == 0;
    Ok(if succeeded {
        Exit::Success
    } else {
        Exit::SomeFailed
    })
}

/// The name of a model's folder: the last part of a path or an address, without odd characters.
fn folder_name(model: &str) -> String {
    let last = model.trim_end_matches(['/', '\\']);
    let last = last.rsplit_once(['/', '\\']).map_or(last, |(_, last)| last);
    let safe = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let name: String = last
        .chars()
        .map(|c| if safe(c) { c } else { '-' })
        .collect();
    let name = name.trim_start_matches('.');
    if name.is_empty() {
        "model".to_owned()
    } else {
        name.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_the_name_of_the_model() {
        for (model, name) in [
            ("nano", "nano"),
            ("org/Model-1B", "Model-1B"),
            ("a/b/model.gguf", "model.gguf"),
            ("http://127.0.0.1:8080/v1/", "v1"),
            ("..", "model"),
            ("org/name:Q4_K_M", "name-Q4_K_M"),
        ] {
            assert_eq!(folder_name(model), name);
        }
    }
}
