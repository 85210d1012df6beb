//! How far the order of planners here agrees with that of reported scores.

use super::results::{SuiteSimulations, VariantSimulations};
use crate::rank_correlation::{RankCorrelation, rank_correlation};
use crate::study::{Benchmark, Study, Variant, reported_benchmarks};
use planagent_agent::simulation::Challenge;
use planagent_runs::worker::statistics::Bootstrap;
use serde::Serialize;
use std::collections::BTreeMap;

/// The agreement with a benchmark in a challenge.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    pub benchmark: Benchmark,
    pub challenge: Challenge,
    /// The planners that have a score here and a reported one.
    pub planners: Vec<RankedPlanner>,
    /// None with fewer than three planners.
    pub kendall: Option<RankCorrelation>,
}

/// A planner with both scores x 100.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RankedPlanner {
    pub name: String,
    /// On the scenes that all of them have a score of.
    pub score: f64,
    pub reported: f64,
}

/// The agreement with each benchmark that a suite stands for, in both challenges; none where no
/// planner has a reported score.
pub(super) fn agreements(
    study: &Study,
    suite: &SuiteSimulations,
    bootstrap: Bootstrap,
) -> Vec<Agreement> {
    let benchmarks = reported_benchmarks(&suite.name).iter();
    let cases = benchmarks
        .flat_map(|&benchmark| Challenge::CLOSED_LOOP.map(|challenge| (benchmark, challenge)));
    let found = cases
        .map(|(benchmark, challenge)| agreement(study, suite, benchmark, challenge, bootstrap));
    found
        .filter(|agreement| !agreement.planners.is_empty())
        .collect()
}

fn agreement(
    study: &Study,
    suite: &SuiteSimulations,
    benchmark: Benchmark,
    challenge: Challenge,
    bootstrap: Bootstrap,
) -> Agreement {
    let both = |(variant, simulations): (&Variant, &VariantSimulations)| {
        let reported = variant.reported.score(benchmark, challenge)?;
        let own = simulations
            .rows()
            .iter()
            .filter(|row| row.challenge == challenge);
        let scores: BTreeMap<String, f64> = own
            .filter_map(|row| Some((row.source.clone(), row.score?)))
            .collect();
        (!scores.is_empty()).then(|| (study.name_of(variant), scores, reported))
    };
    let planners: Vec<_> = study
        .variants
        .iter()
        .zip(&suite.variants)
        .filter_map(both)
        .collect();
    // Only scenes that every planner completed: else the scenes and not the planners make the
    // order.
    let all = |source: &&String| {
        planners
            .iter()
            .all(|(_, scores, _)| scores.contains_key(*source))
    };
    let sources: Vec<&String> = planners.first().map_or(Vec::new(), |(_, scores, _)| {
        scores.keys().filter(all).collect()
    });
    let of_sources = |scores: &BTreeMap<String, f64>| {
        sources
            .iter()
            .filter_map(|s| scores.get(*s).copied())
            .collect()
    };
    let scores: Vec<Vec<f64>> = planners
        .iter()
        .map(|(_, scores, _)| of_sources(scores))
        .collect();
    let reported: Vec<f64> = planners.iter().map(|&(.., reported)| reported).collect();
    let ranked = planners
        .iter()
        .zip(&scores)
        .filter(|_| !sources.is_empty())
        .map(|((name, _, reported), scores)| {
            let score = 100.0 * scores.iter().sum::<f64>() / scores.len() as f64;
            RankedPlanner {
                name: name.clone(),
                score,
                reported: *reported,
            }
        });
    Agreement {
        benchmark,
        challenge,
        planners: ranked.collect(),
        kendall: rank_correlation(&bootstrap, &scores, &reported),
    }
}
