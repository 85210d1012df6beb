//! A process that measures one model.

use super::protocol::{LoadRequest, Loaded, PrepareRequest, Reply, Request};
use planagent_child::BoundChild;
use planagent_mllm::{Limits, Step, StepTime};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};

/// The program that computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum EngineName {
    #[serde(rename = "planagent")]
    PlanAgent,
    #[serde(rename = "llama.cpp")]
    LlamaCpp,
    #[serde(rename = "openvino")]
    OpenVino,
    #[serde(rename = "candle")]
    Candle,
}

impl fmt::Display for EngineName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::PlanAgent => "planagent",
            Self::LlamaCpp => "llama.cpp",
            Self::OpenVino => "openvino",
            Self::Candle => "candle",
        })
    }
}

/// Why an engine could not measure a model.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    #[error("cannot start {program}: {source}")]
    Start {
        program: String,
        source: std::io::Error,
    },
    #[error("{engine} ended without a reply{status}")]
    Ended { engine: EngineName, status: String },
    #[error("{engine} sent an invalid reply: {found}")]
    InvalidReply { engine: EngineName, found: String },
    #[error("{engine}: {problem}")]
    Failed { engine: EngineName, problem: String },
}

/// A running process that measures one model. The drop of this value, and the end of the program,
/// ends it.
#[derive(Debug)]
pub struct Engine {
    name: EngineName,
    child: BoundChild,
    requests: ChildStdin,
    replies: BufReader<ChildStdout>,
}

/// Maximum characters of an invalid reply in an error.
const MAX_SHOWN: usize = 200;
/// Longest reply, bytes. The times of all steps of a call take a few kilobytes, the logits of the
/// largest vocabularies some megabytes.
const MAX_REPLY_BYTES: u64 = 32 << 20;

impl Engine {
    /// Starts a process that reads requests and writes replies. It shares our stderr.
    pub fn start(name: EngineName, command: &mut Command) -> Result<Self, EngineError> {
        let program = command.get_program().to_string_lossy().into_owned();
        let command = command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child =
            BoundChild::spawn(command).map_err(|source| EngineError::Start { program, source })?;
        let pipes = child.process();
        match (pipes.stdin.take(), pipes.stdout.take()) {
            (Some(requests), Some(replies)) => Ok(Self {
                name,
                child,
                requests,
                replies: BufReader::new(replies),
            }),
            _ => Err(EngineError::Ended {
                engine: name,
                status: String::new(),
            }),
        }
    }

    pub fn name(&self) -> EngineName {
        self.name
    }

    /// Lets the engine write the files that it reads.
    ///
    /// # Errors
    /// When it cannot, or ends.
    pub fn prepare(&mut self, request: PrepareRequest) -> Result<(), EngineError> {
        match self.ask(&Request::Prepare(request))? {
            Reply::Prepared => Ok(()),
            other => Err(self.invalid(&format!("{other:?}"))),
        }
    }

    pub fn load(&mut self, request: LoadRequest) -> Result<Loaded, EngineError> {
        match self.ask(&Request::Load(request))? {
            Reply::Loaded(loaded) => Ok(loaded),
            other => Err(self.invalid(&format!("{other:?}"))),
        }
    }

    /// Runs steps and returns the time of each.
    pub fn run(&mut self, steps: Vec<Step>) -> Result<Vec<StepTime>, EngineError> {
        let count = steps.len();
        match self.ask(&Request::Run(steps))? {
            Reply::Ran(times) if times.len() == count => Ok(times),
            other => Err(self.invalid(&format!("{other:?}"))),
        }
    }

    /// The logits behind a prompt, and the likeliest tokens that follow it.
    pub fn answer(
        &mut self,
        prompt: Vec<u32>,
        count: usize,
    ) -> Result<(Vec<f32>, Vec<u32>), EngineError> {
        match self.ask(&Request::Answer { prompt, count })? {
            Reply::Answered { logits, tokens } if tokens.len() == count => Ok((logits, tokens)),
            _ => Err(self.invalid("another reply than an answer")),
        }
    }

    /// The tokens of a picture of ramps, and the numbers of at most `most` of them.
    pub(crate) fn features(
        &mut self,
        side: u32,
        most: usize,
    ) -> Result<(usize, Vec<f32>), EngineError> {
        match self.ask(&Request::Features { side, most })? {
            Reply::Encoded { tokens, values } => Ok((tokens, values)),
            _ => Err(self.invalid("another reply than features")),
        }
    }

    /// What the processor can do at most, measured in the process.
    pub(crate) fn limits(&mut self) -> Result<Limits, EngineError> {
        match self.ask(&Request::Limits)? {
            Reply::Limits(limits) => Ok(limits),
            _ => Err(self.invalid("another reply than limits")),
        }
    }

    /// Peak memory of the process so far, bytes (`VmHWM`); `None` where the system does not report
    /// it.
    pub(crate) fn peak_memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmHWM:"))?;
        let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
        Some(kibibytes * 1024)
    }

    fn ask(&mut self, request: &Request) -> Result<Reply, EngineError> {
        let mut line =
            serde_json::to_string(request).map_err(|error| self.invalid(&error.to_string()))?;
        line.push('\n');
        let sent = self
            .requests
            .write_all(line.as_bytes())
            .and_then(|()| self.requests.flush());
        let mut answer = String::new();
        let read = sent.and_then(|()| {
            (&mut self.replies)
                .take(MAX_REPLY_BYTES)
                .read_line(&mut answer)
        });
        planagent_child::wait_if_ending();
        if !read.is_ok_and(|bytes| bytes > 0) {
            return Err(self.ended());
        }
        match serde_json::from_str(&answer) {
            Ok(Reply::Failed(problem)) => Err(EngineError::Failed {
                engine: self.name,
                problem,
            }),
            Ok(reply) => Ok(reply),
            Err(_) => Err(self.invalid(&answer)),
        }
    }

    fn ended(&mut self) -> EngineError {
        let status = self
            .child
            .process()
            .wait()
            .map_or_else(|_| String::new(), |status| format!(" ({status})"));
        EngineError::Ended {
            engine: self.name,
            status,
        }
    }

    fn invalid(&self, found: &str) -> EngineError {
        EngineError::InvalidReply {
            engine: self.name,
            found: found.chars().take(MAX_SHOWN).collect(),
        }
    }
}
