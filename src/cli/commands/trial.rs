//! The process that tries the files of a model, within limits.

use crate::Exit;
use anyhow::Context;
use planagent_mllm::trial::{TrialRequest, exercise, limit_this_process};
use std::io::{self, BufRead, Read};

/// Longest request, bytes: paths and the built-in prompts.
const MAX_REQUEST_BYTES: u64 = 4 << 20;

/// Tries the files of the request on stdin.
pub(crate) fn run() -> anyhow::Result<Exit> {
    limit_this_process().context("cannot limit memory and time")?;
    let mut line = String::new();
    io::stdin()
        .lock()
        .take(MAX_REQUEST_BYTES)
        .read_line(&mut line)
        .context("cannot read the request")?;
    let request: TrialRequest =
        serde_json::from_str(&line).context("the request is none of this program's")?;
    exercise(&request, &mut io::stdout().lock()).context("cannot write to stdout")?;
    Ok(Exit::Success)
}
