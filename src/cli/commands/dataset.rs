//! `planagent dataset`.

use crate::cli::args::DatasetArguments;
use crate::cli::{Config, Exit, Printer};
use crate::environment::BevView;
use crate::experiment::dataset::{Settings, Split, write_split};
use crate::reasoning::PromptSet;

/// Prompt set of datasets: that of the models which are trained on them.
const PROMPT_SET: &str = "compact";

/// Writes labelled states.
///
/// # Errors
/// When the folder cannot be written or holds another dataset.
pub(in crate::cli) fn run(flags: &DatasetArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let prompts = PromptSet::open(config.reasoning.prompt_set.as_deref().unwrap_or(PROMPT_SET))?;
    let view = BevView::new(BevView::default().pixels(), config.environment.view_m)?;
    let settings = Settings { seed: config.seed, prompts: &prompts, view };
    for (split, states) in [(Split::Train, flags.states), (Split::Validation, flags.validation)] {
        let bar = printer.progress(states as u64, "states");
        bar.set_message(split.as_str());
        let made = write_split(&flags.out, split, states, &settings, &|states| bar.inc(states as u64))?;
        bar.finish_and_clear();
        printer.note(format!("{}: {made} states", split.as_str()));
        if printer.is_json() {
            printer.json(&serde_json::json!({"split": split.as_str(), "states": made}))?;
        }
    }
    Ok(Exit::Success)
}
