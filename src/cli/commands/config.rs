//! `planagent config`.

use crate::settings::{Setting, Settings};
use crate::{Exit, Printer};
use planagent_agent::reasoning::PromptSet;
use planagent_mllm::MllmError;
use planagent_runs::runner::{Config, model_registry, silent};

/// Column of the origins, behind values that leave room for it.
const ORIGIN: usize = 43;
/// The setting whose default depends on the model.
const PROMPT_SET: &str = "reasoning.prompt_set";
/// The origin of a setting that nothing replaced.
const DEFAULT: &str = "default";

/// Prints every setting with its origin, as a configuration file.
pub(crate) fn run(settings: &Settings, printer: Printer) -> anyhow::Result<Exit> {
    let mut section = None;
    for mut setting in settings.list()? {
        if setting.key == PROMPT_SET {
            setting.origin = prompts(&settings.config, &setting);
        }
        if printer.is_json() {
            printer.json(&setting)?;
            continue;
        }
        let (own, key) = setting.key.split_once('.').unwrap_or(("", &setting.key));
        if section
            .replace(own.to_owned())
            .is_some_and(|before| before != own)
        {
            printer.line(format!("\n[{own}]"));
        }
        printer.line(line(key, &setting));
    }
    Ok(Exit::Success)
}

fn line(key: &str, Setting { value, origin, .. }: &Setting) -> String {
    match value {
        Some(value) => format!("{:<ORIGIN$} # {origin}", format!("{key} = {value}")),
        None if origin == DEFAULT => format!("# {key} is not set"),
        None => format!("{:<ORIGIN$} # {origin}", format!("# {key} is not set")),
    }
}

/// What names the prompt set of the configured model, and where its templates are.
fn prompts(config: &Config, setting: &Setting) -> String {
    let (name, named_by) = if let Some(name) = &config.reasoning.prompt_set {
        (name.clone(), setting.origin.clone())
    } else {
        let registry = model_registry(config, &silent());
        match registry
            .find(&config.mllm.model)
            .and_then(|spec| registry.asking_here(&spec))
        {
            Ok(asking) => (
                asking.prompt_set.clone(),
                format!("{} ({})", asking.prompt_set, asking.named_by),
            ),
            Err(MllmError::NotInCache { .. }) => {
                return "the model is not on this machine".to_owned();
            }
            Err(error) => return error.to_string(),
        }
    };
    match PromptSet::open(&name) {
        Ok(set) => format!("{named_by}: {}", set.place()),
        Err(error) => format!("{named_by}: {error}"),
    }
}
