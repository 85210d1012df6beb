//! The attempts of a planning call: ask, try the answer out, ask again with feedback.

use super::PlannerError;
use super::record::{Attempt, Proposal};
use super::unreadable::Unreadable;
use crate::reasoning::{Feedback, Interruption, PlannerAnswer, ReasoningError, ReasoningTrace};
use crate::reflection::{ReflectionReport, Verdict};
use planagent_mllm::milliseconds;
use planagent_world::geometry::Pose;
use std::time::Instant;

/// What is asked for in a planning call, and how an answer is tried out.
pub(super) trait Question {
    /// The line that is asked for.
    type Answer: Copy + Into<PlannerAnswer>;
    /// The plan that it stands for.
    type Plan;

    /// The next answer; `None` when there are no more.
    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<Self::Answer>>, ReasoningError>;

    /// The plan of an answer with its reflection; `None` when the answer stands for no plan here.
    fn try_out(&mut self, answer: Self::Answer) -> Result<Option<Trial<Self::Plan>>, PlannerError>;
}

/// A plan that was tried out.
pub(super) struct Trial<P> {
    pub(super) plan: P,
    pub(super) path: Vec<Pose>,
    /// `None` with Reflection off.
    pub(super) reflection: Option<ReflectionReport>,
    /// The score that the plan needs.
    pub(super) threshold: f64,
}

/// When the attempts of a planning call end.
#[derive(Debug, Clone, Copy)]
pub(super) struct AttemptLimits {
    /// Maximum number of attempts.
    pub(super) max_exec: usize,
    /// The score that a plan needs unless its trial says otherwise.
    pub(super) threshold: f64,
    /// Whether all answers are tried out and the best one is kept, however many there are.
    pub(super) compares: bool,
}

/// An attempt with its plan.
struct Tried<P> {
    record: Attempt,
    plan: Option<P>,
}

impl<P> Tried<P> {
    fn is_accepted(&self) -> bool {
        let report = self.record.reflection.as_ref();
        self.plan.is_some() && report.is_none_or(|report| report.verdict == Verdict::Execute)
    }

    fn score(&self) -> f64 {
        self.record
            .reflection
            .as_ref()
            .map_or(0.0, |report| report.score)
    }
}

/// The attempts of a planning call.
pub(super) struct Attempts<P> {
    tried: Vec<Tried<P>>,
    /// Why the call ended early.
    pub(super) interruption: Option<Interruption>,
}

impl<P> Attempts<P> {
    pub(super) const NONE: Self = Self {
        tried: Vec::new(),
        interruption: None,
    };

    /// Attempts until a plan is accepted, the maximum is reached, or the call is interrupted.
    /// `observation_ms` is the time that Reflection took to observe the scene; the first attempt's
    /// record contains it.
    pub(super) fn make<Q: Question<Plan = P>>(
        question: &mut Q,
        limits: AttemptLimits,
        mut observation_ms: f64,
    ) -> Result<Self, PlannerError> {
        let mut attempts = Self::NONE;
        let mut needed = limits.threshold;
        while (attempts.tried.len() < limits.max_exec || limits.compares)
            && attempts.interruption.is_none()
        {
            let feedback = attempts
                .tried
                .last()
                .map(|last| last.record.feedback(needed));
            let Some(mut trace) = question.ask(feedback.as_ref())? else {
                break;
            };
            attempts.interruption = trace.interruption.take();
            if trace.rounds.is_empty() && attempts.interruption.is_some() {
                break;
            }
            let started = Instant::now();
            let (trial, proposals) = best_trial(question, &mut trace)?;
            needed = trial.as_ref().map_or(needed, |trial| trial.threshold);
            let reflection_ms =
                std::mem::take(&mut observation_ms) + milliseconds(started.elapsed());
            let tried = tried(trace, trial, proposals, reflection_ms);
            if limits.compares {
                attempts.keep_better(tried);
                continue;
            }
            let is_accepted = tried.is_accepted();
            attempts.tried.push(tried);
            if is_accepted {
                break;
            }
        }
        Ok(attempts)
    }

    /// Keeps the better of two, the earlier of equals. Its record contains the reflection time of
    /// all.
    fn keep_better(&mut self, tried: Tried<P>) {
        let spent_ms = self
            .tried
            .first()
            .map_or(0.0, |best| best.record.reflection_ms)
            + tried.record.reflection_ms;
        if self.tried.first().is_none_or(|best| {
            rank(tried.record.reflection.as_ref()) > rank(best.record.reflection.as_ref())
        }) {
            self.tried = vec![tried];
        }
        if let Some(best) = self.tried.first_mut() {
            best.record.reflection_ms = spent_ms;
        }
    }

    /// The first attempt whose plan is accepted.
    pub(super) fn accepted(&self) -> Option<usize> {
        self.tried.iter().position(Tried::is_accepted)
    }

    /// What is wrong with the last attempt, where none has a plan.
    pub(super) fn unreadable(&self) -> Unreadable {
        self.tried.last().map_or(Unreadable::NoAttempt, |tried| {
            Unreadable::in_attempt(&tried.record)
        })
    }

    /// The last attempt with a plan.
    pub(super) fn last(&self) -> Option<usize> {
        self.tried.iter().rposition(|tried| tried.plan.is_some())
    }

    /// The attempt with the best plan, the first of equals.
    pub(super) fn best(&self) -> Option<usize> {
        let plans = self
            .tried
            .iter()
            .enumerate()
            .rev()
            .filter(|(_, tried)| tried.plan.is_some());
        plans
            .max_by(|(_, a), (_, b)| a.score().total_cmp(&b.score()))
            .map(|(index, _)| index)
    }

    /// The score of an attempt.
    pub(super) fn score(&self, index: usize) -> f64 {
        self.tried[index].score()
    }

    /// The records of all attempts, and the plan of one.
    pub(super) fn into_records(self, index: Option<usize>) -> (Vec<Attempt>, Option<P>) {
        let (records, plans): (Vec<Attempt>, Vec<Option<P>>) = self
            .tried
            .into_iter()
            .map(|Tried { record, plan }| (record, plan))
            .unzip();
        (
            records,
            index.and_then(|index| plans.into_iter().nth(index).flatten()),
        )
    }
}

/// Tries out the answer of an attempt. Where it proposes others, each is tried out. The best
/// becomes its answer, among equals the likeliest.
#[allow(clippy::type_complexity, reason = "a trial and a record")]
fn best_trial<Q: Question>(
    question: &mut Q,
    trace: &mut ReasoningTrace<Q::Answer>,
) -> Result<(Option<Trial<Q::Plan>>, Vec<Proposal>), PlannerError> {
    let Some(likeliest) = trace.parsed.answer else {
        return Ok((None, Vec::new()));
    };
    let mut best = question.try_out(likeliest)?;
    if trace.proposals.is_empty() {
        return Ok((best, Vec::new()));
    }
    let mut proposals = vec![Proposal::from_trial(likeliest, best.as_ref())];
    for &answer in &trace.proposals {
        let trial = question.try_out(answer)?;
        proposals.push(Proposal::from_trial(answer, trial.as_ref()));
        let rank =
            |trial: &Option<Trial<_>>| trial.as_ref().map(|trial| rank(trial.reflection.as_ref()));
        if rank(&trial) > rank(&best) {
            (best, trace.parsed.answer) = (trial, Some(answer));
        }
    }
    Ok((best, proposals))
}

impl Proposal {
    fn from_trial<P>(answer: impl Into<PlannerAnswer>, trial: Option<&Trial<P>>) -> Self {
        Self {
            answer: answer.into(),
            reflection: trial.and_then(|trial| trial.reflection.clone()),
        }
    }
}

/// Order among answers that are compared: accepted plans first, then by score.
fn rank(report: Option<&ReflectionReport>) -> (bool, f64) {
    report.map_or((false, f64::NEG_INFINITY), |report| {
        (report.verdict == Verdict::Execute, report.score)
    })
}

fn tried<A: Into<PlannerAnswer>, P>(
    trace: ReasoningTrace<A>,
    trial: Option<Trial<P>>,
    proposals: Vec<Proposal>,
    reflection_ms: f64,
) -> Tried<P> {
    let (plan, path, reflection) = match trial {
        Some(Trial {
            plan,
            path,
            reflection,
            ..
        }) => (Some(plan), path, reflection),
        None => (None, Vec::new(), None),
    };
    let ReasoningTrace {
        rounds,
        instruction,
        parsed,
        ..
    } = trace;
    let (answer, errors) = (parsed.answer.map(A::into), parsed.errors);
    Tried {
        record: Attempt {
            rounds,
            instruction,
            answer,
            errors,
            reflection,
            proposals,
            path,
            reflection_ms,
        },
        plan,
    }
}
