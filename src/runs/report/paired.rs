//! The scores of two runs on the scenes that both have.

use super::manifest::Manifest;
use super::simulation_row::SimulationRow;
use crate::worker::statistics::{Bootstrap, PairedDifference};
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::distinct;
use serde::Serialize;
use std::collections::BTreeMap;

/// Start of the keys that two runs may have different without a remark.
const EXPECTED_DIFFERENCES: [&str; 3] = ["scenarios.", "challenges", "other planners"];

/// The planners that are compared: one of the first run, one of the second.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PlannerPair {
    /// The planner of the first run.
    pub first: String,
    /// The planner of the second run.
    pub second: String,
}

/// The scores of a pair of planners in a challenge, x 100.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparedScores {
    /// The planners.
    pub planners: PlannerPair,
    /// nuPlan's challenge.
    pub challenge: Challenge,
    /// nuPlan's scenario type; none for all scenes.
    pub scenario_type: Option<String>,
    /// Mean score of the first run on the common scenes.
    pub first: f64,
    /// Mean score of the second run on the common scenes.
    pub second: f64,
    /// The second minus the first, scene by scene.
    pub difference: PairedDifference,
}

/// The scores of both runs in one scene, x 100.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparedScene {
    /// Name of the scenario.
    pub scenario: String,
    /// nuPlan's scenario type.
    pub scenario_type: String,
    /// The planners.
    pub planners: PlannerPair,
    /// nuPlan's challenge.
    pub challenge: Challenge,
    /// Score of the first run.
    pub first: f64,
    /// Score of the second run.
    pub second: f64,
}

impl ComparedScene {
    /// The second score minus the first.
    pub fn difference(&self) -> f64 {
        self.second - self.first
    }
}

/// Two runs, compared on the scenes that both completed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunComparison {
    /// Settings of the intervals.
    pub bootstrap: Bootstrap,
    /// Settings and versions that differ, one a line.
    pub differences: Vec<String>,
    /// Scores over all scenes.
    pub scores: Vec<ComparedScores>,
    /// Scores by scenario type.
    pub scenario_types: Vec<ComparedScores>,
    /// The common scenes, in the order of the first run.
    pub scenes: Vec<ComparedScene>,
    /// Simulations of the compared planners without a counterpart that completed.
    pub unpaired: usize,
}

/// Why two runs cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum NoPair {
    #[error(
        "the runs have no planner in common: the first has {}, the second {}; name two by --planner FIRST,SECOND",
        first.join(", "), second.join(", ")
    )]
    Planners {
        first: Vec<String>,
        second: Vec<String>,
    },
    #[error("the {run} run has no planner '{name}'; it has {}", known.join(", "))]
    UnknownPlanner {
        run: &'static str,
        name: String,
        known: Vec<String>,
    },
    #[error("the runs have no completed simulation of one scene in one challenge in common")]
    Scenes,
}

/// A run to compare.
type Side<'a> = (&'a Manifest, &'a [SimulationRow]);

impl RunComparison {
    /// Compares two runs: the named planners, else those that both have, else the only ones.
    pub fn new(
        first: Side<'_>,
        second: Side<'_>,
        named: Option<PlannerPair>,
    ) -> Result<Self, NoPair> {
        let pairs = pairs(first.0, second.0, named)?;
        let bootstrap = Bootstrap::default();
        let mut scenes = Vec::new();
        let mut simulations = 0;
        for pair in &pairs {
            let own = |rows: &[SimulationRow], name: &str| {
                rows.iter().filter(|row| row.planner == name).count()
            };
            simulations += own(first.1, &pair.first) + own(second.1, &pair.second);
            // Scenes that one run alone completed are counted, and not compared.
            scenes.extend(common(first.1, second.1, pair));
        }
        if scenes.is_empty() {
            return Err(NoPair::Scenes);
        }
        let (mut scores, mut scenario_types) = (Vec::new(), Vec::new());
        for pair in &pairs {
            for challenge in distinct(scenes.iter().map(|scene| scene.challenge)) {
                let own = || {
                    scenes
                        .iter()
                        .filter(|scene| scene.planners == *pair && scene.challenge == challenge)
                };
                let kinds = distinct(own().map(|scene| scene.scenario_type.clone()));
                scores.extend(compared(&bootstrap, own(), None));
                scenario_types.extend(kinds.into_iter().filter_map(|kind| {
                    let of_kind = own().filter(|scene| scene.scenario_type == kind);
                    compared(&bootstrap, of_kind, Some(kind.clone()))
                }));
            }
        }
        let expected = |line: &String| {
            EXPECTED_DIFFERENCES
                .iter()
                .any(|start| line.starts_with(start))
        };
        let differences = first
            .0
            .differences(second.0)
            .into_iter()
            .filter(|line| !expected(line))
            .collect();
        // A run that was edited may have a scene twice.
        let unpaired = simulations.saturating_sub(2 * scenes.len());
        Ok(Self {
            bootstrap,
            differences,
            scores,
            scenario_types,
            scenes,
            unpaired,
        })
    }

    /// The scenes in which the second run differs most, largest first: at most `count` where it
    /// lost, and where it gained.
    pub fn largest(&self, count: usize) -> (Vec<&ComparedScene>, Vec<&ComparedScene>) {
        let mut scenes: Vec<&ComparedScene> = self.scenes.iter().collect();
        scenes.sort_by(|a, b| a.difference().total_cmp(&b.difference()));
        let lost = scenes
            .iter()
            .copied()
            .take_while(|scene| scene.difference() < 0.0)
            .take(count)
            .collect();
        let gained = scenes
            .iter()
            .copied()
            .rev()
            .take_while(|scene| scene.difference() > 0.0)
            .take(count)
            .collect();
        (lost, gained)
    }
}

fn pairs(
    first: &Manifest,
    second: &Manifest,
    named: Option<PlannerPair>,
) -> Result<Vec<PlannerPair>, NoPair> {
    let (one, other) = (&first.planners, &second.planners);
    if let Some(pair) = named {
        for (run, planners, name) in [("first", one, &pair.first), ("second", other, &pair.second)]
        {
            if !planners.contains(name) {
                return Err(NoPair::UnknownPlanner {
                    run,
                    name: name.clone(),
                    known: planners.clone(),
                });
            }
        }
        return Ok(vec![pair]);
    }
    let pair = |first: &String, second: &String| PlannerPair {
        first: first.clone(),
        second: second.clone(),
    };
    let common: Vec<PlannerPair> = one
        .iter()
        .filter(|name| other.contains(name))
        .map(|name| pair(name, name))
        .collect();
    // Different planners are compared only where each run has one: else any choice would be a
    // guess.
    match (common.is_empty(), one.as_slice(), other.as_slice()) {
        (false, ..) => Ok(common),
        (true, [one], [other]) => Ok(vec![pair(one, other)]),
        _ => Err(NoPair::Planners {
            first: one.clone(),
            second: other.clone(),
        }),
    }
}

/// The scenes that both runs completed, in the order of the first.
fn common(
    first: &[SimulationRow],
    second: &[SimulationRow],
    pair: &PlannerPair,
) -> Vec<ComparedScene> {
    // Paths of recordings differ between machines; the names of log and scenario do not.
    let key = |row: &SimulationRow| {
        (
            row.log_name.clone(),
            row.scenario.clone(),
            row.challenge.to_string(),
        )
    };
    let of = |row: &SimulationRow, name: &str| (row.planner == name).then_some(row.score?);
    let mut others: BTreeMap<_, f64> = second
        .iter()
        .filter_map(|row| Some((key(row), of(row, &pair.second)? * 100.0)))
        .collect();
    let compared = first.iter().filter_map(|row| {
        Some(ComparedScene {
            scenario: row.scenario.clone(),
            scenario_type: row.scenario_type.clone(),
            planners: pair.clone(),
            challenge: row.challenge,
            first: of(row, &pair.first)? * 100.0,
            // Each scene counts once, also where a run that was edited has it twice.
            second: others.remove(&key(row))?,
        })
    });
    compared.collect()
}

/// The scores of scenes of one pair and challenge; none without scenes.
fn compared<'a>(
    bootstrap: &Bootstrap,
    scenes: impl Iterator<Item = &'a ComparedScene>,
    scenario_type: Option<String>,
) -> Option<ComparedScores> {
    let scenes: Vec<&ComparedScene> = scenes.collect();
    let differences: Vec<f64> = scenes.iter().map(|scene| scene.difference()).collect();
    let mean = |of: fn(&ComparedScene) -> f64| {
        scenes.iter().map(|scene| of(scene)).sum::<f64>() / scenes.len() as f64
    };
    let any = scenes.first()?;
    Some(ComparedScores {
        planners: any.planners.clone(),
        challenge: any.challenge,
        scenario_type,
        first: mean(|scene| scene.first),
        second: mean(|scene| scene.second),
        difference: bootstrap.difference(&differences)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::manifest::{FORMAT_VERSION, ScenarioList};

    const NR: Challenge = Challenge::NonReactive;

    fn manifest(planners: &[&str]) -> Manifest {
        Manifest {
            format_version: FORMAT_VERSION,
            result_version: 1,
            planagent: "0.1.0".to_owned(),
            commit: None,
            started: crate::report::stamp(std::time::UNIX_EPOCH),
            planners: planners.iter().map(ToString::to_string).collect(),
            commands: BTreeMap::new(),
            agents: BTreeMap::new(),
            challenges: vec![NR.to_string()],
            scenarios: ScenarioList::default(),
            model: None,
            prompts: None,
            config: toml::Table::new(),
            inputs: None,
            accepted: Vec::new(),
        }
    }

    fn row(seed: usize, planner: &str, score: Option<f64>) -> SimulationRow {
        SimulationRow::example("changing_lane", seed, planner, NR, score)
    }

    #[test]
    fn a_scene_that_a_run_has_twice_counts_once() {
        let one = manifest(&["idm"]);
        let first = [row(0, "idm", Some(0.5)), row(0, "idm", Some(0.5))];
        let second = [row(0, "idm", Some(0.75))];
        let found = RunComparison::new((&one, &first), (&one, &second), None).unwrap();
        assert_eq!(
            (found.scenes.len(), found.scores[0].difference.pairs),
            (1, 1)
        );
    }

    #[test]
    fn only_common_scenes_are_paired() {
        let (one, other) = (manifest(&["idm", "simple"]), manifest(&["idm"]));
        let first = [
            row(0, "idm", Some(0.5)),
            row(1, "idm", Some(0.25)),
            row(2, "idm", None),
            row(0, "simple", Some(0.0)),
        ];
        let second = [
            row(1, "idm", Some(0.75)),
            row(2, "idm", Some(1.0)),
            row(0, "idm", Some(0.25)),
        ];
        let found = RunComparison::new((&one, &first), (&other, &second), None).unwrap();
        let [scores] = found.scores.as_slice() else {
            panic!("{:?}", found.scores)
        };
        assert_eq!(
            (scores.first, scores.second, scores.difference.pairs),
            (37.5, 50.0, 2)
        );
        assert!((scores.difference.mean - 12.5).abs() < 1e-12);
        assert_eq!(
            (scores.difference.low, scores.difference.high),
            (-25.0, 50.0)
        );
        assert_eq!((found.unpaired, found.scenario_types.len()), (2, 1));
        let (lost, gained) = found.largest(5);
        assert_eq!(
            (lost[0].difference() as i64, gained[0].difference() as i64),
            (-25, 50)
        );
        assert_eq!((lost.len(), gained.len()), (1, 1));
    }

    #[test]
    fn other_planners_are_paired_by_name_or_if_each_run_has_one() {
        let (one, other) = (manifest(&["idm"]), manifest(&["simple"]));
        let (first, second) = ([row(0, "idm", Some(0.5))], [row(0, "simple", Some(1.0))]);
        let found = RunComparison::new((&one, &first), (&other, &second), None).unwrap();
        assert!((found.scores[0].difference.mean - 50.0).abs() < 1e-12);
        let two = manifest(&["simple", "log-replay"]);
        let error = RunComparison::new((&one, &first), (&two, &second), None).unwrap_err();
        assert!(
            error.to_string().contains("the second simple, log-replay"),
            "{error}"
        );
        let pair = |second: &str| {
            Some(PlannerPair {
                first: "idm".to_owned(),
                second: second.to_owned(),
            })
        };
        assert!(RunComparison::new((&one, &first), (&two, &second), pair("simple")).is_ok());
        let error = RunComparison::new((&one, &first), (&two, &second), pair("smple")).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the second run has no planner 'smple'; it has simple, log-replay"
        );
        let none = [row(1, "simple", Some(1.0)), row(0, "simple", None)];
        assert_eq!(
            RunComparison::new((&one, &first), (&other, &none), None).unwrap_err(),
            NoPair::Scenes
        );
    }
}
