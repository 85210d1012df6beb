//! What hangs on a label's decisions: a model that cannot tell which of two futures comes has to weigh what each choice would cost.
//!
//! The best of one future alone says that a person who steps onto the road in one of three futures is no reason to slow down. Weighed
//! by what is at stake, the likeliest answer becomes the one that is best on average.

use super::search::Tried;

/// What a decision is worth that nothing was tried against: about what full progress adds to a value, for a third of the limit.
const USUAL: f64 = 0.06;
/// No decision is worth more than a score.
const MOST: f64 = 1.0;

/// What the decisions of a label are worth, as differences of [`Tried::value`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stakes {
    /// Of the lane: over the best in another lane.
    pub(super) lane: f64,
    /// Of the speed: of slow driving over the fastest, of the fastest over the best that is slower.
    pub(super) speed: f64,
}

impl Stakes {
    /// What the best of the planners that were tried is worth over the others. Those that Reflection would refuse do not count: the
    /// model would be asked again.
    pub(super) fn of(best: &Tried, tried: &[Tried]) -> Self {
        let (lane, speed) = (&best.code.centerline, best.code.target_speed);
        let accepted = || tried.iter().filter(|t| t.is_accepted());
        let in_lane = || accepted().filter(|t| t.code.centerline == *lane);
        let fastest = in_lane().map(|t| t.code.target_speed).fold(speed, f64::max);
        let elsewhere = accepted().filter(|t| t.code.centerline != *lane);
        let at_other_speeds = in_lane().filter(|t| {
            let other = t.code.target_speed;
            if speed < fastest { other >= fastest } else { other < fastest }
        });
        Self { lane: gain(best, elsewhere), speed: gain(best, at_other_speeds) }
    }
}

/// What the best has over the best of others.
fn gain<'a>(best: &Tried, others: impl Iterator<Item = &'a Tried>) -> f64 {
    others.map(|other| best.value - other.value).reduce(f64::min).unwrap_or(USUAL).clamp(0.0, MOST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
    use crate::experiment::dataset::search::search;
    use crate::reflection::Verdict;
    use crate::scenario::generator::{self, ScenarioType, Spec};
    use crate::simulation::{Challenge, ClosedLoop};

    /// Planners that differ in what stakes look at: lane, desired speed, value, and whether Reflection accepts them.
    fn tried(planners: &[(&str, f64, f64, bool)]) -> Vec<Tried> {
        let scenario = generator::generate(&Spec::new(ScenarioType::ChangingLane, 3)).unwrap();
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
        let Stakes { lane, speed } = Stakes::of(&tried[2], &tried);
        assert!((speed - 0.8).abs() < 1e-12 && (lane - USUAL).abs() < 1e-12, "{lane} {speed}");
    }

    #[test]
    fn the_limit_is_worth_what_the_best_slower_planner_would_cost() {
        let tried = tried(&[("ego_lane", 13.0, 1.1, true), ("ego_lane", 9.0, 1.0, true), ("ego_lane", 5.0, 0.9, true)]);
        assert!((Stakes::of(&tried[0], &tried).speed - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_lane_is_worth_what_the_best_other_lane_would_cost_if_reflection_accepts_it() {
        let tried =
            tried(&[("ego_lane", 13.0, 1.0, true), ("left_lane", 13.0, 0.6, true), ("right_lane", 13.0, 0.9, false)]);
        assert!((Stakes::of(&tried[0], &tried).lane - 0.4).abs() < 1e-12);
        assert!(Stakes::of(&tried[1], &tried).lane.abs() < 1e-12, "a label that is not the best is worth nothing");
    }
}
