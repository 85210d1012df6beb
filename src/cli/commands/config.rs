//! `planagent config`.

use crate::args::ConfigArguments;
use crate::explained::{COMMENTED, explanations};
use crate::settings::{Setting, Settings};
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_agent::reasoning::PromptSet;
use planagent_files::write_whole;
use planagent_mllm::MllmError;
use planagent_runs::report::table::terminal::{LineWidth, joined};
use planagent_runs::runner::{Config, model_registry, silent};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Column of the origins, behind values that leave room for it.
const ORIGIN: usize = 43;
/// What a comment begins with.
const COMMENT: &str = "# ";
/// The setting whose default depends on the model.
const PROMPT_SET: &str = "reasoning.prompt_set";
/// The origin of a setting that nothing replaced.
const DEFAULT: &str = "default";

/// The file that the program reads in the working directory.
const FILE: &str = "planagent.toml";

/// Prints every setting with its origin, as a configuration file, or writes the commented one.
pub(crate) fn run(
    flags: &ConfigArguments,
    settings: &Settings,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if flags.init {
        return init(printer);
    }
    let explained = if flags.explain {
        explanations()
    } else {
        BTreeMap::new()
    };
    let mut section = None;
    let mut last = None;
    for mut setting in settings.list()? {
        if setting.key == PROMPT_SET {
            setting.origin = prompts(&settings.config, &setting);
        }
        let about = explained.get(&setting.key);
        if printer.is_json() {
            printer.json(&Explained {
                setting: &setting,
                about,
            })?;
            continue;
        }
        let (own, key) = setting.key.split_once('.').unwrap_or(("", &setting.key));
        if section
            .replace(own.to_owned())
            .is_some_and(|before| before != own)
        {
            printer.line(format!("\n[{own}]"));
        }
        // Neighbors may share an explanation.
        if let Some(about) = about.filter(|about| last != Some(*about)) {
            for text in comment(about, printer.line_width()) {
                printer.line(text);
            }
        }
        last = about;
        for text in lines(key, &setting, printer.line_width()) {
            printer.line(text);
        }
    }
    Ok(Exit::Success)
}

/// A sentence in lines of comments.
fn comment(text: &str, width: LineWidth) -> Vec<String> {
    let words = text.split(' ').map(str::to_owned);
    let lines = joined(words, " ", width.columns() - COMMENT.len());
    lines
        .iter()
        .map(|line| format!("{COMMENT}{line}"))
        .collect()
}

/// Writes the commented file, and never over another one.
fn init(printer: Printer) -> anyhow::Result<Exit> {
    // Also a link that leads nowhere is the user's.
    if fs::symlink_metadata(FILE).is_ok() {
        bail!(
            "{FILE} exists and stays as it is; `planagent config --explain` prints what it may have"
        );
    }
    write_whole(Path::new(FILE), COMMENTED.as_bytes())
        .with_context(|| format!("cannot write {FILE}"))?;
    printer.line(FILE);
    Ok(Exit::Success)
}

/// A setting with what it means, if that is asked for.
#[derive(Serialize)]
struct Explained<'a> {
    #[serde(flatten)]
    setting: &'a Setting,
    #[serde(skip_serializing_if = "Option::is_none")]
    about: Option<&'a String>,
}

/// A setting with its origin beside it, or above it where a terminal is too narrow.
fn lines(key: &str, Setting { value, origin, .. }: &Setting, width: LineWidth) -> Vec<String> {
    let assigned = match value {
        Some(value) => format!("{key} = {value}"),
        None if origin == DEFAULT => return vec![format!("# {key} is not set")],
        None => format!("# {key} is not set"),
    };
    let line = format!("{assigned:<ORIGIN$} # {origin}");
    if width == LineWidth::PIPE || line.chars().count() <= width.columns() {
        return vec![line];
    }
    let mut above = comment(origin, width);
    above.push(assigned);
    above
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
