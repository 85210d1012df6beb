//! `planagent dataset`.

use crate::cli::args::DatasetArguments;
use crate::cli::progress::listener;
use crate::cli::{Exit, Printer};
use crate::environment::BevView;
use crate::experiment::dataset::{Settings, Split, write_split};
use crate::reasoning::PromptSet;
use crate::runner::{Config, load_model};
use anyhow::bail;

/// Prompt set of datasets: that of the models that are trained on them.
const PROMPT_SET: &str = "compact";

/// Writes labeled states.
pub(in crate::cli) fn run(flags: &DatasetArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    if flags.out.is_file() {
        bail!("--out {}: this is a file and no folder", flags.out.display());
    }
    let prompts = PromptSet::open(config.reasoning.prompt_set.as_deref().unwrap_or(PROMPT_SET))?;
    let view = BevView::new(BevView::default().pixels(), config.environment.view_m)?;
    let loaded = if flags.driven { Some(load_model(config, &listener(printer))?) } else { None };
    let driver = loaded.as_ref().map(|loaded| loaded.agent_parts(config));
    let settings = Settings { seed: config.seed, prompts: &prompts, view, driver: driver.as_ref() };
    let splits = [(Split::Train, flags.states), (Split::Validation, flags.validation)];
    for (split, states) in splits.into_iter().filter(|(split, _)| *split == Split::Train || !flags.driven) {
        let bar = printer.progress(states as u64, "states");
        bar.set_message(split.as_str());
        let written = write_split(&flags.out, split, states, &settings, &|states| bar.inc(states as u64))?;
        bar.finish_and_clear();
        printer.note(format!("{}: {written} states", split.as_str()));
        if printer.is_json() {
            printer.json(&serde_json::json!({"split": split.as_str(), "states": written}))?;
        }
    }
    Ok(Exit::Success)
}
