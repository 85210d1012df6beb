//! A running command that answers messages.

use super::answer;
use super::messages::{ExecInitialization, ExecReply, ExecRequest};
use super::process::{Process, ProcessError};
use crate::planner::{PlannerInitialization, StopSwitch};
use std::time::Duration;

/// Minimum time for the answer to the first message: an interpreter and its packages start slowly.
const START_TIMEOUT: Duration = Duration::from_mins(1);

/// Why a command gives no usable answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)]
pub enum AnswerError {
    #[error(transparent)]
    Process(#[from] ProcessError),
    #[error("the message to the command cannot be written: {0}")]
    Request(serde_json::Error),
    /// The text says what is wrong, and shows the place.
    #[error("the command answered what is no message: {0}")]
    NoMessage(String),
    #[error("the command answered with another message than {expected}: {answer}")]
    Other {
        expected: &'static str,
        answer: String,
    },
    #[error("the command says: {0}")]
    Command(String),
    #[error("the trajectory of the command cannot be used: {0}")]
    Trajectory(String),
    #[error("the agents of the command cannot be used: {0}")]
    Agents(String),
    #[error("the command of another simulation cannot be asked")]
    Copied,
}

/// A command that is ready. It is ended when this is dropped.
#[derive(Debug)]
pub struct ExecSession {
    process: Process,
    /// Time for an answer to a step.
    timeout: Duration,
    /// Ends the wait for an answer early.
    stop: Option<StopSwitch>,
}

impl ExecSession {
    /// Starts a command and waits until it is ready.
    ///
    /// # Errors
    /// When it cannot be started, ends, is silent, or answers with anything but `ready`.
    pub fn start(
        command: &str,
        timeout: Duration,
        stop: Option<&StopSwitch>,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<Self, AnswerError> {
        let mut process = Process::start(command)?;
        let request = ExecRequest::Initialize(Box::new(ExecInitialization::from_initialization(
            initialization,
        )));
        match ask(&mut process, &request, timeout.max(START_TIMEOUT), stop)? {
            (ExecReply::Ready {}, _) => Ok(Self {
                process,
                timeout,
                stop: stop.cloned(),
            }),
            (_, answer) => Err(AnswerError::Other {
                expected: "ready",
                answer,
            }),
        }
    }

    /// The answer to a message of a step, and its beginning for errors.
    ///
    /// # Errors
    /// When the command ends, is silent, answers with no message, or with an error.
    pub fn ask(&mut self, request: &ExecRequest) -> Result<(ExecReply, String), AnswerError> {
        ask(&mut self.process, request, self.timeout, self.stop.as_ref())
    }

    /// Ends the command after its last answer.
    ///
    /// # Errors
    /// When the command wrote more lines than it was asked for.
    pub fn finish(self) -> Result<(), AnswerError> {
        Ok(self.process.finish()?)
    }
}

fn ask(
    process: &mut Process,
    request: &ExecRequest,
    within: Duration,
    stop: Option<&StopSwitch>,
) -> Result<(ExecReply, String), AnswerError> {
    let line = serde_json::to_vec(request).map_err(AnswerError::Request)?;
    let answer = process.ask(line, within, stop)?;
    match answer::read(&answer) {
        Ok(ExecReply::Error { message }) => Err(AnswerError::Command(message)),
        Ok(reply) => Ok((reply, answer::beginning(&answer))),
        Err(fault) => Err(AnswerError::NoMessage(fault)),
    }
}
