//! Planners that are commands of other programs: `exec:COMMAND` or `NAME=exec:COMMAND` instead of a
//! planner's name.
//!
//! The command runs once for each simulation. It reads a JSON object a line on stdin and answers
//! each with one on stdout ([`ExecRequest`], [`ExecReply`]). A command may also control the other
//! agents of a simulation. A command that ends, is silent or answers wrongly fails its simulation.

mod agents;
mod answer;
mod json_fault;
mod messages;
#[cfg(test)]
mod messages_tests;
mod process;
mod session;

pub use agents::{ExecAgent, ExecAgentsStep, moved};
pub use answer::read as read_reply;
pub use messages::{ExecReply, ExecRequest, trajectory as trajectory_of};
pub use session::{AnswerError, ExecSession};

use super::{Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName, StopSwitch};
use messages::{ExecStep, trajectory};
use planagent_world::Trajectory;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Time for an answer to a step, unless the user sets another.
pub const DEFAULT_EXEC_TIMEOUT: Duration = Duration::from_secs(10);
/// What comes before the command.
const MARK: &str = "exec:";
/// Longest name of a command; it becomes part of file names.
const MAX_NAME: usize = 40;

/// A planner that is a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExecCommand {
    /// Its name in tables and files.
    pub name: PlannerName,
    /// The command, for the shell.
    pub command: String,
}

/// A word that names a command wrongly.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)]
pub enum ExecError {
    #[error("'{0}' has no command; expected exec:COMMAND or NAME=exec:COMMAND")]
    NoCommand(String),
    #[error(
        "'{0}' cannot name a planner; a name has lowercase letters, digits, minuses and underscores, and at most {MAX_NAME} \
         characters"
    )]
    Name(String),
    #[error("'{0}' is the name of another planner; name the command as NAME=exec:COMMAND")]
    Taken(String),
}

/// Whether a word is a command instead of a planner's name.
pub fn is_exec(word: &str) -> bool {
    command_of(word).is_some()
}

/// The name before a command, if there is one, and the command.
fn command_of(word: &str) -> Option<(Option<&str>, &str)> {
    let word = word.trim();
    if let Some(command) = word.strip_prefix(MARK) {
        return Some((None, command.trim()));
    }
    // A comma before the name separates planners.
    let (name, rest) = word
        .split_once('=')
        .filter(|(name, _)| !name.contains(','))?;
    let command = rest.strip_prefix(MARK)?;
    Some((Some(name.trim()), command.trim()))
}

impl ExecCommand {
    /// The command of a word; `None` for the name of a planner.
    pub fn parse(word: &str) -> Option<Result<Self, ExecError>> {
        let (name, command) = command_of(word)?;
        Some(Self::new(word, name, command))
    }

    fn new(word: &str, name: Option<&str>, command: &str) -> Result<Self, ExecError> {
        if command.is_empty() {
            return Err(ExecError::NoCommand(word.to_owned()));
        }
        let name = name.map_or_else(|| default_name(command), str::to_owned);
        let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if name.is_empty() || name.len() > MAX_NAME || !name.chars().all(fits) {
            return Err(ExecError::Name(name));
        }
        Ok(Self {
            name: PlannerName::new(interned(name)),
            command: command.to_owned(),
        })
    }

    /// The planner of one simulation; an answer to a step may take `timeout`, and is waited for
    /// until `stop`.
    pub(crate) fn planner(&self, timeout: Duration, stop: Option<&StopSwitch>) -> Box<dyn Planner> {
        Box::new(ExecPlanner {
            name: self.name,
            command: self.command.clone(),
            timeout,
            stop: stop.cloned(),
            session: None,
        })
    }
}

/// `exec-` and the name of the script, else of the program.
fn default_name(command: &str) -> String {
    let words = || {
        command
            .split_whitespace()
            .filter(|word| !word.starts_with('-') && !word.contains('='))
    };
    let script = words().find(|word| Path::new(word).extension().is_some());
    let stem = script
        .or_else(|| words().next())
        .and_then(|word| Path::new(word).file_stem());
    let stem = stem
        .map(|stem| stem.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    let fit = |c: char| {
        if c.is_ascii_alphanumeric() || c == '_' {
            c
        } else {
            '-'
        }
    };
    let name: String = stem.chars().map(fit).collect();
    format!("exec-{}", name.trim_matches(['-', '\'', '"']))
        .chars()
        .take(MAX_NAME)
        .collect()
}

/// The text as names hold it: each text once, as long as the process lives. There are few.
pub fn interned(name: String) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = names.get(name.as_str()) {
        return known;
    }
    let name: &'static str = Box::leak(name.into_boxed_str());
    names.insert(name);
    name
}

/// A planner that asks a command.
#[derive(Debug)]
struct ExecPlanner {
    name: PlannerName,
    command: String,
    timeout: Duration,
    stop: Option<StopSwitch>,
    /// The running command with whether it has had a step.
    session: Option<(ExecSession, bool)>,
}

impl ExecPlanner {
    fn step(&mut self, input: &PlannerInput<'_>) -> Result<Option<Trajectory>, AnswerError> {
        let Some((session, stepped)) = &mut self.session else {
            return Ok(None);
        };
        let first = !std::mem::replace(stepped, true);
        let request = ExecRequest::Step(Box::new(ExecStep::from_input(input, first)));
        match session.ask(&request)? {
            (ExecReply::Trajectory { states }, _) => trajectory(&states, input.scene.ego)
                .map(Some)
                .map_err(AnswerError::Trajectory),
            (_, answer) => Err(AnswerError::Other {
                expected: "trajectory",
                answer,
            }),
        }
    }
}

fn failed(source: AnswerError) -> PlannerError {
    PlannerError::Failed {
        doing: "planning with a command",
        source: Box::new(source),
    }
}

impl Planner for ExecPlanner {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        // A command that was asked before keeps nothing: it is ended.
        self.session = None;
        let stop = self.stop.as_ref();
        let session = ExecSession::start(&self.command, self.timeout, stop, initialization)
            .map_err(failed)?;
        self.session = Some((session, false));
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let trajectory = self.step(input).map_err(failed)?;
        trajectory.ok_or(PlannerError::NotInitialized)
    }

    fn finish(&mut self) -> Result<(), PlannerError> {
        self.session
            .take()
            .map_or(Ok(()), |(session, _)| session.finish().map_err(failed))
    }
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    use super::process::Process;
    use super::*;

    fn name(word: &str) -> String {
        ExecCommand::parse(word).unwrap().unwrap().name.to_string()
    }

    #[test]
    fn a_command_is_named_after_its_script_or_by_its_user() {
        assert_eq!(name("exec:python3 my_planner.py --fast"), "exec-my_planner");
        assert_eq!(name("exec:./build/Planner"), "exec-planner");
        assert_eq!(name("exec:SEED=1 cargo run --release"), "exec-cargo");
        assert_eq!(name("mine=exec:uv run planner.py"), "mine");
        assert_eq!(ExecCommand::parse("idm"), None);
        for (word, error) in [
            ("exec:", "no command"),
            ("My Own=exec:x", "cannot name"),
            ("=exec:x", "cannot name"),
        ] {
            let found = ExecCommand::parse(word).unwrap().unwrap_err().to_string();
            assert!(found.contains(error), "{found}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_process_that_is_silent_or_ends_is_an_error_in_time() {
        let mut silent = Process::start("sleep 60").unwrap();
        let error = silent
            .ask(b"{}".to_vec(), Duration::from_millis(100), None)
            .unwrap_err()
            .to_string();
        assert_eq!(error, "the command gave no answer within 0.1 s");
        let mut dead = Process::start("echo no module >&2; exit 3").unwrap();
        let error = dead
            .ask(b"{}".to_vec(), Duration::from_secs(20), None)
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("the command ended (exit status: 3)"),
            "{error}"
        );
        let mut echo = Process::start("cat").unwrap();
        // More than a pipe holds.
        let long = vec![b'x'; 1 << 20];
        assert_eq!(
            echo.ask(long.clone(), Duration::from_secs(20), None)
                .unwrap()
                .trim_ascii_end(),
            long
        );
    }

    /// Time in which a line of a command arrives.
    #[cfg(unix)]
    const ARRIVAL: Duration = Duration::from_secs(20);

    /// Asks until a command is found to have written a line too many; gives the error.
    #[cfg(unix)]
    fn found_out(command: &str) -> String {
        let mut process = Process::start(command).unwrap();
        for _ in 0..100 {
            // A question takes a few milliseconds of simulation.
            std::thread::sleep(Duration::from_millis(5));
            if let Err(error) = process.ask(b"question".to_vec(), ARRIVAL, None) {
                return error.to_string();
            }
        }
        panic!("{command}: nothing is wrong with 100 answers")
    }

    #[cfg(unix)]
    #[test]
    fn a_line_that_answers_no_message_is_an_error() {
        for command in [
            // Ahead of the first message, two answers to one, and answers without reading.
            "echo ahead; cat",
            "read line; echo one; echo two; cat",
            "while read line; do echo one; echo two; done",
            "yes answer",
        ] {
            let error = found_out(command);
            assert!(error.contains("answers no message"), "{command}: {error}");
        }
        let long = found_out("head -c 20000000 /dev/zero");
        assert!(
            long.contains("a line of more than 16777216 bytes"),
            "{long}"
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_line_after_the_last_answer_is_an_error() {
        let finished = |command: &str| {
            let mut process = Process::start(command).unwrap();
            process.ask(b"last".to_vec(), ARRIVAL, None).unwrap();
            process.finish().map_err(|error| error.to_string())
        };
        for command in ["read line; echo one; echo two", "cat; echo goodbye"] {
            let error = finished(command).unwrap_err();
            assert!(
                error.contains("after the answer to its last message"),
                "{error}"
            );
        }
        let began = std::time::Instant::now();
        for command in ["cat", "cat; echo", "read line; echo one; exec sleep 100"] {
            assert_eq!(finished(command), Ok(()), "{command}");
        }
        assert!(
            began.elapsed() < Duration::from_secs(50),
            "a command is ended that does not end"
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_silent_process_is_not_waited_for_after_the_stop_of_the_run() {
        let (mut silent, stop) = (Process::start("sleep 60").unwrap(), StopSwitch::default());
        let (other, started) = (stop.clone(), std::time::Instant::now());
        std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            other.stop();
        });
        let answer = silent.ask(b"{}".to_vec(), Duration::from_secs(50), Some(&stop));
        assert_eq!(answer.unwrap_err().to_string(), "the run was stopped");
        assert!(started.elapsed() < Duration::from_secs(20));
    }

    #[cfg(unix)]
    #[test]
    fn a_process_ends_with_all_that_it_started() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("alive");
        // The process in the background would write the file a second later.
        let command = format!("(sleep 1; echo > {}) & cat", file.display());
        let mut process = Process::start(&command).unwrap();
        assert_eq!(
            process
                .ask(b"here".to_vec(), Duration::from_secs(20), None)
                .unwrap(),
            b"here\n"
        );
        drop(process);
        std::thread::sleep(Duration::from_millis(1500));
        assert!(!file.exists());
    }
}
