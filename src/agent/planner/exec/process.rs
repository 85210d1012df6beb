//! The process of a planner command: lines in, lines out, each within a time.

use super::answer::beginning;
use crate::planner::StopSwitch;
use planagent_child::BoundChild;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
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
/// Time between two looks at the switch of the run.
const STOP_POLL: Duration = Duration::from_millis(20);
/// Time between two looks at the exit status.
const EXIT_POLL: Duration = Duration::from_millis(5);
/// Messages after the first before which a line that answers none is waited for, and how long.
const SETTLING: usize = 3;
const SETTLE_WAIT: Duration = Duration::from_millis(20);
/// How long a command may write after its last answer, until it ends at the end of its stdin.
const END_WAIT: Duration = Duration::from_millis(500);

/// Why a command gives no line.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ProcessError {
    #[error("the command cannot be started: {0}")]
    Start(std::io::Error),
    #[error("the command gave no answer within {} s{stderr}", within.as_secs_f64())]
    Silent { within: Duration, stderr: String },
    #[error("the run was stopped")]
    Stopped,
    #[error("the command ended{status}{stderr}")]
    Ended { status: String, stderr: String },
    #[error("the command wrote a line of more than {MAX_LINE} bytes")]
    LongLine,
    #[error(
        "the command wrote a line that answers no message; it must read a message and then write one line: {line}"
    )]
    Unasked { line: String },
    #[error(
        "the command wrote a line after the answer to its last message; it must write one line for each message: {line}"
    )]
    AfterEnd { line: String },
    #[error("the command's output cannot be read: {0}")]
    Read(std::io::Error),
}

/// A running command. It is ended with all processes of its group when this is dropped, and with
/// the program.
#[derive(Debug)]
pub(super) struct Process {
    child: BoundChild,
    /// Lines for stdin. A thread writes them, because a command that reads nothing would block the
    /// writer.
    input: Sender<Vec<u8>>,
    /// How many messages it got.
    asked: usize,
    output: Receiver<Result<Vec<u8>, ProcessError>>,
    stderr: Arc<Mutex<VecDeque<String>>>,
    /// Disconnected when stderr has ended.
    stderr_end: Receiver<()>,
}

impl Process {
    /// Starts a command of the shell.
    pub(super) fn start(command: &str) -> Result<Self, ProcessError> {
        let mut shell = shell(command);
        shell
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = BoundChild::spawn(&mut shell).map_err(ProcessError::Start)?;
        let pipes = child.process();
        let (input, lines) = channel::<Vec<u8>>();
        if let Some(mut stdin) = pipes.stdin.take() {
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
        // A command that writes more than it is asked for waits here, and takes no memory.
        let (sender, output) = sync_channel(1);
        if let Some(stdout) = pipes.stdout.take() {
            thread::spawn(move || send_lines(stdout, &sender));
        }
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        let (at_end, stderr_end) = channel();
        if let Some(pipe) = pipes.stderr.take() {
            let kept = Arc::clone(&stderr);
            thread::spawn(move || {
                keep_last_lines(pipe, &kept);
                drop(at_end);
            });
        }
        Ok(Self {
            child,
            input,
            asked: 0,
            output,
            stderr,
            stderr_end,
        })
    }

    /// Writes a line and gives the line that answers it. A line that was there before the message is
    /// an error: it would be taken for the answer, and each answer after it for that of the next
    /// message. The run may be stopped before the answer.
    pub(super) fn ask(
        &mut self,
        mut line: Vec<u8>,
        within: Duration,
        stop: Option<&StopSwitch>,
    ) -> Result<Vec<u8>, ProcessError> {
        line.push(b'\n');
        let early = match self.asked {
            // A command may say that it is ready before it reads the first message.
            0 => None,
            // The line of a command that answers once too often arrives a moment later. If it is
            // missed here, the last answer is one too many.
            1..=SETTLING => self.output.recv_timeout(SETTLE_WAIT).ok(),
            _ => self.output.try_recv().ok(),
        };
        self.asked += 1;
        if let Some(early) = early {
            return Err(early.map_or_else(
                |error| error,
                |line| ProcessError::Unasked {
                    line: beginning(&line),
                },
            ));
        }
        // A closed channel means that the command has ended; the answer says so.
        let _ = self.input.send(line);
        let answer = self.line(within, stop);
        planagent_child::wait_if_ending();
        match answer {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) if stop.is_some_and(StopSwitch::is_stopped) => {
                Err(ProcessError::Stopped)
            }
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

    /// Ends the command's stdin, and then the command. A line after its last answer is an error.
    pub(super) fn finish(self) -> Result<(), ProcessError> {
        let Self {
            child,
            input,
            output,
            ..
        } = self;
        drop(input);
        let began = Instant::now();
        let late = loop {
            match output.recv_timeout(END_WAIT.saturating_sub(began.elapsed())) {
                // The end of a line is no answer.
                Ok(Ok(line)) if line.trim_ascii().is_empty() => {}
                Ok(Ok(line)) => {
                    break Err(ProcessError::AfterEnd {
                        line: beginning(&line),
                    });
                }
                Ok(Err(error)) => break Err(error),
                Err(_) => break Ok(()),
            }
        };
        planagent_child::wait_if_ending();
        drop(child);
        late
    }

    /// The next line of the command.
    fn line(
        &self,
        within: Duration,
        stop: Option<&StopSwitch>,
    ) -> Result<Result<Vec<u8>, ProcessError>, RecvTimeoutError> {
        let Some(stop) = stop else {
            return self.output.recv_timeout(within);
        };
        let started = Instant::now();
        loop {
            let left = within.saturating_sub(started.elapsed());
            match self.output.recv_timeout(left.min(STOP_POLL)) {
                Err(RecvTimeoutError::Timeout) if !left.is_zero() && !stop.is_stopped() => {}
                ended => return ended,
            }
        }
    }

    /// The exit status in words, if the command ends soon.
    fn status(&mut self) -> String {
        let started = Instant::now();
        while started.elapsed() < EXIT_WAIT {
            if let Ok(Some(status)) = self.child.process().try_wait() {
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

#[cfg(unix)]
fn shell(command: &str) -> Command {
    let mut shell = Command::new("sh");
    shell.args(["-c", command]);
    shell
}

#[cfg(not(unix))]
fn shell(command: &str) -> Command {
    let mut shell = Command::new("cmd");
    shell.args(["/C", command]);
    shell
}

/// Sends each line of a command's output; ends with the output or the receiver.
fn send_lines(output: impl Read, sender: &SyncSender<Result<Vec<u8>, ProcessError>>) {
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
