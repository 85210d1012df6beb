//! The child process: its limits, and what it says.

use super::TrialRequest;
use planagent_child::BoundChild;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Memory of the child process, bytes of address space. The tokenizer of 262 thousand tokens takes
/// a third of it.
const MAX_MEMORY: u64 = 2 << 30;
/// CPU time of the child process, seconds. Its start and the tokenizers of published models take
/// about two.
const MAX_CPU_S: u64 = 8;
/// Wall time of the child process, which a machine under load may need.
const MAX_TIME: Duration = Duration::from_secs(13);
/// Bytes that are read of each of its outputs.
const MAX_OUTPUT: u64 = 64 << 10;
/// Lines at the end of stderr that an error shows.
const MAX_STDERR_LINES: usize = 3;
/// Time between two looks at the child process.
const PAUSE: Duration = Duration::from_millis(5);

/// A line of the child process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Line {
    /// It begins with this part of the files.
    Tries(String),
    /// It is done. The files cannot be opened for this reason; none if they can.
    Done(Option<String>),
}

/// Limits the memory and the CPU time of this process, where the system has such limits. A process
/// that exceeds them is ended.
#[cfg(unix)]
pub fn limit_this_process() -> io::Result<()> {
    use rustix::process::{Resource, Rlimit, setrlimit};
    // At the lower limit of the CPU time a signal says what happened; at the higher one the process
    // is killed.
    let limits = [
        (Resource::As, MAX_MEMORY, MAX_MEMORY),
        (Resource::Cpu, MAX_CPU_S, MAX_CPU_S + 1),
        (Resource::Core, 0, 0),
    ];
    for (resource, current, maximum) in limits {
        setrlimit(
            resource,
            Rlimit {
                current: Some(current),
                maximum: Some(maximum),
            },
        )?;
    }
    Ok(())
}

/// Limits nothing: this system has no such limits. The time is limited by the process that waits.
#[cfg(not(unix))]
pub fn limit_this_process() -> io::Result<()> {
    Ok(())
}

/// Runs the child process. Gives why the files cannot be opened, none if they can.
///
/// # Errors
/// When the child process exceeded a limit, panicked or could not be started.
pub(super) fn run(
    program: &Path,
    arguments: &[String],
    request: &TrialRequest,
) -> Result<Option<String>, String> {
    let failed = |error: io::Error| format!("the process that tries the files cannot run: {error}");
    let mut text = serde_json::to_vec(request).map_err(|error| failed(error.into()))?;
    text.push(b'\n');
    let mut command = Command::new(program);
    command
        .args(arguments)
        .env("RUST_BACKTRACE", "0")
        // The program may run inside Python, whose numpy takes address space for each core.
        .env("OPENBLAS_NUM_THREADS", "1")
        .env("OMP_NUM_THREADS", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = BoundChild::spawn(&mut command).map_err(failed)?;
    let child = child.process();
    let (stdout, stderr) = (reader(child.stdout.take()), reader(child.stderr.take()));
    if let Some(mut stdin) = child.stdin.take() {
        // A child that reads nothing must not block this thread.
        thread::spawn(move || stdin.write_all(&text));
    }
    let ended = wait(child).map_err(failed)?;
    planagent_child::wait_if_ending();
    let lines: Vec<Line> = stdout
        .recv()
        .unwrap_or_default()
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect();
    match lines.last() {
        Some(Line::Done(problem)) if ended.is_some_and(|status| status.success()) => {
            return Ok(problem.clone());
        }
        _ => {}
    }
    let tried = lines.iter().rev().find_map(|line| match line {
        Line::Tries(what) => Some(what.as_str()),
        Line::Done(_) => None,
    });
    let what = tried.unwrap_or("the model");
    Err(match ended {
        None => format!(
            "{what} took more than {} s when a child process tried it",
            MAX_TIME.as_secs()
        ),
        Some(status) if is_cpu_limit(status) => {
            format!("{what} took more than {MAX_CPU_S} s of CPU time when a child process tried it")
        }
        Some(status) => format!(
            "{what} ended the child process that tried it: {}",
            ending(status, &stderr)
        ),
    })
}

/// Whether the limit of the CPU time ended a process.
#[cfg(unix)]
fn is_cpu_limit(status: ExitStatus) -> bool {
    use std::os::unix::process::ExitStatusExt;
    status.signal() == Some(rustix::process::Signal::XCPU.as_raw())
}

/// This system has no limit of the CPU time.
#[cfg(not(unix))]
fn is_cpu_limit(_: ExitStatus) -> bool {
    false
}

/// How a child process ended, in words.
fn ending(status: ExitStatus, stderr: &Receiver<String>) -> String {
    let text = stderr.recv().unwrap_or_default();
    let lines: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|line| !is_noise(line))
        .collect();
    let last = lines[lines.len().saturating_sub(MAX_STDERR_LINES)..].join(" | ");
    let said = if last.is_empty() {
        String::new()
    } else {
        format!(", {last}")
    };
    format!(
        "{status}{said} (memory is limited to {} GiB)",
        MAX_MEMORY >> 30
    )
}

/// Lines of a panic that say nothing about it.
fn is_noise(line: &str) -> bool {
    line.is_empty() || line.starts_with("note: run with `RUST_BACKTRACE")
}

/// The status of a child process; none if it took too long and was killed.
fn wait(child: &mut Child) -> io::Result<Option<ExitStatus>> {
    let started = Instant::now();
    while started.elapsed() < MAX_TIME {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        thread::sleep(PAUSE);
    }
    child.kill()?;
    child.wait()?;
    Ok(None)
}

/// Reads the first bytes of a pipe and swallows the rest, so that the child process is not blocked.
fn reader(pipe: Option<impl Read + Send + 'static>) -> Receiver<String> {
    let (sender, receiver) = channel();
    if let Some(mut pipe) = pipe {
        thread::spawn(move || {
            let mut bytes = Vec::new();
            // What came before an error counts.
            let _ = (&mut pipe).take(MAX_OUTPUT).read_to_end(&mut bytes);
            let _ = sender.send(String::from_utf8_lossy(&bytes).into_owned());
            let _ = io::copy(&mut pipe, &mut io::sink());
        });
    }
    receiver
}
