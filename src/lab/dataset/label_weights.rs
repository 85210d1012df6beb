//! Weights of a label's decisions, by regret.
//!
//! A label is the best of one future, but a model cannot predict which future comes. A pedestrian
//! who steps onto the road in one of three futures would be no reason to slow down. Weighted by
//! their gains, the likeliest answer is the best on average.

use planagent_agent::reasoning::PlannerCode;
use planagent_controls::search::Candidate;

/// Gain of a decision without a tried alternative: about the progress bonus of a third of the
/// limit.
pub(super) const DEFAULT_GAIN: f64 = 0.06;
/// Maximum gain: a whole score.
pub(super) const MAX_GAIN: f64 = 1.0;
/// Gain of a slow first attempt if Reflection rejects every faster one. It is small, since a
/// rejection leads to another attempt.
pub(super) const RETRY_GAIN: f64 = 0.01;

/// Gains of a label's decisions, as differences of [`Candidate::value`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DecisionWeights {
    /// Of the lane: over the best candidate in another lane.
    pub(super) lane: f64,
    /// Of the speed: of a slow candidate over the fastest, of the fastest over the best slower one.
    pub(super) speed: f64,
    /// Of the accelerations: over the best other pair with this lane and speed.
    pub(super) accelerations: f64,
}

impl DecisionWeights {
    /// Those of all three decisions.
    pub(super) fn sum(&self) -> f64 {
        self.lane + self.speed + self.accelerations
    }

    /// Gains of the best candidate over the others. Rejected candidates do not count, since another
    /// attempt would follow. `after_rejection` is true if the prompt already reports a rejection.
    pub(super) fn from_candidates(
        best: &Candidate,
        tried: &[Candidate],
        after_rejection: bool,
    ) -> Self {
        let (lane, speed) = (best.code.centerline, best.code.target_speed);
        let accepted = || tried.iter().filter(|t| t.is_accepted());
        let in_lane = || accepted().filter(|t| t.code.centerline == lane);
        let fastest = in_lane().map(|t| t.code.target_speed).fold(speed, f64::max);
        let elsewhere = accepted().filter(|t| t.code.centerline != lane);
        // The decision is whether to slow down: a slower best code is compared with full speed, and
        // the reverse.
        let at_other_speeds = in_lane().filter(|t| {
            let other = t.code.target_speed;
            if speed < fastest {
                other >= fastest
            } else {
                other < fastest
            }
        });
        let PlannerCode {
            accel_max,
            decel_max,
            ..
        } = best.code;
        let with_other_pairs = accepted().filter(|t| {
            t.code != best.code
                && PlannerCode {
                    accel_max,
                    decel_max,
                    ..t.code
                } == best.code
        });
        let retried = !after_rejection && rejects_faster(tried, &best.code);
        let speed = if retried {
            RETRY_GAIN
        } else {
            gain(best, at_other_speeds)
        };
        Self {
            lane: gain(best, elsewhere),
            speed,
            accelerations: gain(best, with_other_pairs),
        }
    }
}

/// True if Reflection rejects a candidate in a code's lane that is faster than the code and all
/// accepted ones.
pub(super) fn rejects_faster(tried: &[Candidate], code: &PlannerCode) -> bool {
    let in_lane = || {
        tried
            .iter()
            .filter(|t| t.code.centerline == code.centerline)
    };
    let speeds = in_lane()
        .filter(|t| t.is_accepted())
        .map(|t| t.code.target_speed);
    let fastest = speeds.fold(code.target_speed, f64::max);
    in_lane().any(|t| t.code.target_speed > fastest && !t.is_accepted())
}

/// Gain of the best candidate over the best of others.
fn gain<'a>(best: &Candidate, others: impl Iterator<Item = &'a Candidate>) -> f64 {
    others
        .map(|other| best.value - other.value)
        .reduce(f64::min)
        .unwrap_or(DEFAULT_GAIN)
        .clamp(0.0, MAX_GAIN)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
    use planagent_agent::reflection::Verdict;
    use planagent_agent::simulation::{Challenge, ClosedLoop};
    use planagent_controls::search::search;
    use planagent_scenario::generator::{self, Spec, types};

    /// Candidates with these lanes, desired speeds and values, accepted by Reflection or not.
    pub(in crate::dataset) fn tried(planners: &[(&str, f64, f64, bool)]) -> Vec<Candidate> {
        let scenario = generator::generate(&Spec::new(types::changing_lane::TYPE, 3)).unwrap();
        let simulation = ClosedLoop::new(&scenario, Challenge::CLOSED_LOOP[0]).unwrap();
        let graph = LaneGraph::build(&simulation.scene(), DEFAULT_NODE_LENGTH).unwrap();
        let some = search(&simulation, &graph).remove(0);
        let change = |&(lane, speed, value, accepted): &(&str, f64, f64, bool)| {
            let mut tried = Candidate {
                value,
                ..some.clone()
            };
            tried.code.centerline = lane.parse().unwrap();
            tried.code.target_speed = speed;
            tried.reflection.verdict = if accepted {
                Verdict::Execute
            } else {
                Verdict::Rethink
            };
            tried
        };
        planners.iter().map(change).collect()
    }

    #[test]
    fn a_slow_label_gains_what_the_limit_would_cost() {
        let tried = tried(&[
            ("ego_lane", 13.0, 0.1, true),
            ("ego_lane", 9.0, 0.7, true),
            ("ego_lane", 5.0, 0.9, true),
        ]);
        let DecisionWeights { lane, speed, .. } =
            DecisionWeights::from_candidates(&tried[2], &tried, false);
        assert!(
            (speed - 0.8).abs() < 1e-12 && (lane - DEFAULT_GAIN).abs() < 1e-12,
            "{lane} {speed}"
        );
    }

    #[test]
    fn the_limit_gains_what_the_best_slower_candidate_would_cost() {
        let tried = tried(&[
            ("ego_lane", 13.0, 1.1, true),
            ("ego_lane", 9.0, 1.0, true),
            ("ego_lane", 5.0, 0.9, true),
        ]);
        assert!(
            (DecisionWeights::from_candidates(&tried[0], &tried, false).speed - 0.1).abs() < 1e-12
        );
    }

    #[test]
    fn a_lane_gains_what_the_best_accepted_other_lane_would_cost() {
        let tried = tried(&[
            ("ego_lane", 13.0, 1.0, true),
            ("left_lane", 13.0, 0.6, true),
            ("right_lane", 13.0, 0.9, false),
        ]);
        assert!(
            (DecisionWeights::from_candidates(&tried[0], &tried, false).lane - 0.4).abs() < 1e-12
        );
        assert!(
            DecisionWeights::from_candidates(&tried[1], &tried, false)
                .lane
                .abs()
                < 1e-12,
            "a label that is not the best gains nothing"
        );
    }

    #[test]
    fn a_slow_first_attempt_gains_little_if_all_faster_ones_are_rejected() {
        let tried = tried(&[
            ("ego_lane", 13.0, 1.1, false),
            ("ego_lane", 9.0, 0.7, true),
            ("ego_lane", 5.0, 0.3, true),
        ]);
        assert!(
            (DecisionWeights::from_candidates(&tried[1], &tried, false).speed - RETRY_GAIN).abs()
                < 1e-12
        );
        assert!(
            (DecisionWeights::from_candidates(&tried[1], &tried, true).speed - 0.4).abs() < 1e-12,
            "the rejection is known"
        );
    }

    #[test]
    fn accelerations_gain_what_the_best_other_pair_would_cost() {
        let mut tried = tried(&[
            ("ego_lane", 13.0, 1.0, true),
            ("ego_lane", 13.0, 0.9, true),
            ("ego_lane", 5.0, 0.2, true),
        ]);
        tried[1].code.decel_max += 1.0;
        let weights = DecisionWeights::from_candidates(&tried[0], &tried, false);
        assert!(
            (weights.accelerations - 0.1).abs() < 1e-12 && (weights.speed - 0.8).abs() < 1e-12,
            "{weights:?}"
        );
        assert!(
            (DecisionWeights::from_candidates(&tried[2], &tried, false).accelerations
                - DEFAULT_GAIN)
                .abs()
                < 1e-12,
            "no other pair was tried"
        );
    }
}
