//! The decision of a planning call in words: what is executed, and why.

use super::call_record::{CallRecord, DecisionRecord, ReflectionRecord};
use super::number::fixed;
use planagent_agent::planner::{Attempt, Decision, NoPlan, PlanningCall};
use planagent_agent::reflection::{ReflectionReport, SubScores, Verdict};

/// Whether Reflection refused every attempt of a call.
pub(super) fn all_refused(call: &PlanningCall) -> bool {
    matches!(
        call.decision,
        Decision::Exhausted(_)
            | Decision::KeepActivePlan(NoPlan::Worse)
            | Decision::RuleBased(NoPlan::Outscored)
    )
}

/// Whether Reflection refused the first attempt of a call, or it gave no plan.
pub(super) fn first_refused(call: &PlanningCall) -> bool {
    let report = |attempt: &Attempt| {
        attempt
            .reflection
            .as_ref()
            .is_some_and(|report| report.verdict == Verdict::Execute)
    };
    call.attempts
        .first()
        .is_some_and(|attempt| !report(attempt))
}

/// Whether Reflection gave every plan of a call, at least one, 0 in a part of the score.
pub(super) fn all_are_zero(call: &PlanningCall, part: fn(&SubScores) -> f64) -> bool {
    let mut parts = call
        .attempts
        .iter()
        .filter_map(|attempt| Some(part(&attempt.reflection.as_ref()?.parts)))
        .peekable();
    parts.peek().is_some() && parts.all(|part| part <= 0.0)
}

/// The decision of a planning call in words.
pub fn decision_words(call: &PlanningCall) -> String {
    let scores: Vec<Option<RefusedScore>> = call
        .attempts
        .iter()
        .map(|a| a.reflection.as_ref().map(RefusedScore::from_report))
        .collect();
    let refused = Refused {
        scores: &scores,
        one_code: is_one(call.attempts.iter().map(Attempt::line)),
    };
    refused.words(
        &DecisionRecord::from_decision(&call.decision),
        call.aborted_lane_change == Some(call.iteration),
    )
}

/// The decision of a recorded call in words.
pub(super) fn recorded_words(call: &CallRecord) -> String {
    let scores: Vec<Option<RefusedScore>> = call
        .attempts
        .iter()
        .map(|a| a.reflection.as_ref().map(RefusedScore::from_record))
        .collect();
    let codes = call
        .attempts
        .iter()
        .map(|attempt| Some(attempt.code.as_ref()?.text().to_owned()));
    let refused = Refused {
        scores: &scores,
        one_code: is_one(codes),
    };
    refused.words(
        &call.decision,
        call.aborted_lane_change == Some(call.iteration),
    )
}

/// Whether all attempts have a planner code, and the same one.
fn is_one(codes: impl Iterator<Item = Option<String>>) -> bool {
    let codes: Vec<Option<String>> = codes.collect();
    codes.first().is_some_and(Option::is_some) && codes.windows(2).all(|pair| pair[0] == pair[1])
}

/// What a refused plan is compared by.
#[derive(Debug, Clone, Copy)]
struct RefusedScore {
    /// Reflection's score.
    score: f64,
    /// The mean over what crossing traffic may do.
    expected: f64,
}

impl RefusedScore {
    fn from_report(report: &ReflectionReport) -> Self {
        Self {
            score: report.score,
            expected: report.behaviors.expected,
        }
    }

    /// Runs of before version 24 compare by the score alone.
    fn from_record(record: &ReflectionRecord) -> Self {
        Self {
            score: record.score,
            expected: record
                .behaviors
                .map_or(record.score, |others| others.expected),
        }
    }
}

/// The attempts of a call that may have been refused.
struct Refused<'a> {
    /// Reflection's scores, by attempt; none for an attempt without a plan.
    scores: &'a [Option<RefusedScore>],
    /// Whether all have the same planner code.
    one_code: bool,
}

impl Refused<'_> {
    /// A decision in words; `keeps_lane` if a lane change of the executed plan is not begun.
    fn words(&self, decision: &DecisionRecord, keeps_lane: bool) -> String {
        let all_refused = |cause: &str| {
            !self.scores.is_empty()
                && [NoPlan::Worse, NoPlan::Outscored]
                    .iter()
                    .any(|why| why.cause() == cause)
        };
        // One match: an arm is a sentence of the page. Guards stand before the general arm of their
        // decision.
        match decision {
            DecisionRecord::Execute { attempt } => format!("attempt {} is executed", attempt + 1),
            DecisionRecord::Exhausted { attempt } => {
                format!(
                    "{}; {}",
                    self.refusals(),
                    self.instead(*attempt, keeps_lane)
                )
            }
            DecisionRecord::KeepActivePlan { cause, .. } if all_refused(cause) => {
                format!(
                    "{}; the active plan is kept, because it is better than each of them",
                    self.refusals()
                )
            }
            DecisionRecord::RuleBased { cause, .. } if all_refused(cause) => {
                format!(
                    "{}; PDM-Closed plans, because its own proposal scores no less",
                    self.refusals()
                )
            }
            DecisionRecord::KeepActivePlan { why, .. } => {
                format!("the active plan is kept ({why})")
            }
            DecisionRecord::Brake { why, .. } => format!("brake ({why})"),
            DecisionRecord::Gated { score } => {
                format!(
                    "call skipped; PDM-Closed plans, with a predicted score of {}",
                    fixed(*score, 2)
                )
            }
            DecisionRecord::RuleBased { why, .. } => format!("PDM-Closed plans ({why})"),
        }
    }

    /// That all attempts were refused, how many there were, and whether they differ.
    fn refusals(&self) -> String {
        let unreadable = self.scores.iter().filter(|score| score.is_none()).count();
        match (self.scores.len(), unreadable) {
            (1, _) => "the only attempt was refused".to_owned(),
            (all, 0) if self.one_code => {
                format!("all {all} attempts have the same code and were refused")
            }
            (all, 0) => format!("all {all} attempts were refused"),
            (all, unreadable) => {
                format!(
                    "of {all} attempts, {} refused and {unreadable} without a plan",
                    all - unreadable
                )
            }
        }
    }

    /// The refused attempt that is executed, and why.
    fn instead(&self, index: usize, keeps_lane: bool) -> String {
        let own = self.scores.get(index).copied().flatten();
        let among = |is: fn(&RefusedScore, &RefusedScore) -> bool| {
            own.is_some_and(|own| self.scores.iter().flatten().any(|one| is(one, &own)))
        };
        let is_best = own.is_some() && !among(|one, own| one.expected > own.expected);
        // Whether the mean decided between this attempt and one that scores no less.
        let by_mean = among(|one, own| one.score >= own.score && one.expected < own.expected);
        let score = own
            .map(|own| format!(" (score {})", fixed(own.score, 2)))
            .unwrap_or_default();
        let why = if self.one_code || self.scores.len() == 1 {
            "there is no better plan"
        } else if is_best && by_mean {
            "it scores most over what crossing traffic may do"
        } else if is_best {
            "no other attempt scores more"
        } else {
            "it is the last one"
        };
        let lane = if keeps_lane {
            ", in the ego's lane: a refused plan must not begin a lane change"
        } else {
            ""
        };
        format!(
            "attempt {}{score} is executed all the same, because {why}{lane}",
            index + 1
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::environment::CenterlineName;
    use planagent_agent::planner::Unreadable;
    use planagent_agent::reasoning::PlannerCode;
    use planagent_agent::reflection::{BehaviorScores, ProgressReference};
    use planagent_score::pdm::DrivableLayers;

    const CODE: PlannerCode = PlannerCode {
        centerline: CenterlineName::EgoLane,
        lead_agent: None,
        target_speed: 10.0,
        accel_max: 1.0,
        decel_max: 2.0,
    };

    fn reflection(score: f64) -> ReflectionReport {
        let parts = SubScores {
            no_collision: 1.0,
            drivable_area: 1.0,
            driving_direction: 1.0,
            progress: score,
            time_to_collision: score,
            comfort: 1.0,
        };
        let (progress_reference, drivable_layers) =
            (ProgressReference::PdmProposals, DrivableLayers::Lanes);
        ReflectionReport {
            score,
            parts,
            behaviors: BehaviorScores::new(score, score, score),
            progress_reference,
            drivable_layers,
            threshold: 0.75,
            verdict: Verdict::Rethink,
            progress_m: 10.0,
            first_at_fault_s: None,
            first_ttc_s: None,
            states: Vec::new(),
        }
    }

    fn call(decision: Decision, scores: &[Option<f64>]) -> PlanningCall {
        let attempt = |score: &Option<f64>| {
            let mut attempt = Attempt::of_rounds(Vec::new());
            attempt.reflection = score.map(reflection);
            attempt
        };
        let mut call = PlanningCall::without_attempts(20, 2.0, decision, 0.0);
        call.attempts = scores.iter().map(attempt).collect();
        call
    }

    #[test]
    fn a_refused_call_says_what_is_executed_and_why() {
        let three = [Some(0.0), Some(0.41), Some(0.3)];
        let best = call(Decision::Exhausted(1), &three);
        assert_eq!(
            decision_words(&best),
            "all 3 attempts were refused; attempt 2 (score 0.41) is executed all the same, because no other attempt scores more"
        );
        let last = decision_words(&call(Decision::Exhausted(2), &three));
        assert!(
            last.ends_with(
                "attempt 3 (score 0.30) is executed all the same, because it is the last one"
            ),
            "{last}"
        );
        let mut yields = call(Decision::Exhausted(1), &[Some(0.1), Some(0.0), Some(0.0)]);
        if let Some(report) = &mut yields.attempts[1].reflection {
            report.behaviors = BehaviorScores::new(0.0, 0.9, 0.0);
        }
        let by_mean = "it scores most over what crossing traffic may do";
        assert!(
            decision_words(&yields).ends_with(by_mean),
            "{}",
            decision_words(&yields)
        );
        yields.attempts.remove(0);
        yields.decision = Decision::Exhausted(0);
        assert!(
            decision_words(&yields).ends_with(by_mean),
            "equal scores: {}",
            decision_words(&yields)
        );
        let mut same = best.clone();
        for attempt in &mut same.attempts {
            attempt.answer = Some(CODE.into());
        }
        let same = decision_words(&same);
        assert!(
            same.starts_with("all 3 attempts have the same code and were refused; attempt 2"),
            "{same}"
        );
        assert!(same.ends_with("because there is no better plan"), "{same}");
        let mut lane = best.clone();
        lane.aborted_lane_change = Some(20);
        assert!(
            decision_words(&lane).contains("in the ego's lane"),
            "{}",
            decision_words(&lane)
        );
        let mut later = best;
        later.aborted_lane_change = Some(25);
        assert!(
            !decision_words(&later).contains("in the ego's lane"),
            "{}",
            decision_words(&later)
        );
        let kept = decision_words(&call(
            Decision::KeepActivePlan(NoPlan::Worse),
            &[Some(0.2), None],
        ));
        assert_eq!(
            kept,
            "of 2 attempts, 1 refused and 1 without a plan; the active plan is kept, because it is better than each of them"
        );
        let one = decision_words(&call(Decision::Exhausted(0), &[Some(0.0)]));
        assert!(
            one.starts_with("the only attempt was refused; attempt 1 (score 0.00)"),
            "{one}"
        );
    }

    #[test]
    fn a_call_is_refused_when_its_plans_are_and_not_when_it_has_none() {
        assert!(all_refused(&call(Decision::Exhausted(0), &[Some(0.1)])));
        assert!(all_refused(&call(
            Decision::KeepActivePlan(NoPlan::Worse),
            &[Some(0.1)]
        )));
        assert!(!all_refused(&call(Decision::Execute(0), &[Some(0.9)])));
        assert!(!all_refused(&call(
            Decision::KeepActivePlan(NoPlan::Unreadable(Unreadable::Empty)),
            &[None]
        )));
    }
}
