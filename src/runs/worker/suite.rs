//! Suites: named lists of generated scenarios that never change, so that results stay comparable.

use super::seeds::Split as Seeds;
use planagent_scenario::generator::{Ranges, ScenarioType, Spec, types};
use std::collections::BTreeMap;
use std::ops::Range;

/// Seeds of each type in [`Suite::DEMONSTRATION`].
const DEMONSTRATION_SEEDS: Range<u64> = 0..10;
/// Test seeds of each type in [`Suite::CANDIDATES`].
const CANDIDATE_SEEDS: Range<u64> = 350..450;
/// Test seeds of each type in [`Suite::TEST14`]. The first 350 test seeds belonged to suites
/// before: they were simulated, with sparser lanes.
const TEST14_SEEDS: Range<u64> = 450..600;
/// Test seeds of each type in [`Suite::TEST14_WIDE`].
const WIDE_SEEDS: Range<u64> = 600..620;
/// Scenarios of each type in [`Suite::TEST14_HARD`].
const HARD_SCENARIOS: usize = 20;
/// Traffic seed of the candidates.
const CANDIDATE_TRAFFIC: u64 = 1;
/// Traffic seed of the hard scenarios. It differs, so that bad luck in the selection does not carry
/// over.
const HARD_TRAFFIC: u64 = 2;
/// [`Suite::TEST14_HARD`] as [`hard_list`] writes it.
const HARD_LIST: &str = include_str!("../../../suites/generated-test14-hard.txt");
const HARD_HEADER: &str = "\
# generated-test14-hard: of each type the 20 of 100 scenarios with the lowest scores of PDM-Closed with non-reactive agents.
# Selected with traffic seed 1, simulated with traffic seed 2; equal scores are ordered by seed. Made by:
#   planagent simulate --split generated-test14-candidates --planner pdm-closed --out runs/candidates
#   planagent scenarios hard runs/candidates > suites/generated-test14-hard.txt
";

/// Name of the suite of the recordings at hand, which has no fixed list.
pub const RECORDED: &str = "recorded";

/// A suite of generated scenarios.
#[derive(Debug, Clone, Copy)]
pub struct Suite {
    /// Name on the command line.
    pub name: &'static str,
    specs: fn() -> Vec<Spec>,
}

impl Suite {
    /// Every type with the seeds 0 to 9, for tests and demonstrations.
    pub const DEMONSTRATION: Self = Self {
        name: "generated",
        specs: || each(types::in_suites(), DEMONSTRATION_SEEDS),
    };
    /// nuPlan's fourteen types with 150 test seeds each.
    pub const TEST14: Self = Self {
        name: "generated-test14",
        specs: || each(types::nuplan14(), test_seeds(TEST14_SEEDS)),
    };
    /// Of each of nuPlan's fourteen types the 20 candidates with the lowest scores of PDM-Closed,
    /// with other traffic.
    pub const TEST14_HARD: Self = Self {
        name: "generated-test14-hard",
        specs: || {
            HARD_LIST
                .lines()
                .filter_map(|line| line.parse().ok())
                .collect()
        },
    };
    /// nuPlan's fourteen types with 20 test seeds each, drawn from the wider ranges of recordings.
    pub const TEST14_WIDE: Self = Self {
        name: "generated-test14-wide",
        specs: || {
            each(types::nuplan14(), test_seeds(WIDE_SEEDS))
                .into_iter()
                .map(|spec| spec.drawn_from(Ranges::Wide))
                .collect()
        },
    };
    /// nuPlan's fourteen types with 100 test seeds each, from which the hard scenarios are
    /// selected.
    pub const CANDIDATES: Self = Self {
        name: "generated-test14-candidates",
        specs: || {
            let own = each(types::nuplan14(), test_seeds(CANDIDATE_SEEDS));
            own.into_iter()
                .map(|spec| spec.with_traffic_seed(CANDIDATE_TRAFFIC))
                .collect()
        },
    };
    /// Suites drawn before lanes had a vertex every half meter. Their scenes cannot be made any
    /// more.
    pub const RETIRED: [&str; 3] = [
        "generated-14",
        "generated-14-hard",
        "generated-14-candidates",
    ];
    pub const ALL: [Self; 5] = [
        Self::DEMONSTRATION,
        Self::TEST14,
        Self::TEST14_HARD,
        Self::TEST14_WIDE,
        Self::CANDIDATES,
    ];

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|suite| suite.name == name)
    }

    /// The scenarios in order, type by type.
    pub fn specs(&self) -> Vec<Spec> {
        (self.specs)()
    }
}

fn test_seeds(seeds: Range<u64>) -> Range<u64> {
    let first = Seeds::Test.seeds().start;
    first + seeds.start..first + seeds.end
}

/// Every type with every seed.
fn each(types: impl IntoIterator<Item = ScenarioType>, seeds: Range<u64>) -> Vec<Spec> {
    let of_type = |kind| seeds.clone().map(move |seed| Spec::new(kind, seed));
    types.into_iter().flat_map(of_type).collect()
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{missing} of the {} scenarios of {} have no score of PDM-Closed with non-reactive agents, for example {first}",
    Suite::CANDIDATES.specs().len(),
    Suite::CANDIDATES.name
)]
pub struct Unscored {
    missing: usize,
    first: Spec,
}

/// Selects [`Suite::TEST14_HARD`] by PDM-Closed's scores on [`Suite::CANDIDATES`]: the lowest of
/// each type, equal scores by seed, in the order of the candidates. Fails if a candidate has no
/// score.
pub fn hard_scenarios(scores: &BTreeMap<Spec, f64>) -> Result<Vec<Spec>, Unscored> {
    let candidates = Suite::CANDIDATES.specs();
    let mut unscored = candidates.iter().filter(|spec| !scores.contains_key(spec));
    if let Some(&first) = unscored.next() {
        return Err(Unscored {
            missing: 1 + unscored.count(),
            first,
        });
    }
    let of_type = candidates.chunk_by(|a, b| a.scenario_type == b.scenario_type);
    Ok(of_type
        .flat_map(|specs| lowest(specs, scores))
        .map(|spec| spec.with_traffic_seed(HARD_TRAFFIC))
        .collect())
}

/// The scenarios with the lowest scores, by seed.
fn lowest(specs: &[Spec], scores: &BTreeMap<Spec, f64>) -> Vec<Spec> {
    let score = |spec: &Spec| scores.get(spec).copied().unwrap_or(f64::INFINITY);
    let mut selected = specs.to_vec();
    selected.sort_by(|a, b| score(a).total_cmp(&score(b)).then(a.cmp(b)));
    selected.truncate(HARD_SCENARIOS);
    selected.sort();
    selected
}

/// The text of `suites/generated-test14-hard.txt`.
pub fn hard_list(specs: &[Spec]) -> String {
    specs.iter().fold(HARD_HEADER.to_owned(), |list, spec| {
        format!("{list}{spec}\n")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn suites_have_their_size_and_share_no_scenario() {
        let sizes = Suite::ALL.map(|suite| suite.specs().len());
        assert_eq!(sizes, [160, 2100, 280, 280, 1400]);
        let seeds = |suite: Suite| {
            suite
                .specs()
                .into_iter()
                .map(|spec| spec.seed)
                .collect::<BTreeSet<u64>>()
        };
        let (common, hard) = (seeds(Suite::TEST14), seeds(Suite::TEST14_HARD));
        assert!(common.is_disjoint(&hard) && hard.is_subset(&seeds(Suite::CANDIDATES)));
        let wide = seeds(Suite::TEST14_WIDE);
        assert!(wide.is_disjoint(&common) && wide.is_disjoint(&seeds(Suite::CANDIDATES)));
        let test = Seeds::Test.seeds();
        assert!(
            common
                .iter()
                .chain(&hard)
                .chain(&wide)
                .all(|seed| test.contains(seed))
        );
    }

    #[test]
    fn the_hard_list_is_as_it_is_written() {
        let specs = Suite::TEST14_HARD.specs();
        assert_eq!(hard_list(&specs), HARD_LIST);
        for kind in types::nuplan14() {
            assert_eq!(
                specs
                    .iter()
                    .filter(|spec| spec.scenario_type == kind)
                    .count(),
                HARD_SCENARIOS,
                "{kind}"
            );
        }
        assert!(specs.iter().all(|spec| spec.traffic_seed == HARD_TRAFFIC));
    }

    #[test]
    fn the_lowest_are_selected_and_equal_ones_ordered_by_seed() {
        let candidates = Suite::CANDIDATES.specs();
        let mut scores: BTreeMap<Spec, f64> = candidates.iter().map(|&spec| (spec, 1.0)).collect();
        let (low, zero) = (candidates[42], candidates[99]);
        scores.extend([(low, 0.5), (zero, 0.0)]);
        let selected = hard_scenarios(&scores).unwrap();
        assert_eq!(selected.len(), 14 * HARD_SCENARIOS);
        let of_type: Vec<Spec> = selected[..HARD_SCENARIOS]
            .iter()
            .map(|spec| spec.with_traffic_seed(CANDIDATE_TRAFFIC))
            .collect();
        assert_eq!(
            (&of_type[..18], &of_type[18..]),
            (&candidates[..18], &[low, zero][..])
        );

        scores.remove(&low);
        scores.remove(&candidates[50]);
        let unscored = hard_scenarios(&scores).unwrap_err();
        assert_eq!(
            unscored,
            Unscored {
                missing: 2,
                first: low
            }
        );
        assert!(
            unscored
                .to_string()
                .contains("2 of the 1400 scenarios of generated-test14-candidates"),
            "{unscored}"
        );
    }
}
