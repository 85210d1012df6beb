//! Suites: lists of generated scenes that have a name and stay as they are, so that results can be compared.

use super::dataset;
use crate::scenario::generator::{ScenarioType, Spec, types};
use std::collections::BTreeMap;
use std::ops::Range;

/// Seeds of each type in [`Suite::Demonstration`], from 0 on.
const DEMONSTRATION_SEEDS: u64 = 10;
/// Where the seeds of [`Suite::Candidates`] begin among the test seeds.
const FIRST_CANDIDATE: u64 = 100;
/// Seeds of each type in [`Suite::Candidates`].
const CANDIDATE_SEEDS: u64 = 100;
/// Where the seeds of [`Suite::Generated14`] begin among the test seeds: behind those of [`Suite::Candidates`]. The first 50 test seeds
/// were this suite before and are not used any more: three sets of weights were held against them.
const FIRST_COMMON: u64 = 200;
/// Seeds of each type in [`Suite::Generated14`]: with 50, differences of half a point could not be told from nothing.
const COMMON_SEEDS: u64 = 150;
/// Scenes of each type in [`Suite::Generated14Hard`].
const HARD_SCENES: usize = 20;
/// Traffic seed among which hard scenes are chosen.
const CHOSEN_AMONG: u64 = 1;
/// Traffic seed among which they are driven: what was bad luck when they were chosen does not carry over.
const DRIVEN_AMONG: u64 = 2;
/// The scenes of [`Suite::Generated14Hard`] as [`hard_list`] writes them.
const HARD_LIST: &str = include_str!("../../suites/generated-14-hard.txt");
/// What stands above them.
const HARD_HEADER: &str = "\
# generated-14-hard: of each type the 20 of 100 scenes in which PDM-Closed scores lowest among replayed traffic.
# Chosen among traffic seed 1, driven among traffic seed 2; equal scores go by seed. Made by:
#   planagent simulate --split generated-14-candidates --planner pdm-closed --out runs/candidates
#   planagent scenarios hard runs/candidates > suites/generated-14-hard.txt
";

/// A list of generated scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Suite {
    /// Every type of the generator with the seeds 0 to 9, for tests and demonstrations.
    Demonstration,
    /// nuPlan's fourteen types with 150 test seeds each.
    Generated14,
    /// nuPlan's fourteen types with 100 test seeds each, out of which the hard ones are chosen.
    Candidates,
    /// Of each of nuPlan's fourteen types the 20 candidates in which PDM-Closed scores lowest, among other traffic.
    Generated14Hard,
}

impl Suite {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Demonstration, Self::Generated14, Self::Generated14Hard, Self::Candidates];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Demonstration => "generated",
            Self::Generated14 => "generated-14",
            Self::Candidates => "generated-14-candidates",
            Self::Generated14Hard => "generated-14-hard",
        }
    }

    /// The suite of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|suite| suite.name() == name)
    }

    /// Its scenes in their order, type by type.
    pub fn specs(self) -> Vec<Spec> {
        let test = dataset::Split::Test.seeds().start;
        let (common, candidates) = (test + FIRST_COMMON, test + FIRST_CANDIDATE);
        match self {
            Self::Demonstration => each(types::in_suites(), 0..DEMONSTRATION_SEEDS),
            Self::Generated14 => each(types::nuplan14(), common..common + COMMON_SEEDS),
            Self::Candidates => {
                let own = each(types::nuplan14(), candidates..candidates + CANDIDATE_SEEDS);
                own.into_iter().map(|spec| spec.with_traffic_seed(CHOSEN_AMONG)).collect()
            }
            Self::Generated14Hard => HARD_LIST.lines().filter_map(|line| line.parse().ok()).collect(),
        }
    }
}

/// Every type with every seed.
fn each(types: impl IntoIterator<Item = ScenarioType>, seeds: Range<u64>) -> Vec<Spec> {
    let of_type = |kind| seeds.clone().map(move |seed| Spec::new(kind, seed));
    types.into_iter().flat_map(of_type).collect()
}

/// Why the hard scenes cannot be chosen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{missing} of the {} scenes of {} have no score of PDM-Closed among replayed traffic, for example {first}",
    Suite::Candidates.specs().len(),
    Suite::Candidates.name()
)]
pub struct Unscored {
    /// Candidates without a score.
    missing: usize,
    /// The first of them.
    first: Spec,
}

/// The scenes of [`Suite::Generated14Hard`], chosen by what PDM-Closed scored in those of [`Suite::Candidates`]: of each type
/// the lowest, equal scores by seed; in the order of the candidates.
///
/// # Errors
/// When a candidate has no score.
pub fn hard_scenes(scores: &BTreeMap<Spec, f64>) -> Result<Vec<Spec>, Unscored> {
    let candidates = Suite::Candidates.specs();
    let mut unscored = candidates.iter().filter(|spec| !scores.contains_key(spec));
    if let Some(&first) = unscored.next() {
        return Err(Unscored { missing: 1 + unscored.count(), first });
    }
    let of_type = candidates.chunk_by(|a, b| a.scenario_type == b.scenario_type);
    Ok(of_type.flat_map(|specs| lowest(specs, scores)).map(|spec| spec.with_traffic_seed(DRIVEN_AMONG)).collect())
}

/// The scenes with the lowest scores, by seed.
fn lowest(specs: &[Spec], scores: &BTreeMap<Spec, f64>) -> Vec<Spec> {
    let score = |spec: &Spec| scores.get(spec).copied().unwrap_or(f64::INFINITY);
    let mut chosen = specs.to_vec();
    chosen.sort_by(|a, b| score(a).total_cmp(&score(b)).then(a.cmp(b)));
    chosen.truncate(HARD_SCENES);
    chosen.sort();
    chosen
}

/// The file that holds hard scenes.
pub fn hard_list(specs: &[Spec]) -> String {
    specs.iter().fold(HARD_HEADER.to_owned(), |list, spec| format!("{list}{spec}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn suites_have_their_size_and_share_no_scene() {
        let sizes = Suite::ALL.map(|suite| suite.specs().len());
        assert_eq!(sizes, [160, 2100, 280, 1400]);
        let seeds = |suite: Suite| suite.specs().into_iter().map(|spec| spec.seed).collect::<BTreeSet<u64>>();
        let (common, hard) = (seeds(Suite::Generated14), seeds(Suite::Generated14Hard));
        assert!(common.is_disjoint(&hard) && hard.is_subset(&seeds(Suite::Candidates)));
        let test = dataset::Split::Test.seeds();
        assert!(common.iter().chain(&hard).all(|seed| test.contains(seed)));
    }

    #[test]
    fn the_hard_list_is_as_it_is_written() {
        let specs = Suite::Generated14Hard.specs();
        assert_eq!(hard_list(&specs), HARD_LIST);
        for kind in types::nuplan14() {
            assert_eq!(specs.iter().filter(|spec| spec.scenario_type == kind).count(), HARD_SCENES, "{kind}");
        }
        assert!(specs.iter().all(|spec| spec.traffic_seed == DRIVEN_AMONG));
    }

    #[test]
    fn the_lowest_are_chosen_and_equal_ones_go_by_seed() {
        let candidates = Suite::Candidates.specs();
        let mut scores: BTreeMap<Spec, f64> = candidates.iter().map(|&spec| (spec, 1.0)).collect();
        let (low, zero) = (candidates[42], candidates[99]);
        scores.extend([(low, 0.5), (zero, 0.0)]);
        let chosen = hard_scenes(&scores).unwrap();
        assert_eq!(chosen.len(), 14 * HARD_SCENES);
        let of_type: Vec<Spec> =
            chosen[..HARD_SCENES].iter().map(|spec| spec.with_traffic_seed(CHOSEN_AMONG)).collect();
        assert_eq!((&of_type[..18], &of_type[18..]), (&candidates[..18], &[low, zero][..]));

        scores.remove(&low);
        scores.remove(&candidates[50]);
        let unscored = hard_scenes(&scores).unwrap_err();
        assert_eq!(unscored, Unscored { missing: 2, first: low });
        assert!(unscored.to_string().contains("2 of the 1400 scenes of generated-14-candidates"), "{unscored}");
    }
}
