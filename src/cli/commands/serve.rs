//! `planagent serve`.

use crate::args::ServeArguments;
use crate::interrupt::PAUSE;
use crate::{Exit, Printer};
use anyhow::Context;
use planagent_runs::report::last_run;
use planagent_runs::report::page::LivePage;
use planagent_runs::report::serve::Server;
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// Serves the page of one or more runs until Ctrl-C.
pub(crate) fn run(flags: &ServeArguments, printer: Printer) -> anyhow::Result<Exit> {
    let mut runs = flags.runs.clone();
    if runs.is_empty() {
        runs.push(last_run()?);
    }
    let bar = printer.progress(0, "simulations");
    let opened = LivePage::open(&runs, &|done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let page = opened?;
    let (done, planned) = page.state().counts();
    let server = Server::bind(page, flags.port)?;
    let ended = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        flag::register(signal, Arc::clone(&ended)).context("cannot wait for Ctrl-C")?;
    }
    let address = format!("http://{}/", server.address());
    if printer.is_json() {
        printer.json(&json!({ "address": address }))?;
    } else {
        printer.line(&address);
    }
    printer
        .note(format!("{done} of {planned} simulations; the page shows more as they finish. Ctrl-C ends the server"));
    if flags.open
        && let Err(error) = open::that_detached(&address)
    {
        printer.note(format!("cannot open a browser: {error}"));
    }
    let stopper = server.stopper();
    thread::scope(|scope| {
        scope.spawn(move || server.run());
        // A signal handler may do no more than set a flag, so this thread looks at it.
        while !ended.load(Ordering::Relaxed) {
            thread::sleep(PAUSE);
        }
        stopper.stop();
    });
    Ok(Exit::Success)
}
