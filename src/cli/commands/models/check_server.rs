//! `planagent models check` of a model that a server computes.

use crate::Printer;
use planagent_mllm::{MllmError, ModelRegistry, ModelSpec, Server};
use planagent_runs::runner::Config;
use serde::Serialize;

/// The check of a server.
#[derive(Debug, Serialize)]
pub(super) struct ServerRow<'a> {
    /// The model's name.
    model: &'a str,
    /// Address and model; none if the server could not be asked for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    server: Option<Server>,
    /// What is wrong; empty if the server can be used.
    pub(super) problems: Vec<String>,
}

/// Asks a server what a run would ask: at most two short questions.
pub(super) fn check<'a>(
    model: &'a str,
    spec: &ModelSpec,
    registry: &ModelRegistry,
    config: &Config,
    printer: Printer,
) -> ServerRow<'a> {
    let opened = registry.open(spec).and_then(|opened| {
        let generation = registry.asking_here(spec)?.generation;
        Ok((opened, generation))
    });
    let (opened, generation) = match opened {
        Ok(opened) => opened,
        Err(error) => return refused(model, None, &error),
    };
    let server = opened.describe().server;
    let question = generation.probe(config.environment.bev, config.reasoning.grammar);
    let on_wait = |text: &str| printer.note(format!("{model}: {text}"));
    match opened.probe(&question, &on_wait) {
        Ok(problems) => ServerRow {
            model,
            server,
            problems,
        },
        Err(error) => refused(model, server, &error),
    }
}

fn refused<'a>(model: &'a str, server: Option<Server>, error: &MllmError) -> ServerRow<'a> {
    ServerRow {
        model,
        server,
        problems: vec![error.to_string()],
    }
}

/// Prints the check.
pub(super) fn tell(row: &ServerRow<'_>, printer: Printer) {
    let state = match row.problems.len() {
        0 => "answers, and takes pictures and grammar as described".to_owned(),
        1 => "1 problem".to_owned(),
        count => format!("{count} problems"),
    };
    let place = row.server.as_ref().map_or_else(
        || "server".to_owned(),
        |server| format!("{} at {}", server.model, server.endpoint),
    );
    printer.line(format!("{}: {place}, {state}", row.model));
    for problem in &row.problems {
        printer.line(format!("  problem: {problem}"));
    }
}
