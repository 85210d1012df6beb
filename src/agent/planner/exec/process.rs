//! The process of a planner command: lines in, lines out, each within a time.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Longest line that a command may write, bytes.
const MAX_LINE: u64 = 16 << 20;
/// Lines of the command's stderr that an error shows.
const MAX_STDERR_LINES: usize = 3;
/// Longest shown line of stderr, characters.
const MAX_STDERR_CHARS: usize = 300;
/// How long to wait for the exit status of a command that closed its output.
const EXIT_WAIT: Duration = Duration::from_secs(1);
/// Time between two looks at the exit status.
const EXIT_POLL: Duration = Duration::from_millis(5);

/// Why a command gives no line.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ProcessError {
    #[error("the command cannot be started: {0}")]
    Start(std::io::Error),
    #[error("the command gave no answer within {} s{stderr}", within.as_secs_f64())]
    Silent { within: Duration, stderr: String },
    #[error("the command ended{status}{stderr}")]
    Ended { status: String, stderr: String },
    #[error("the command wrote a line of more than {MAX_LINE} bytes")]
    LongLine,
    #[error("the command's output cannot be read: {0}")]
    Read(std::io::Error),
}

/// A running command. It is ended with all processes of its group when this is dropped.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    /// Lines for stdin. A thread writes them, because a command that reads nothing would block the
    /// writer.
    input: Sender<Vec<u8>>,
    output: Receiver<Result<Vec<u8>, ProcessError>>,
    stderr: Arc<Mutex<VecDeque<String>>>,
    /// Disconnected when stderr has ended.
    stderr_end: Receiver<()>,
}

impl Process {
    /// Starts a command of the shell in a process group of its own.
    pub(super) fn start(command: &str) -> Result<Self, ProcessError> {
        let mut shell = shell(command);
        shell
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = shell.spawn().map_err(ProcessError::Start)?;
        let (input, lines) = channel::<Vec<u8>>();
        if let Some(mut stdin) = child.stdin.take() {
            // The thread ends with the command, or when the sender is dropped; then stdin is
            // closed.
            thread::spawn(move || {
                for line in lines {
                    if stdin.write_all(&line).and_then(|()| stdin.flush()).is_err() {
                        return;
                    }
                }
            });
        }
        let (sender, output) = channel();
        if let Some(stdout) = child.stdout.take() {
            thread::spawn(move || send_lines(stdout, &sender));
        }
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        let (at_end, stderr_end) = channel();
        if let Some(pipe) = child.stderr.take() {
            let kept = Arc::clone(&stderr);
            thread::spawn(move || {
                keep_last_lines(pipe, &kept);
                drop(at_end);
            });
        }
        Ok(Self {
            child,
            input,
            output,
            stderr,
            stderr_end,
        })
    }

    /// Writes a line and gives the line that answers it.
    pub(super) fn ask(
        &mut self,
        mut line: Vec<u8>,
        within: Duration,
    ) -> Result<Vec<u8>, ProcessError> {
        line.push(b'\n');
        // A closed channel means that the command has ended; the answer says so.
        let _ = self.input.send(line);
        match self.output.recv_timeout(within) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => Err(ProcessError::Silent {
                within,
                stderr: self.last_words(),
            }),
            Err(RecvTimeoutError::Disconnected) => {
                let status = self.status();
                // What a command writes before its end may still be on its way; a process that it
                // left may keep stderr open.
                let _ = self.stderr_end.recv_timeout(EXIT_WAIT);
                Err(ProcessError::Ended {
                    status,
                    stderr: self.last_words(),
                })
            }
        }
    }

    /// The exit status in words, if the command ends soon.
    fn status(&mut self) -> String {
        let started = Instant::now();
        while started.elapsed() < EXIT_WAIT {
            if let Ok(Some(status)) = self.child.try_wait() {
                return format!(" ({status})");
            }
            thread::sleep(EXIT_POLL);
        }
        String::new()
    }

    /// The last lines of stderr in words.
    fn last_words(&self) -> String {
        let lines = self.stderr.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.is_empty() {
            return String::new();
        }
        format!(
            "; its stderr ends with: {}",
            lines.iter().cloned().collect::<Vec<_>>().join(" | ")
        )
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        end_group(&mut self.child);
        // Takes the exit status, so that no zombie stays. The process is dead, or another user's
        // and not ours to wait for.
        let _ = self.child.wait();
    }
}

#[cfg(unix)]
fn shell(command: &str) -> Command {
    use std::os::unix::process::CommandExt;
    let mut shell = Command::new("sh");
    shell.args(["-c", command]).process_group(0);
    shell
}

#[cfg(not(unix))]
fn shell(command: &str) -> Command {
    let mut shell = Command::new("cmd");
    shell.args(["/C", command]);
    shell
}

/// Kills the command and all that it started.
#[cfg(unix)]
fn end_group(child: &mut Child) {
    // The group has the id of its first process, which is not reaped before this.
    let _ = rustix::process::kill_process_group(
        rustix::process::Pid::from_child(child),
        rustix::process::Signal::KILL,
    );
}

/// Kills the command.
#[cfg(not(unix))]
fn end_group(child: &mut Child) {
    let _ = child.kill();
}

/// Sends each line of a command's output; ends with the output or the receiver.
fn send_lines(output: impl Read, sender: &Sender<Result<Vec<u8>, ProcessError>>) {
    let mut reader = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let sent = match (&mut reader).take(MAX_LINE).read_until(b'\n', &mut line) {
            Ok(0) => return,
            Ok(length) if length as u64 == MAX_LINE && line.last() != Some(&b'\n') => {
                let _ = sender.send(Err(ProcessError::LongLine));
                return;
            }
            Ok(_) => sender.send(Ok(line)),
            Err(error) => {
                let _ = sender.send(Err(ProcessError::Read(error)));
                return;
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

/// Keeps the last lines of a command's stderr.
fn keep_last_lines(pipe: impl Read, kept: &Mutex<VecDeque<String>>) {
    let mut reader = BufReader::new(pipe);
    loop {
        let mut line = Vec::new();
        match (&mut reader).take(MAX_LINE).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {
                let text: String = String::from_utf8_lossy(&line)
                    .trim()
                    .chars()
                    .take(MAX_STDERR_CHARS)
                    .collect();
                let mut lines = kept.lock().unwrap_or_else(PoisonError::into_inner);
                if !text.is_empty() {
                    lines.push_back(text);
                }
                if lines.len() > MAX_STDERR_LINES {
                    lines.pop_front();
                }
            }
        }
    }
}
