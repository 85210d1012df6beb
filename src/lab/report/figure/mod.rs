//! The figures of studies, as SVG that follows the reader's light or dark scheme.

mod agreement;
mod bars;
mod differences;
mod lines;
mod realism;
pub(crate) mod svg;

pub use realism::realism_figure;

use crate::report::StudyResults;
use crate::study::{Figure, Study};
use planagent_agent::simulation::Challenge;

fn panel(challenge: Challenge) -> &'static str {
    match challenge {
        Challenge::NonReactive => "NR: non-reactive agents",
        Challenge::Reactive => "R: reactive agents",
        Challenge::OpenLoop => "open loop",
        own => own.short_name(),
    }
}

/// File name of the figure of scores here and reported.
pub(super) const AGREEMENT: &str = "agreement.svg";

/// The figures of a study, one for each suite, and one of reported scores: file name and text.
pub(super) fn figures(study: &Study, results: &StudyResults) -> Vec<(String, String)> {
    let draw = |suite| match &study.figure {
        Figure::Differences => differences::draw(study, results, suite),
        Figure::Lines(axis) => lines::draw(study, results, suite, axis),
        Figure::Bars => bars::draw(results, suite),
    };
    let of_suites = results
        .suites
        .iter()
        .map(|suite| (format!("{}.svg", suite.name), draw(suite)));
    of_suites
        .chain(agreement::draw(results).map(|text| (AGREEMENT.to_owned(), text)))
        .collect()
}
