//! `planagent config`.

use crate::cli::settings::{Setting, Settings};
use crate::cli::{Exit, Printer};

/// Column of the origins, behind values that leave room for it.
const ORIGIN: usize = 43;

/// Prints every setting with its origin, as a configuration file.
pub(in crate::cli) fn run(settings: &Settings, printer: Printer) -> anyhow::Result<Exit> {
    let mut section = None;
    for setting in settings.list()? {
        if printer.is_json() {
            printer.json(&setting)?;
            continue;
        }
        let (own, key) = setting.key.split_once('.').unwrap_or(("", &setting.key));
        if section.replace(own.to_owned()).is_some_and(|before| before != own) {
            printer.line(format!("\n[{own}]"));
        }
        printer.line(line(key, &setting));
    }
    Ok(Exit::Success)
}

fn line(key: &str, Setting { value, origin, .. }: &Setting) -> String {
    match value {
        Some(value) => format!("{:<ORIGIN$} # {origin}", format!("{key} = {value}")),
        None => format!("# {key} is not set"),
    }
}
