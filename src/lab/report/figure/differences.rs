//! Differences to the reference with their intervals, a row for each variant; the paper's
//! differences are hollow points.

use super::panel;
use super::svg::{Anchor, Picture, Scale, color};
use crate::report::{ChallengeResults, StudyResults, SuiteResults, VariantResults};
use crate::study::Study;

/// Width of the picture, pixels; so are all lengths below.
const WIDTH: f64 = 880.0;
/// Columns: names, then a panel for each challenge.
const NAMES: f64 = 310.0;
const GAP: f64 = 30.0;
/// Rows.
const TOP: f64 = 70.0;
const ROW: f64 = 26.0;

pub(super) fn draw(study: &Study, results: &StudyResults, suite: &SuiteResults) -> String {
    // A row without a point would only take room; the table has it with its reason.
    let has_point = |variant: &VariantResults| {
        let mut all = variant.challenges.iter();
        all.any(|result| result.difference.is_some() || result.paper_difference.is_some())
    };
    let shown: Vec<_> = suite
        .variants
        .iter()
        .enumerate()
        .filter(|(place, variant)| *place != study.reference && has_point(variant))
        .collect();
    let bottom = TOP + ROW * shown.len() as f64;
    let mut picture = Picture::new(WIDTH);
    let title = format!(
        "{}: score minus that of {}, {} scenes",
        suite.name, results.reference, suite.scenes
    );
    picture.text([12.0, 24.0], Anchor::Start, "head", &title);
    for (place, (_, variant)) in shown.iter().enumerate() {
        let y = TOP + ROW * (place as f64 + 0.5) + 4.0;
        let reason = variant
            .not_simulated
            .map_or_else(String::new, |why| format!(" ({why})"));
        picture.text(
            [NAMES - 12.0, y],
            Anchor::End,
            "",
            &format!("{}{reason}", variant.name),
        );
    }
    // All panels share the rows of names: a variant stands at one height.
    let panels = suite.challenges();
    let panel_width = (WIDTH - NAMES) / panels.len() as f64 - GAP;
    for (column, challenge) in panels.into_iter().enumerate() {
        let left = NAMES + (panel_width + GAP) * column as f64;
        let own: Vec<Option<&ChallengeResults>> = shown
            .iter()
            .map(|(_, variant)| {
                variant
                    .challenges
                    .iter()
                    .find(|result| result.challenge == challenge)
            })
            .collect();
        let ends = own.iter().flatten().flat_map(|result| {
            let interval = result
                .difference
                .map(|difference| [difference.low, difference.high]);
            interval
                .into_iter()
                .flatten()
                .chain(result.paper_difference)
        });
        let scale = Scale::for_values(ends.chain([0.0]), [left, left + panel_width]);
        picture.text([left, TOP - 18.0], Anchor::Start, "", panel(challenge));
        picture.columns(scale, TOP, bottom);
        for (place, result) in own.iter().enumerate() {
            let Some(result) = result else { continue };
            let y = TOP + ROW * (place as f64 + 0.5);
            if let Some(difference) = result.difference {
                picture.line(
                    &[
                        [scale.at(difference.low), y],
                        [scale.at(difference.high), y],
                    ],
                    color(0),
                    false,
                );
                picture.point([scale.at(difference.mean), y], color(0), false);
            }
            if let Some(paper) = result.paper_difference {
                picture.point([scale.at(paper), y], color(1), true);
            }
        }
    }
    let legend = bottom + 44.0;
    picture.point([NAMES, legend - 4.0], color(0), false);
    picture.text(
        [NAMES + 12.0, legend],
        Anchor::Start,
        "faint",
        "here, with its 95 % interval",
    );
    let of_paper = shown
        .iter()
        .flat_map(|(_, variant)| &variant.challenges)
        .any(|result| result.paper_difference.is_some());
    if let Some(benchmark) = suite.benchmark.filter(|_| of_paper) {
        picture.point([NAMES + 220.0, legend - 4.0], color(1), true);
        let text = format!("the paper, nuPlan {}", benchmark.name());
        picture.text([NAMES + 232.0, legend], Anchor::Start, "faint", &text);
    }
    picture.finish(legend + 16.0, &title)
}
