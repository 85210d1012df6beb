//! `planagent scenarios list`: a scenario after the other, as far as it is known without opening it.

use super::{About, Told};
use crate::cli::args::SplitArguments;
use crate::cli::{Exit, Printer};
use crate::experiment::nuplan_data::NuPlanData;
use crate::experiment::source::{ScenarioSource, SourceError, recordings_in};
use crate::experiment::split::split;
use crate::scenario::generator::{ScenarioType, Spec};
use crate::scenario::nuplan::LogScenario;
use crate::scenario::{UNKNOWN_TYPE, argoverse2, womd};
use crate::world::STEP_S;
use anyhow::anyhow;
use serde::Serialize;
use serde_json::json;
use std::path::Path;

impl About {
    fn generated(spec: &Spec, source: String) -> Self {
        let (id, scenario_type, log_name) = (spec.to_string(), spec.scenario_type.to_string(), spec.log_name());
        Self { id, source, scenario_type, log_name, iterations: None, lanes: None }
    }

    fn nuplan(found: &LogScenario, source: String) -> Self {
        let (id, scenario_type, log_name) =
            (found.token.to_string(), found.scenario_type.clone(), found.log.name.clone());
        Self { id, source, scenario_type, log_name, iterations: None, lanes: None }
    }

    /// Of a recording as its summary counts it.
    fn recording(id: String, source: String, log_name: String, [iterations, lanes]: [usize; 2]) -> Self {
        let scenario_type = UNKNOWN_TYPE.to_owned();
        Self { id, source, scenario_type, log_name, iterations: Some(iterations), lanes: Some(lanes) }
    }
}

/// What a recording holds, beside what is told of every scenario.
#[derive(Debug, Clone, Copy, Serialize)]
struct Recorded {
    /// Its place in a file of several, from 0.
    record: Option<usize>,
    /// Steps at 10 Hz.
    steps: usize,
    /// Objects.
    tracks: usize,
}

/// Lists what the words and splits name, without either the types that can be generated.
///
/// # Errors
/// When a word names nothing, or a source cannot be read.
pub(super) fn run(words: &[String], flags: &SplitArguments, printer: Printer) -> anyhow::Result<Exit> {
    if words.is_empty() && flags.splits.is_empty() {
        return list_types(printer);
    }
    let data = flags.data.data();
    let mut complete = list_splits(&flags.splits, &data, printer)?;
    for word in words {
        complete &= list(word, &data, printer)?;
    }
    for note in data.take_notes() {
        printer.note(note);
    }
    Ok(if complete { Exit::Success } else { Exit::SomeFailed })
}

fn list_types(printer: Printer) -> anyhow::Result<Exit> {
    printer.note("types of generated scenarios; name one as generated/TYPE/SEED or generated/TYPE/SEED.TRAFFIC");
    for scenario_type in ScenarioType::ALL {
        list_found(&ScenarioSource::Generated(Spec::new(scenario_type, 0)), None, printer)?;
    }
    Ok(Exit::Success)
}

/// Says whether all scenarios of the splits are there and all logs can be read.
fn list_splits(names: &[String], data: &NuPlanData, printer: Printer) -> anyhow::Result<bool> {
    let mut complete = true;
    for name in names {
        let found = split(name, data, &|_, _| {})?;
        for source in found.sources {
            complete &= list_found(&source, Some(name), printer)?;
        }
        for note in found.notes {
            printer.note(format!("{name}: {note}"));
        }
        if !found.missing.is_empty() {
            printer.error(&anyhow!("{}", found.missing));
            complete = false;
        }
    }
    Ok(complete)
}

/// Says whether all of it can be read.
fn list(word: &str, data: &NuPlanData, printer: Printer) -> anyhow::Result<bool> {
    if ScenarioSource::names_generated(word) {
        return list_found(&ScenarioSource::Generated(word.parse()?), None, printer);
    }
    let of_nuplan = ScenarioSource::of_nuplan(word, data)?;
    let mut readable = true;
    for found in &of_nuplan {
        readable &= list_found(found, None, printer)?;
    }
    if NuPlanData::names_log(word) {
        return Ok(readable);
    }
    let path = Path::new(word);
    if !path.exists() {
        return Err(SourceError::Missing(path.to_owned()).into());
    }
    if argoverse2::is_log(path) {
        list_log(path, printer)?;
        return Ok(readable);
    }
    let logs = if path.is_dir() { argoverse2::logs_in(path)? } else { Vec::new() };
    for log in &logs {
        list_log(log, printer)?;
    }
    let files = if path.is_dir() { recordings_in(path)? } else { vec![path.to_owned()] };
    if files.is_empty() && logs.is_empty() && of_nuplan.is_empty() {
        return Err(SourceError::Empty(path.to_owned()).into());
    }
    files.iter().try_for_each(|file| list_records(file, printer))?;
    Ok(readable)
}

/// A scenario that was found. Says whether it can be read, as far as that is known.
fn list_found(source: &ScenarioSource, split: Option<&str>, printer: Printer) -> anyhow::Result<bool> {
    let name = source.to_string();
    let about = match source {
        ScenarioSource::Generated(spec) => About::generated(spec, name),
        ScenarioSource::NuPlan { found, .. } => About::nuplan(found, name),
        ScenarioSource::Recording { path, .. } => return list_records(path, printer).map(|()| true),
        ScenarioSource::Argoverse2(folder) => return list_log(folder, printer).map(|()| true),
        ScenarioSource::Unreadable { cause, .. } => {
            printer.error(&anyhow!("{cause}"));
            return Ok(false);
        }
    };
    // The name of a generated scenario holds its type.
    let details = if about.source == about.id { "" } else { &about.scenario_type };
    printer.named(&about.source, details);
    if printer.is_json() {
        printer.json(&Told { about, more: json!({"split": split}) })?;
    }
    Ok(true)
}

fn list_records(file: &Path, printer: Printer) -> anyhow::Result<()> {
    let log_name = womd::log_name(file);
    for summary in womd::summaries(file)? {
        let womd::Summary { id, record, steps, iterations, tracks, lanes } = summary?;
        let source = ScenarioSource::Recording { path: file.to_owned(), record }.to_string();
        let about = About::recording(id, source, log_name.clone(), [iterations, lanes]);
        list_recording(about, Recorded { record: Some(record), steps, tracks }, printer)?;
    }
    Ok(())
}

fn list_log(folder: &Path, printer: Printer) -> anyhow::Result<()> {
    let argoverse2::Summary { id, steps, iterations, tracks, lanes } = argoverse2::summary(folder)?;
    let source = ScenarioSource::Argoverse2(folder.to_owned()).to_string();
    let about = About::recording(id.clone(), source, id, [iterations, lanes]);
    list_recording(about, Recorded { record: None, steps, tracks }, printer)
}

fn list_recording(about: About, recorded: Recorded, printer: Printer) -> anyhow::Result<()> {
    let Recorded { steps, tracks, .. } = recorded;
    let driven = about.iterations.unwrap_or(0).saturating_sub(1) as f64 * STEP_S;
    let lanes = about.lanes.unwrap_or(0);
    let counts = format!("{steps:>4} steps  {driven:>5.1} s driven  {tracks:>4} tracks  {lanes:>4} lanes");
    // Most files and folders are named by what they hold.
    let details = if about.source.contains(&about.id) { counts } else { format!("{counts}  {}", about.id) };
    printer.named(&about.source, &details);
    if printer.is_json() {
        printer.json(&Told { about, more: recorded })?;
    }
    Ok(())
}
