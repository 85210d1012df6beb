//! Scores with intervals, and paired differences: over all scenes of an entrant, and over the
//! scenes that all completed. An entrant is a planner of a run.

use super::source::RunSimulations;
use crate::report::simulation_row::SimulationRow;
use crate::worker::statistics::{Bootstrap, PairedDifference};
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::distinct;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// The scores of one challenge, nuPlan's score x 100.
#[derive(Debug, Serialize)]
pub(super) struct Comparison {
    challenge: Challenge,
    /// Scenes that any entrant was simulated on.
    scenes: usize,
    /// Scenes that every entrant completed.
    common: usize,
    entrants: Vec<EntrantScores>,
    differences: Vec<Difference>,
}

/// The scores of an entrant.
#[derive(Debug, Serialize)]
struct EntrantScores {
    /// Index of the run.
    run: usize,
    planner: String,
    /// On all scenes that it completed.
    all: Option<Scores>,
    /// On the scenes that every entrant completed.
    common: Option<Scores>,
}

/// Mean scores, overall and by scenario type.
#[derive(Debug, Serialize)]
struct Scores {
    #[serde(flatten)]
    overall: Interval,
    types: BTreeMap<String, Interval>,
}

/// Score of one entrant minus that of another, on the scenes that both completed.
#[derive(Debug, Serialize)]
struct Difference {
    /// Places in [`Comparison::entrants`].
    of: usize,
    from: usize,
    #[serde(flatten)]
    value: Interval,
}

/// A mean with its 95 % bootstrap interval over scenes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Interval {
    mean: f64,
    low: f64,
    high: f64,
    scenes: usize,
}

/// Completed scenes of an entrant: score x 100 and scenario type, by log and name.
struct Completed<'a> {
    run: usize,
    planner: &'a str,
    scenes: BTreeMap<Scene<'a>, (f64, &'a str)>,
}

/// Log and name of a scenario.
type Scene<'a> = (&'a str, &'a str);

/// The comparison of each challenge.
pub(super) fn comparisons(runs: &[RunSimulations]) -> Vec<Comparison> {
    let rows: Vec<(usize, &SimulationRow)> = runs
        .iter()
        .enumerate()
        .flat_map(|(run, of_run)| of_run.rows.iter().map(move |row| (run, row)))
        .collect();
    let challenges = distinct(rows.iter().map(|(_, row)| &row.challenge));
    challenges
        .into_iter()
        .map(|challenge| comparison(*challenge, &rows))
        .collect()
}

fn comparison(challenge: Challenge, rows: &[(usize, &SimulationRow)]) -> Comparison {
    let own: Vec<(usize, &SimulationRow)> = rows
        .iter()
        .filter(|(_, row)| row.challenge == challenge)
        .copied()
        .collect();
    let scene = |row: &SimulationRow| (row.log_name.clone(), row.scenario.clone());
    let scenes: BTreeSet<_> = own.iter().map(|(_, row)| scene(row)).collect();
    let entrants: Vec<Completed<'_>> =
        distinct(own.iter().map(|(run, row)| (*run, row.planner.as_str())))
            .into_iter()
            .map(|(run, planner)| Completed::from_rows(run, planner, &own))
            .collect();
    let common = common(&entrants);
    // Each pair once: the page turns the sign for the other direction.
    let pairs: Vec<(usize, usize)> = (0..entrants.len())
        .flat_map(|of| (0..of).map(move |from| (of, from)))
        .collect();
    let difference = |(of, from): (usize, usize)| {
        let (own, other) = (entrants.get(of)?, entrants.get(from)?);
        Some(Difference {
            of,
            from,
            value: own.difference(other)?,
        })
    };
    Comparison {
        challenge,
        scenes: scenes.len(),
        common: common.len(),
        entrants: entrants
            .par_iter()
            .map(|entrant| entrant.scores(&common))
            .collect(),
        differences: pairs.into_par_iter().filter_map(difference).collect(),
    }
}

/// The scenes that all entrants completed.
fn common<'a>(entrants: &[Completed<'a>]) -> BTreeSet<Scene<'a>> {
    let Some((first, others)) = entrants.split_first() else {
        return BTreeSet::new();
    };
    first
        .scenes
        .keys()
        .filter(|scene| others.iter().all(|other| other.scenes.contains_key(*scene)))
        .copied()
        .collect()
}

impl<'a> Completed<'a> {
    fn from_rows(run: usize, planner: &'a str, rows: &[(usize, &'a SimulationRow)]) -> Self {
        let own = rows
            .iter()
            .filter(|(of_run, row)| *of_run == run && row.planner == planner);
        let scored = own.filter_map(|(_, row)| {
            let scene = (row.log_name.as_str(), row.scenario.as_str());
            Some((scene, (100.0 * row.score?, row.scenario_type.as_str())))
        });
        Self {
            run,
            planner,
            scenes: scored.collect(),
        }
    }

    fn scores(&self, common: &BTreeSet<Scene<'a>>) -> EntrantScores {
        let all: Vec<_> = self.scenes.values().copied().collect();
        let shared: Vec<_> = common
            .iter()
            .filter_map(|scene| self.scenes.get(scene))
            .copied()
            .collect();
        EntrantScores {
            run: self.run,
            planner: self.planner.to_owned(),
            all: Scores::from_scenes(&all),
            common: Scores::from_scenes(&shared),
        }
    }

    fn difference(&self, other: &Self) -> Option<Interval> {
        let differences: Vec<f64> = self
            .scenes
            .iter()
            .filter_map(|(scene, (score, _))| Some(score - other.scenes.get(scene)?.0))
            .collect();
        interval(&differences)
    }
}

impl Scores {
    fn from_scenes(scenes: &[(f64, &str)]) -> Option<Self> {
        let mut types: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (score, kind) in scenes {
            types.entry(kind).or_default().push(*score);
        }
        let scores: Vec<f64> = scenes.iter().map(|(score, _)| *score).collect();
        let by_type = types
            .into_iter()
            .filter_map(|(kind, scores)| Some((kind.to_owned(), interval(&scores)?)));
        Some(Self {
            overall: interval(&scores)?,
            types: by_type.collect(),
        })
    }
}

/// Mean and interval; none without a value.
fn interval(values: &[f64]) -> Option<Interval> {
    let PairedDifference {
        mean,
        low,
        high,
        pairs,
        ..
    } = Bootstrap::default().difference(values)?;
    Some(Interval {
        mean,
        low,
        high,
        scenes: pairs,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kind: &str, seed: usize, planner: &str, score: Option<f64>) -> SimulationRow {
        SimulationRow::example(kind, seed, planner, Challenge::NonReactive, score)
    }

    #[test]
    fn runs_are_compared_on_the_scenes_that_all_completed() {
        let rows = [
            (0, row("turn", 0, "mine", Some(0.9))),
            (0, row("turn", 1, "mine", Some(0.5))),
            (0, row("lane", 2, "mine", Some(0.1))),
            (1, row("turn", 0, "other", Some(0.6))),
            (1, row("turn", 1, "other", None)),
            (1, row("stop", 3, "other", Some(1.0))),
        ];
        let rows: Vec<(usize, &SimulationRow)> =
            rows.iter().map(|(run, row)| (*run, row)).collect();
        let found = comparison(Challenge::NonReactive, &rows);
        assert_eq!(
            (found.scenes, found.common, found.entrants.len()),
            (4, 1, 2)
        );
        let [mine, other] = found.entrants.as_slice() else {
            panic!("{:?}", found.entrants)
        };
        let all = mine.all.as_ref().unwrap();
        assert!(
            (all.overall.mean - 50.0).abs() < 1e-9 && all.overall.scenes == 3,
            "{all:?}"
        );
        assert!(
            all.overall.low >= 10.0 && all.overall.low < 40.0 && all.overall.high <= 90.0,
            "{all:?}"
        );
        assert!(
            (all.types["turn"].mean - 70.0).abs() < 1e-9 && all.types.len() == 2,
            "{all:?}"
        );
        let common = other.common.as_ref().unwrap();
        assert!(
            (common.overall.mean - 60.0).abs() < 1e-9 && common.overall.scenes == 1,
            "{common:?}"
        );
        let [difference] = found.differences.as_slice() else {
            panic!("{:?}", found.differences)
        };
        assert_eq!(
            (difference.of, difference.from, difference.value.scenes),
            (1, 0, 1)
        );
        assert!(
            (difference.value.mean + 30.0).abs() < 1e-9,
            "{difference:?}"
        );
    }

    #[test]
    fn an_entrant_that_failed_everywhere_leaves_no_common_scene() {
        let rows = [
            (0, row("turn", 0, "mine", Some(0.9))),
            (0, row("turn", 0, "other", None)),
        ];
        let rows: Vec<(usize, &SimulationRow)> =
            rows.iter().map(|(run, row)| (*run, row)).collect();
        let found = comparison(Challenge::NonReactive, &rows);
        assert_eq!((found.scenes, found.common), (1, 0));
        assert!(
            found.differences.is_empty()
                && found
                    .entrants
                    .iter()
                    .all(|entrant| entrant.common.is_none())
        );
        assert!(found.entrants[1].all.is_none());
    }
}
