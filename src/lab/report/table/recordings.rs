//! The tables that a study of recordings adds: each recording, and the planning calls.

use crate::report::SuiteResults;
use crate::study::Study;
use planagent_agent::simulation::Challenge;
use planagent_runs::report::fixed;
use planagent_runs::report::table::{Table, or_dash, short};
use planagent_score::metrics::METRICS;

/// A row for each recording: the scores of all variants in these challenges, and where the first
/// loses most.
pub(super) fn recordings(suite: &SuiteResults, challenges: &[Challenge]) -> Table {
    let mut headers = vec!["recording".to_owned(), "starts".to_owned()];
    for &challenge in challenges {
        // A single challenge stands above the table.
        let named = |name: &str| match challenges {
            [_] => name.to_owned(),
            _ => format!("{name} {}", short(challenge)),
        };
        headers.extend(
            suite
                .variants
                .iter()
                .map(|variant| named(&variant.name))
                .chain([named("loss")]),
        );
    }
    let label = |metric: String| {
        METRICS
            .iter()
            .find(|known| known.name == metric)
            .map_or(metric, |m| m.label.to_owned())
    };
    let rows = suite.recordings.iter().map(|recording| {
        let mut cells = vec![recording.recording.clone(), recording.starts.to_string()];
        for own in recording
            .challenges
            .iter()
            .filter(|own| challenges.contains(&own.challenge))
        {
            cells.extend(
                own.scores
                    .iter()
                    .map(|&score| or_dash(score, |score| fixed(score, 2))),
            );
            cells.push(or_dash(own.loss.clone(), label));
        }
        cells
    });
    Table::new(headers, 1, rows)
}

/// A row for each variant with planning calls: which share of them was refused, and why;
/// simulations with a collision at fault.
pub(super) fn calls(study: &Study, suite: &SuiteResults) -> Table {
    let mut headers = study.labels.clone();
    headers.extend(
        [
            "at fault NR",
            "R",
            "calls",
            "off route",
            "off area",
            "1st refused",
            "all refused",
        ]
        .map(str::to_owned),
    );
    let variants = study.variants.iter().zip(&suite.variants);
    let rows = variants
        .filter_map(|(variant, results)| Some((variant, results.calls.as_ref()?)))
        .map(|(variant, own)| {
            let mut cells = variant.labels.clone();
            cells.extend(own.at_fault.iter().map(|(_, count)| count.to_string()));
            cells.push(own.planning_calls.to_string());
            // Shares, because variants make different numbers of calls.
            let share = |count: usize| match own.planning_calls {
                0 => "-".to_owned(),
                all => format!("{} %", fixed(100.0 * count as f64 / all as f64, 1)),
            };
            cells.extend(
                [
                    own.off_route,
                    own.off_area,
                    own.first_refused,
                    own.all_refused,
                ]
                .map(share),
            );
            cells
        });
    Table::new(headers, study.labels.len(), rows)
}
