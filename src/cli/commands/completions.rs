//! `planagent completions`.

use crate::args::Arguments;
use crate::{Exit, Printer};
use clap::CommandFactory;
use clap_complete::{Shell, generate};

/// Prints the script that completes commands in a shell.
pub(crate) fn run(shell: Shell, printer: Printer) -> anyhow::Result<Exit> {
    let mut command = Arguments::command();
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    generate(shell, &mut command, name, &mut script);
    printer.text(String::from_utf8(script)?.trim_end());
    Ok(Exit::Success)
}
