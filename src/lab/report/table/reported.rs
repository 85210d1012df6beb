//! Reported scores of planners, and how far the order here agrees with theirs.

use crate::report::{StudyResults, SuiteResults};
use crate::study::{Reported, Study};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::fixed;
use planagent_runs::report::table::{Table, or_dash, short, signed};

/// Reported scores, a row for each planner that has some; none without any.
pub(super) fn reported(study: &Study) -> Option<Table> {
    let mut headers = study.labels.clone();
    for benchmark in Reported::BENCHMARKS {
        headers.extend(
            Challenge::CLOSED_LOOP
                .map(|challenge| format!("{} {}", benchmark.name(), short(challenge))),
        );
    }
    let known = study
        .variants
        .iter()
        .filter(|variant| variant.reported != Reported::default());
    let rows: Vec<Vec<String>> = known
        .map(|variant| {
            let mut cells = variant.labels.clone();
            for benchmark in Reported::BENCHMARKS {
                let score = |challenge| variant.reported.score(benchmark, challenge);
                cells.extend(
                    Challenge::CLOSED_LOOP
                        .map(|challenge| or_dash(score(challenge), |score| fixed(score, 2))),
                );
            }
            cells
        })
        .collect();
    (!rows.is_empty()).then(|| Table::new(headers, study.labels.len(), rows))
}

/// Kendall's tau of each suite, benchmark and challenge; none without any.
pub(super) fn agreement(results: &StudyResults) -> Option<Table> {
    let headers = [
        "suite",
        "benchmark",
        "agents",
        "scenes",
        "tau",
        "95 % interval",
    ]
    .map(str::to_owned);
    let of_suite = |suite: &SuiteResults| -> Vec<Vec<String>> {
        suite
            .agreement
            .iter()
            .map(|found| {
                let interval = |kendall: crate::rank_correlation::RankCorrelation| {
                    format!("{} to {}", signed(kendall.low), signed(kendall.high))
                };
                vec![
                    suite.name.clone(),
                    found.benchmark.name().to_owned(),
                    short(found.challenge).to_owned(),
                    found
                        .kendall
                        .map_or_else(|| "-".to_owned(), |kendall| kendall.scenes.to_string()),
                    // Fewer than three planners have no order to compare.
                    or_dash(found.kendall, |kendall| signed(kendall.tau)),
                    or_dash(found.kendall, interval),
                ]
            })
            .collect()
    };
    let rows: Vec<Vec<String>> = results.suites.iter().flat_map(of_suite).collect();
    (!rows.is_empty()).then(|| Table::new(headers.to_vec(), 3, rows))
}

/// What the tables mean.
pub(super) const NOTE: &str = "Reported = the READMEs of planTF (both Test14), tuplan_garage (Val14) and DiffusionPlanner; DTPP: the \
    paper. tau = Kendall's tau-b of the order of the planners' mean scores here and reported; its interval is over draws of scenes.";
