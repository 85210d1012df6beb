//! Questions of simulations to planners in Python, and their answers.
//!
//! A planner in Python runs on a thread of Python, one for each thread of the run's pool: with the
//! stack and the thread state that Python gives its threads, and without a frame of Rust below it,
//! so that Python can end it at exit. The thread of the pool waits for the answer, or for the stop
//! of the run. A planner that never returns holds its own thread and nothing else.
//! Why: docs/decisions/126-planners-on-threads-of-python.md.
//! `docs/decisions/126-planners-on-threads-of-python.md` says why.

use crate::observation::Observation;
use crate::work::lock;
use planagent::Trajectory as Planned;
use planagent::planning::PlannerError;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex};

/// What a simulation asks. Simulations and planners are numbers, so that no thread of Rust holds
/// an object of Python.
pub(crate) enum Question {
    /// The planner of this number shall be made for a simulation.
    Make {
        simulation: u64,
        planner: usize,
    },
    Reset {
        simulation: u64,
    },
    Plan {
        simulation: u64,
        observation: Box<Observation>,
    },
    /// The simulation has ended; this needs no answer.
    Drop {
        simulation: u64,
    },
}

/// What a planner answers: a trajectory where it was asked for one, or why it failed.
pub(crate) type Answer = Result<Option<Planned>, String>;

/// An exception of a planner, with its place.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct PythonError(String);

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
#[error("the run was stopped")]
struct Stopped;

/// What one thread of the pool and its thread of Python say to each other.
#[derive(Default)]
struct Seat {
    questions: VecDeque<Question>,
    answer: Option<Answer>,
    /// Whether the thread of Python was asked for.
    is_taken: bool,
}

/// The seats of a run.
pub(crate) struct Relay {
    seats: Vec<(Mutex<Seat>, Condvar)>,
    is_closed: Mutex<bool>,
    /// Asks the thread that waits for the run to start a thread of Python for a seat.
    want: Box<dyn Fn(usize) + Send + Sync>,
}

impl Relay {
    pub(crate) fn new(seats: usize, want: impl Fn(usize) + Send + Sync + 'static) -> Self {
        Self {
            seats: (0..seats).map(|_| Default::default()).collect(),
            is_closed: Mutex::new(false),
            want: Box::new(want),
        }
    }

    fn is_closed(&self) -> bool {
        *lock(&self.is_closed)
    }

    /// Ends the threads of Python that wait, and the wait of simulations for those that do not.
    pub(crate) fn close(&self) {
        *lock(&self.is_closed) = true;
        for (seat, changed) in &self.seats {
            // Who looked before it was closed waits by now.
            drop(lock(seat));
            changed.notify_all();
        }
    }

    fn seat(&self) -> (usize, &(Mutex<Seat>, Condvar)) {
        let number = rayon::current_thread_index().unwrap_or(0) % self.seats.len().max(1);
        let seat = self.seats.get(number);
        (
            number,
            seat.expect("a run has a seat for each thread of its pool"),
        )
    }

    /// Asks, from a thread of the run's pool, and waits for the answer.
    pub(crate) fn ask(&self, question: Question) -> Result<Option<Planned>, PlannerError> {
        let failed = |source: Box<dyn std::error::Error + Send + Sync>| PlannerError::Failed {
            doing: "planning in Python",
            source,
        };
        let (number, (seat, changed)) = self.seat();
        let mut place = lock(seat);
        let is_new = !std::mem::replace(&mut place.is_taken, true);
        place.answer = None;
        place.questions.push_back(question);
        changed.notify_all();
        if is_new {
            drop(place);
            (self.want)(number);
            place = lock(seat);
        }
        loop {
            if let Some(answer) = place.answer.take() {
                return answer.map_err(|text| failed(Box::new(PythonError(text))));
            }
            if self.is_closed() {
                return Err(failed(Box::new(Stopped)));
            }
            place = changed
                .wait(place)
                .unwrap_or_else(std::sync::PoisonError::into_inner);
        }
    }

    /// Says that a simulation has ended.
    pub(crate) fn tell_end(&self, simulation: u64) {
        let (_, (seat, changed)) = self.seat();
        lock(seat)
            .questions
            .push_back(Question::Drop { simulation });
        changed.notify_all();
    }

    /// The next question of a seat; none once the run has ended.
    pub(crate) fn next(&self, number: usize) -> Option<Question> {
        let (seat, changed) = self.seats.get(number)?;
        let mut place = lock(seat);
        loop {
            if self.is_closed() {
                return None;
            }
            if let Some(question) = place.questions.pop_front() {
                return Some(question);
            }
            place = changed
                .wait(place)
                .unwrap_or_else(std::sync::PoisonError::into_inner);
        }
    }

    /// Gives the answer to the last question of a seat.
    pub(crate) fn answer(&self, number: usize, answer: Answer) {
        if let Some((seat, changed)) = self.seats.get(number) {
            lock(seat).answer = Some(answer);
            changed.notify_all();
        }
    }
}
