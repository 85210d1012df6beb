//! The attempts of a planning call: ask, try the answer out, ask again with feedback.

use super::PlannerError;
use super::record::{Attempt, Proposal};
use super::settings::AfterMaxExec;
use super::unreadable::Unreadable;
use crate::reasoning::{Feedback, Interruption, PlannerAnswer, ReasoningError, ReasoningTrace};
use crate::reflection::{ReflectionReport, Verdict};
use planagent_mllm::milliseconds;
use planagent_world::geometry::Pose;
use std::time::Instant;

/// What is asked for in a planning call, and how an answer is tried out.
pub trait Question {
    /// The line that is asked for.
    type Answer: Copy + Into<PlannerAnswer>;
    /// The plan that it stands for.
    type Plan;

    /// The next answer, asked for by the agent's prompts and under its grammar; `None` when there
    /// are no more.
    ///
    /// # Errors
    /// When the model cannot be asked at all. A wrong answer is no such error.
    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<Self::Answer>>, ReasoningError>;

    /// The plan of an answer with its reflection; `None` when the answer stands for no plan here.
    ///
    /// # Errors
    /// When the plan has no finite states.
    fn try_out(&mut self, answer: Self::Answer) -> Result<Option<Trial<Self::Plan>>, PlannerError>;

    /// What is wrong with the last answer, where more is known than its record tells.
    fn unreadable(&self) -> Option<Unreadable> {
        None
    }
}

/// A plan that was tried out.
#[derive(Debug)]
pub struct Trial<P> {
    /// The plan.
    pub plan: P,
    /// Where it leads, map frame.
    pub path: Vec<Pose>,
    /// `None` with Reflection off.
    pub reflection: Option<ReflectionReport>,
    /// The score that the plan needs.
    pub threshold: f64,
}

/// When the attempts of a planning call end.
#[derive(Debug, Clone, Copy)]
pub struct AttemptLimits {
    /// Maximum number of attempts.
    pub max_exec: usize,
    /// The score that a plan needs unless its trial says otherwise.
    pub threshold: f64,
    /// Whether all answers are tried out and the best one is kept, however many there are.
    pub compares: bool,
}

impl AttemptLimits {
    /// One attempt, whose plan needs no score.
    pub const ONE: Self = Self {
        max_exec: 1,
        threshold: 0.0,
        compares: false,
    };
}

/// An attempt with its plan.
#[derive(Debug)]
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

    /// What a refused plan is compared by.
    fn expected_score(&self) -> f64 {
        self.record
            .reflection
            .as_ref()
            .map_or(0.0, |report| report.behaviors.expected)
    }
}

/// The attempts of a planning call.
#[derive(Debug)]
pub struct Attempts<P> {
    tried: Vec<Tried<P>>,
    /// Why the call ended early.
    pub(super) interruption: Option<Interruption>,
    /// What the question says of the last answer.
    unreadable: Option<Unreadable>,
    /// What the plan is compared by that is driven where no attempt is accepted, if there is one.
    pub(super) rival: Option<f64>,
}

impl<P> Attempts<P> {
    const NONE: Self = Self {
        tried: Vec::new(),
        interruption: None,
        unreadable: None,
        rival: None,
    };

    /// Attempts until a plan is accepted, the maximum is reached, or the call is interrupted.
    /// `observation_ms` is the time that Reflection took to observe the scene; the first attempt's
    /// record contains it.
    ///
    /// # Errors
    /// As of [`Question::ask`] and [`Question::try_out`].
    pub fn make<Q: Question<Plan = P>>(
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
            // An interruption after a round still leaves an attempt to record; before it there is
            // nothing.
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
        attempts.unreadable = question.unreadable();
        Ok(attempts)
    }

    /// Tries further answers out, in one more attempt that nobody was asked for. Its record has all
    /// of them as proposals. Its plan is the best, the first of equals; if it is accepted, it drives
    /// whatever was accepted before.
    pub(super) fn try_further<Q: Question<Plan = P>>(
        &mut self,
        question: &mut Q,
        answers: Vec<Q::Answer>,
    ) -> Result<(), PlannerError> {
        let mut answers = answers.into_iter();
        let Some(first) = answers.next() else {
            return Ok(());
        };
        let started = Instant::now();
        let mut trace = ReasoningTrace::without_rounds(first);
        trace.proposals = answers.collect();
        let (trial, proposals) = best_trial(question, &mut trace)?;
        let reflection_ms = milliseconds(started.elapsed());
        let mut tried = tried(trace, trial, proposals, reflection_ms);
        tried.record.is_asked = false;
        self.tried.push(tried);
        Ok(())
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

    /// Whether there are attempts with plans, and Reflection refused each.
    pub(super) fn are_refused(&self) -> bool {
        let judged = |tried: &Tried<P>| tried.plan.is_some() && tried.record.reflection.is_some();
        self.interruption.is_none() && self.accepted().is_none() && self.tried.iter().any(judged)
    }

    /// The attempt whose plan is accepted, the last if further answers were tried after one.
    pub(super) fn accepted(&self) -> Option<usize> {
        self.tried.iter().rposition(Tried::is_accepted)
    }

    /// The answer of that attempt.
    pub(super) fn accepted_answer(&self) -> Option<PlannerAnswer> {
        self.tried.get(self.accepted()?)?.record.answer
    }

    /// What is wrong with the last attempt, where none has a plan.
    pub(super) fn unreadable(&self) -> Unreadable {
        let Some(last) = self.tried.last() else {
            return Unreadable::NoAttempt;
        };
        self.unreadable
            .unwrap_or_else(|| Unreadable::in_attempt(&last.record))
    }

    /// The last attempt with a plan.
    fn last(&self) -> Option<usize> {
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
            .max_by(|(_, a), (_, b)| a.expected_score().total_cmp(&b.expected_score()))
            .map(|(index, _)| index)
    }

    /// The attempt whose plan becomes active although all were refused.
    pub(super) fn refused(&self, after: AfterMaxExec) -> Option<usize> {
        match after {
            AfterMaxExec::Last => self.last(),
            AfterMaxExec::Best => self.best(),
        }
    }

    /// The score of an attempt.
    pub(super) fn score(&self, index: usize) -> f64 {
        self.tried[index].score()
    }

    /// What a refused attempt is compared by.
    pub(super) fn expected_score(&self, index: usize) -> f64 {
        self.tried[index].expected_score()
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

/// Order among answers that are compared: accepted plans first, by their score, then refused ones,
/// by the mean over what crossing traffic may do.
fn rank(report: Option<&ReflectionReport>) -> (bool, f64) {
    report.map_or((false, f64::NEG_INFINITY), |report| match report.verdict {
        Verdict::Execute => (true, report.score),
        Verdict::Rethink => (false, report.behaviors.expected),
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
    // The record keeps an answer that cannot be built into a plan: a reader wants to see it.
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
            is_asked: true,
        },
        plan,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::CenterlineName;
    use crate::reasoning::PlannerCode;
    use crate::reflection::{BehaviorScores, ProgressReference, SubScores};
    use planagent_score::pdm::DrivableLayers;

    const THRESHOLD: f64 = 0.75;

    /// Asks for codes of the speeds in `asked`; a plan of v m/s scores 1 - v / 10.
    struct Slower {
        asked: Vec<f64>,
    }

    fn code(target_speed: f64) -> PlannerCode {
        PlannerCode {
            centerline: CenterlineName::EgoLane,
            lead_agent: None,
            target_speed,
            accel_max: 1.5,
            decel_max: 3.0,
        }
    }

    fn report(score: f64) -> ReflectionReport {
        ReflectionReport {
            score,
            parts: SubScores {
                no_collision: 1.0,
                drivable_area: 1.0,
                driving_direction: 1.0,
                progress: 1.0,
                time_to_collision: 1.0,
                comfort: 1.0,
            },
            behaviors: BehaviorScores::new(score, score, score),
            progress_reference: ProgressReference::OwnProgress,
            drivable_layers: DrivableLayers::DrivableArea,
            threshold: THRESHOLD,
            verdict: if score >= THRESHOLD {
                Verdict::Execute
            } else {
                Verdict::Rethink
            },
            progress_m: 0.0,
            first_at_fault_s: None,
            first_ttc_s: None,
            states: Vec::new(),
        }
    }

    impl Question for Slower {
        type Answer = PlannerCode;
        type Plan = f64;

        fn ask(
            &mut self,
            _: Option<&Feedback>,
        ) -> Result<Option<ReasoningTrace<PlannerCode>>, ReasoningError> {
            Ok(self
                .asked
                .pop()
                .map(|speed| ReasoningTrace::without_rounds(code(speed))))
        }

        fn try_out(&mut self, code: PlannerCode) -> Result<Option<Trial<f64>>, PlannerError> {
            Ok(Some(Trial {
                plan: code.target_speed,
                path: Vec::new(),
                reflection: Some(report(1.0 - code.target_speed / 10.0)),
                threshold: THRESHOLD,
            }))
        }
    }

    /// The attempts of a call with these codes, the first last, and then with those of 8, 4 and 2.
    fn attempts(asked: &[f64]) -> Attempts<f64> {
        let mut question = Slower {
            asked: asked.to_vec(),
        };
        let limits = AttemptLimits {
            max_exec: 3,
            threshold: THRESHOLD,
            compares: false,
        };
        let mut attempts = Attempts::make(&mut question, limits, 0.0).unwrap();
        if attempts.are_refused() {
            attempts
                .try_further(&mut question, [8.0, 4.0, 2.0].map(code).to_vec())
                .unwrap();
        }
        attempts
    }

    #[test]
    fn a_refused_plan_that_is_good_if_others_yield_is_better_than_one_that_is_not() {
        let mut attempts = attempts(&[9.0, 9.0, 9.0]);
        for tried in &mut attempts.tried {
            if let Some(report) = &mut tried.record.reflection {
                (report.score, report.verdict) = (0.0, Verdict::Rethink);
                report.behaviors = BehaviorScores::new(0.0, 0.0, 0.0);
            }
        }
        let second = attempts.tried[1].record.reflection.as_mut().unwrap();
        second.behaviors = BehaviorScores::new(0.0, 0.9, 0.0);
        assert_eq!((attempts.accepted(), attempts.best()), (None, Some(1)));
    }

    #[test]
    fn further_codes_are_tried_where_all_attempts_were_refused_and_only_there() {
        let tried = attempts(&[9.0, 9.0, 9.0]);
        assert_eq!(tried.accepted(), Some(3));
        let (records, plan) = tried.into_records(Some(3));
        assert_eq!(plan, Some(2.0));
        assert_eq!(
            records
                .iter()
                .map(|record| (record.is_asked, record.proposals.len()))
                .collect::<Vec<_>>(),
            [(true, 0), (true, 0), (true, 0), (false, 3)]
        );
        let mut question = Slower { asked: Vec::new() };
        let mut accepted = attempts(&[2.0]);
        accepted
            .try_further(&mut question, vec![code(8.0)])
            .unwrap();
        assert_eq!(accepted.accepted(), Some(0), "the further one is refused");
        accepted
            .try_further(&mut question, vec![code(1.0)])
            .unwrap();
        assert_eq!(accepted.accepted(), Some(2));
        let tried = attempts(&[1.0, 9.0]);
        assert_eq!(tried.accepted(), Some(1));
        assert_eq!(tried.into_records(None).0.len(), 2);
    }
}
