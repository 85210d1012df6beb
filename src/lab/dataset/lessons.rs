//! The codes that a model learns from a state in expert iteration.
//!
//! The lane, the speed and the accelerations are decided one after another. Each option has a
//! chance in proportion to its gain over the worst option, and the decision weighs as the sum of
//! these gains. Over many states, the likeliest option of a model that learns so has the highest
//! mean value.

use super::label_weights::{DEFAULT_GAIN, DecisionWeights, MAX_GAIN, RETRY_GAIN, rejects_faster};
use planagent_agent::reasoning::PlannerCode;
use planagent_controls::search::Candidate;

/// A code that may be the one to learn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lesson<'a> {
    pub(super) candidate: &'a Candidate,
    /// From 0 to 1. The chances of a state sum up to 1.
    pub(super) chance: f64,
    /// Weights of the three decisions, as sums of gains.
    pub(super) weights: DecisionWeights,
}

/// The best candidate and those that Reflection accepts, without those that have no chance.
/// `after_rejection` is true if the prompt already reports a rejection.
pub(super) fn lessons<'a>(
    best: &'a Candidate,
    tried: &'a [Candidate],
    after_rejection: bool,
) -> Vec<Lesson<'a>> {
    // The best code counts even where Reflection rejects it, so that each state has a lesson.
    let codes: Vec<&Candidate> = tried
        .iter()
        .filter(|t| t.is_accepted() || t.code == best.code)
        .collect();
    let lesson = |&candidate: &&'a Candidate| {
        let lane = Decision::among(&codes, &candidate.code, |code| code.centerline);
        let mut speed = Decision::among(&lane.codes, &candidate.code, |code| code.target_speed);
        let accelerations = Decision::among(&speed.codes, &candidate.code, |code| {
            (code.accel_max, code.decel_max)
        });
        if !after_rejection && rejects_faster(tried, &candidate.code) {
            speed.weight = RETRY_GAIN;
        }
        let weights = DecisionWeights {
            lane: lane.weight,
            speed: speed.weight,
            accelerations: accelerations.weight,
        };
        Lesson {
            candidate,
            chance: lane.chance * speed.chance * accelerations.chance,
            weights,
        }
    };
    codes
        .iter()
        .map(lesson)
        .filter(|lesson| lesson.chance > 0.0)
        .collect()
}

/// One decision of a code.
struct Decision<'a> {
    /// Of the code's option.
    chance: f64,
    /// Of the decision in the loss, as a gain.
    weight: f64,
    /// The codes that decide the same.
    codes: Vec<&'a Candidate>,
}

impl<'a> Decision<'a> {
    /// The decision among codes that agree on those before it. `option` is what a code decides.
    fn among<T: PartialEq>(
        codes: &[&'a Candidate],
        own: &PlannerCode,
        option: impl Fn(&PlannerCode) -> T,
    ) -> Self {
        let mut options: Vec<(T, f64)> = Vec::new();
        for candidate in codes {
            let decided = option(&candidate.code);
            match options.iter_mut().find(|(other, _)| *other == decided) {
                Some((_, best)) => *best = best.max(candidate.value),
                None => options.push((decided, candidate.value)),
            }
        }
        let same: Vec<&Candidate> = codes
            .iter()
            .filter(|t| option(&t.code) == option(own))
            .copied()
            .collect();
        // A single option gains nothing over the worst, which is itself.
        if options.len() < 2 {
            return Self {
                chance: 1.0,
                weight: DEFAULT_GAIN,
                codes: same,
            };
        }
        let worst = options
            .iter()
            .map(|(_, value)| *value)
            .fold(f64::INFINITY, f64::min);
        let gain = |value: f64| (value - worst).min(MAX_GAIN);
        let sum: f64 = options.iter().map(|(_, value)| gain(*value)).sum();
        let value = same.iter().map(|t| t.value).fold(worst, f64::max);
        let chance = if sum > 0.0 {
            gain(value) / sum
        } else {
            1.0 / options.len() as f64
        };
        Self {
            chance,
            weight: sum,
            codes: same,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::label_weights::tests::tried as tried_of;
    use planagent_controls::search;

    fn all(tried: &[Candidate], after_rejection: bool) -> Vec<Lesson<'_>> {
        lessons(search::best(tried).unwrap(), tried, after_rejection)
    }

    #[test]
    fn lanes_have_chances_by_their_gains_over_the_worst() {
        let tried = tried_of(&[
            ("ego_lane", 13.0, 1.0, true),
            ("left_lane", 13.0, 0.8, true),
            ("right_lane", 13.0, 0.2, true),
        ]);
        let lessons = all(&tried, false);
        let found: Vec<f64> = lessons.iter().map(|lesson| lesson.chance).collect();
        assert!(
            (found[0] - 0.8 / 1.4).abs() < 1e-12 && (found[1] - 0.6 / 1.4).abs() < 1e-12,
            "{found:?}"
        );
        assert_eq!(found.len(), 2, "the worst lane has no chance");
        assert!(
            lessons
                .iter()
                .all(|lesson| (lesson.weights.lane - 1.4).abs() < 1e-12)
        );
    }

    #[test]
    fn a_lane_is_worth_its_best_speed_and_slow_speeds_do_not_add_to_it() {
        let tried = tried_of(&[
            ("ego_lane", 13.0, 0.1, true),
            ("ego_lane", 9.0, 0.5, true),
            ("ego_lane", 5.0, 0.9, true),
            ("left_lane", 13.0, 0.4, true),
        ]);
        let lessons = all(&tried, true);
        let found: Vec<(f64, f64)> = lessons
            .iter()
            .map(|c| (c.candidate.code.target_speed, c.chance))
            .collect();
        assert_eq!(
            found.len(),
            2,
            "the fastest speed and the other lane are the worst options: {found:?}"
        );
        assert!(
            (found[0].1 - 0.4 / 1.2).abs() < 1e-12 && (found[1].1 - 0.8 / 1.2).abs() < 1e-12,
            "{found:?}"
        );
        assert!(
            (lessons[0].weights.lane - 0.5).abs() < 1e-12
                && (lessons[0].weights.speed - 1.2).abs() < 1e-12
        );
    }

    /// Weight of the speed of the slow code, if that has a chance.
    fn slow_weight(tried: &[Candidate], after_rejection: bool) -> Option<f64> {
        let lessons = all(tried, after_rejection);
        lessons
            .iter()
            .find(|lesson| lesson.candidate.code.target_speed < 10.0)
            .map(|lesson| lesson.weights.speed)
    }

    #[test]
    fn rejected_codes_have_no_chance_and_make_slower_ones_weigh_little_at_first() {
        let worst_lane = tried_of(&[
            ("ego_lane", 13.0, 0.95, false),
            ("ego_lane", 9.0, 0.7, true),
            ("left_lane", 13.0, 1.0, true),
        ]);
        assert_eq!(slow_weight(&worst_lane, false), None);
        let one_lane = tried_of(&[
            ("ego_lane", 13.0, 0.95, false),
            ("ego_lane", 9.0, 1.0, true),
        ]);
        assert_eq!(all(&one_lane, false).len(), 1);
        assert_eq!(slow_weight(&one_lane, false), Some(RETRY_GAIN));
        assert_eq!(
            slow_weight(&one_lane, true),
            Some(DEFAULT_GAIN),
            "no other speed is accepted"
        );
    }

    #[test]
    fn chances_sum_up_to_one() {
        let tried = tried_of(&[
            ("ego_lane", 13.0, 0.6, true),
            ("ego_lane", 9.0, 0.6, true),
            ("left_lane", 13.0, 0.6, true),
            ("right_lane", 13.0, 0.6, false),
        ]);
        let sum: f64 = all(&tried, false).iter().map(|lesson| lesson.chance).sum();
        assert!((sum - 1.0).abs() < 1e-12, "{sum}");
    }
}
