//! `planagent models list`.

use crate::cli::{Exit, Printer};
use crate::mllm::{ModelRegistry, ModelSource, in_bytes};
use serde::Serialize;
use std::path::PathBuf;

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
        let last = row.source.or(row.problem).unwrap_or_default();
        let line = format!("{:<22} {:<10} {state:>9}", row.model, row.family.unwrap_or("-"));
        // The last field is often copied: on a narrow terminal it has a line of its own.
        printer.named(line.trim_end(), &last);
    }
    Ok(Exit::Success)
}

fn row(name: String, registry: &ModelRegistry) -> Row {
    let spec = match registry.find(&name) {
        Ok(spec) => spec,
        Err(error) => return Row { model: name, problem: Some(error.to_string()), ..Row::default() },
    };
    let family = spec.architecture.map(crate::mllm::Architecture::name);
    let row = Row { model: name, family, source: Some(spec.source.to_string()), ..Row::default() };
    if matches!(spec.source, ModelSource::Endpoint(_)) {
        return Row { server: true, ..row };
    }
    match registry.place_here(&spec).and_then(|place| Ok((place.weight_bytes()?, place))) {
        Ok((bytes, place)) => Row { place: Some(place.path().to_path_buf()), bytes: Some(bytes), ..row },
        Err(error) => Row { problem: Some(error.to_string()), ..row },
    }
}
