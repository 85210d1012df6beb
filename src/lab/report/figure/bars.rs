//! Scores by scenario type, with a bar for each variant.

use super::panel;
use super::svg::{Anchor, Picture, Scale, color};
use crate::report::{StudyResults, SuiteResults, TypeResults};
use planagent_agent::simulation::Challenge;

/// Width of the picture, pixels; so are all lengths below.
const WIDTH: f64 = 980.0;
/// Columns: names, then a panel for each challenge. The longest type has 54 letters.
const NAMES: f64 = 350.0;
const GAP: f64 = 36.0;
/// Rows.
const TOP: f64 = 70.0;
const BAR: f64 = 9.0;
const BETWEEN: f64 = 8.0;

pub(super) fn draw(results: &StudyResults, suite: &SuiteResults) -> String {
    let kinds = suite
        .variants
        .first()
        .map_or(&[][..], |variant| &variant.scenario_types);
    let group = BAR * suite.variants.len() as f64 + BETWEEN;
    let bottom = TOP + group * kinds.len() as f64;
    let mut picture = Picture::new(WIDTH);
    let title = format!("{}: {}, {} scenes", results.title, suite.name, suite.scenes);
    picture.text([12.0, 24.0], Anchor::Start, "head", &title);
    for (place, kind) in kinds.iter().enumerate() {
        // 4 pixels down, because SVG places a text by its baseline.
        let y = TOP + group * place as f64 + f64::midpoint(0.0, group - BETWEEN) + 4.0;
        picture.text([NAMES - 10.0, y], Anchor::End, "", &kind.scenario_type);
    }
    let panels = suite.challenges();
    let panel_width = (WIDTH - NAMES) / panels.len() as f64 - GAP;
    for (column, challenge) in panels.into_iter().enumerate() {
        let left = NAMES + (panel_width + GAP) * column as f64;
        let scale = Scale::for_values([0.0, 100.0], [left, left + panel_width]);
        picture.text([left, TOP - 18.0], Anchor::Start, "", panel(challenge));
        picture.columns(scale, TOP, bottom);
        for (place, kind) in kinds.iter().enumerate() {
            for (series, variant) in suite.variants.iter().enumerate() {
                let y = TOP + group * place as f64 + BAR * series as f64;
                if let Some(score) = score(&variant.scenario_types, &kind.scenario_type, challenge)
                {
                    picture.bar(
                        [left, y],
                        [scale.at(score) - left, BAR - 1.0],
                        color(series),
                    );
                }
            }
        }
    }
    let legend = bottom + 44.0;
    for (series, variant) in suite.variants.iter().enumerate() {
        let x = NAMES + 140.0 * series as f64;
        picture.bar([x, legend - 9.0], [12.0, BAR], color(series));
        picture.text([x + 18.0, legend], Anchor::Start, "faint", &variant.name);
    }
    picture.finish(legend + 16.0, &title)
}

fn score(kinds: &[TypeResults], name: &str, challenge: Challenge) -> Option<f64> {
    let kind = kinds.iter().find(|kind| kind.scenario_type == name)?;
    kind.challenges
        .iter()
        .find(|result| result.challenge == challenge)?
        .score
}
