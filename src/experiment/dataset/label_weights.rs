//! What hangs on a label's decisions: a model that cannot tell which of two futures comes has to weigh what each choice would cost.
//!
//! The best of one future alone says that a person who steps onto the road in one of three futures is no reason to slow down. Weighed
//! by what is at stake, the likeliest answer becomes the one that is best on average.

use super::search::Tried;
use crate::reasoning::PlannerCode;

/// What a decision is worth that nothing was tried against: about what full progress adds to a value, for a third of the limit.
const DEFAULT_GAIN: f64 = 0.06;
/// No decision is worth more than a score.
const MAX_GAIN: f64 = 1.0;
/// What a slow first attempt is worth where Reflection refuses every faster one: little, since after a refusal the model is asked again.
const ASKED_AGAIN: f64 = 0.01;

/// What the decisions of a label are worth, as differences of [`Tried::value`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DecisionWeights {
    /// Of the lane: over the best in another lane.
    pub(super) lane: f64,
    /// Of the speed: of slow driving over the fastest, of the fastest over the best that is slower.
    pub(super) speed: f64,
    /// Of the accelerations: over the best other pair with this lane and speed.
    pub(super) accelerations: f64,
}

impl DecisionWeights {
    /// What the best of the planners that were tried is worth over the others. Those that Reflection would refuse do not count: the
    /// model would be asked again; `told` says whether it has been told of a refusal already.
    pub(super) fn of(best: &Tried, tried: &[Tried], told: bool) -> Self {
        let (lane, speed) = (&best.code.centerline, best.code.target_speed);
        let accepted = || tried.iter().filter(|t| t.is_accepted());
        let in_lane = || accepted().filter(|t| t.code.centerline == *lane);
        let fastest = in_lane().map(|t| t.code.target_speed).fold(speed, f64::max);
        let elsewhere = accepted().filter(|t| t.code.centerline != *lane);
        let at_other_speeds = in_lane().filter(|t| {
            let other = t.code.target_speed;
            if speed < fastest { other >= fastest } else { other < fastest }
        });
        let refused_faster =
            tried.iter().any(|t| t.code.centerline == *lane && t.code.target_speed > fastest && !t.is_accepted());
        let PlannerCode { accel_max, decel_max, .. } = best.code;
        let with_other_pairs = accepted()
            .filter(|t| t.code != best.code && PlannerCode { accel_max, decel_max, ..t.code.clone() } == best.code);
        let speed = if refused_faster && !told { ASKED_AGAIN } else { gain(best, at_other_speeds) };
        Self { lane: gain(best, elsewhere), speed, accelerations: gain(best, with_other_pairs) }
    }
}

/// What the best has over the best of others.
fn gain<'a>(best: &Tried, others: impl Iterator<Item = &'a Tried>) -> f64 {
    others.map(|other| best.value - other.value).reduce(f64::min).unwrap_or(DEFAULT_GAIN).clamp(0.0, MAX_GAIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
    use crate::experiment::dataset::search::search;
    use crate::reflection::Verdict;
    use crate::scenario::generator::{self, Spec, types};
    use crate::simulation::{Challenge, ClosedLoop};

    /// Planners that differ in what stakes look at: lane, desired speed, value, and whether Reflection accepts them.
    fn tried(planners: &[(&str, f64, f64, bool)]) -> Vec<Tried> {
        let scenario = generator::generate(&Spec::new(types::changing_lane::TYPE, 3)).unwrap();
        let drive = ClosedLoop::new(&scenario, Challenge::CLOSED_LOOP[0]).unwrap();
        let graph = LaneGraph::build(&drive.scene(), DEFAULT_NODE_LENGTH).unwrap();
        let some = search(&drive, &graph).remove(0);
        let change = |&(lane, speed, value, accepted): &(&str, f64, f64, bool)| {
            let mut tried = Tried { value, ..some.clone() };
            tried.code.centerline = lane.to_owned();
            tried.code.target_speed = speed;
            tried.reflection.verdict = if accepted { Verdict::Execute } else { Verdict::Rethink };
            tried
        };
        planners.iter().map(change).collect()
    }

    #[test]
    fn a_slow_label_is_worth_what_the_limit_would_cost() {
        let tried = tried(&[("ego_lane", 13.0, 0.1, true), ("ego_lane", 9.0, 0.7, true), ("ego_lane", 5.0, 0.9, true)]);
        let DecisionWeights { lane, speed, .. } = DecisionWeights::of(&tried[2], &tried, false);
        assert!((speed - 0.8).abs() < 1e-12 && (lane - DEFAULT_GAIN).abs() < 1e-12, "{lane} {speed}");
    }

    #[test]
    fn the_limit_is_worth_what_the_best_slower_planner_would_cost() {
        let tried = tried(&[("ego_lane", 13.0, 1.1, true), ("ego_lane", 9.0, 1.0, true), ("ego_lane", 5.0, 0.9, true)]);
        assert!((DecisionWeights::of(&tried[0], &tried, false).speed - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_lane_is_worth_what_the_best_other_lane_would_cost_if_reflection_accepts_it() {
        let tried =
            tried(&[("ego_lane", 13.0, 1.0, true), ("left_lane", 13.0, 0.6, true), ("right_lane", 13.0, 0.9, false)]);
        assert!((DecisionWeights::of(&tried[0], &tried, false).lane - 0.4).abs() < 1e-12);
        assert!(
            DecisionWeights::of(&tried[1], &tried, false).lane.abs() < 1e-12,
            "a label that is not the best is worth nothing"
        );
    }

    #[test]
    fn a_slow_first_attempt_is_worth_little_where_all_that_is_faster_is_refused() {
        let tried =
            tried(&[("ego_lane", 13.0, 1.1, false), ("ego_lane", 9.0, 0.7, true), ("ego_lane", 5.0, 0.3, true)]);
        assert!((DecisionWeights::of(&tried[1], &tried, false).speed - ASKED_AGAIN).abs() < 1e-12);
        assert!((DecisionWeights::of(&tried[1], &tried, true).speed - 0.4).abs() < 1e-12, "now it has been told");
    }

    #[test]
    fn accelerations_are_worth_what_the_best_other_pair_would_cost_and_not_what_the_speed_is_worth() {
        let mut tried =
            tried(&[("ego_lane", 13.0, 1.0, true), ("ego_lane", 13.0, 0.9, true), ("ego_lane", 5.0, 0.2, true)]);
        tried[1].code.decel_max += 1.0;
        let weights = DecisionWeights::of(&tried[0], &tried, false);
        assert!((weights.accelerations - 0.1).abs() < 1e-12 && (weights.speed - 0.8).abs() < 1e-12, "{weights:?}");
        assert!(
            (DecisionWeights::of(&tried[2], &tried, false).accelerations - DEFAULT_GAIN).abs() < 1e-12,
            "no other pair was tried"
        );
    }
}
