//! `planagent models list`.

use super::check::reason;
use crate::cli::{Exit, Printer};
use crate::mllm::{ModelRegistry, ModelSource, in_bytes};
use crate::reasoning::PromptSet;
use serde::Serialize;
use std::path::PathBuf;

/// Origin of what the program itself holds.
const BUILT_IN: &str = "built in";

/// A described model.
#[derive(Debug, Default, Serialize)]
struct Row {
    /// Its name for `--model`.
    model: String,
    /// Its family; none if its files decide.
    family: Option<&'static str>,
    /// Where it comes from.
    source: Option<String>,
    /// Whether it runs on a server.
    server: bool,
    /// Where its files are on this machine.
    place: Option<PathBuf>,
    /// Bytes of its weight files.
    bytes: Option<u64>,
    /// Why it cannot be used.
    problem: Option<String>,
    /// Its description: a file, or `built in`.
    description: Option<String>,
    /// Its prompt set.
    prompt_set: Option<String>,
    /// Where the templates of its prompt set are: a folder, or `built in`.
    prompts: Option<String>,
}

/// Lists the described models.
pub(super) fn run(registry: &ModelRegistry, csv: bool, printer: Printer) -> anyhow::Result<Exit> {
    let rows = registry.names()?.into_iter().map(|name| row(name, registry));
    if csv {
        printer.csv(&rows.collect::<Vec<_>>())?;
        return Ok(Exit::Success);
    }
    for row in rows {
        if printer.is_json() {
            printer.json(&row)?;
            continue;
        }
        let state = match (row.bytes, &row.source) {
            (Some(bytes), _) => in_bytes(bytes),
            _ if row.server => "server".to_owned(),
            (None, Some(_)) => "not here".to_owned(),
            (None, None) => "broken".to_owned(),
        };
        let set = row.prompt_set.as_deref().unwrap_or("-");
        let line = format!("{:<22} {:<10} {state:>9}  {set:<7}", row.model, row.family.unwrap_or("-"));
        let last = origin(&row);
        // The last field is often copied: on a narrow terminal it has a line of its own.
        printer.named(line.trim_end(), &last);
    }
    Ok(Exit::Success)
}

/// Where a model, its description and its prompts come from.
fn origin(row: &Row) -> String {
    let Some(source) = &row.source else { return row.problem.clone().unwrap_or_default() };
    let mut text = source.clone();
    if let Some(file) = row.description.as_ref().filter(|file| *file != BUILT_IN) {
        text = format!("{text}, described in {file}");
    }
    match &row.prompts {
        Some(folder) if folder != BUILT_IN => format!("{text}, prompts in {folder}"),
        _ => text,
    }
}

/// Where the templates of a prompt set are, or why they cannot be used.
fn prompts(name: &str) -> String {
    PromptSet::open(name).map_or_else(|error| error.to_string(), |set| set.place().to_string())
}

fn row(name: String, registry: &ModelRegistry) -> Row {
    let spec = match registry.find(&name) {
        Ok(spec) => spec,
        Err(error) => return Row { model: name, problem: Some(error.to_string()), ..Row::default() },
    };
    let family = spec.architecture.map(crate::mllm::Architecture::name);
    let description =
        registry.description(&name).map_or_else(|| BUILT_IN.to_owned(), |path| path.display().to_string());
    let prompt_set = registry.asking_here(&spec).ok().map(|asking| asking.prompt_set);
    let row = Row {
        family,
        source: Some(spec.source.to_string()),
        description: Some(description),
        prompts: prompt_set.as_deref().map(prompts),
        prompt_set,
        ..Row::default()
    };
    let row = Row { model: name, ..row };
    if matches!(spec.source, ModelSource::Endpoint(_)) {
        return Row { server: true, ..row };
    }
    match registry.place_here(&spec).and_then(|place| Ok((place.weight_bytes()?, place))) {
        Ok((bytes, place)) => Row { place: Some(place.path().to_path_buf()), bytes: Some(bytes), ..row },
        Err(error) => Row { problem: Some(reason(&error, &row.model)), ..row },
    }
}
